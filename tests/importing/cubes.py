"""ISIS cubes of a few pixels."""

import struct
from pathlib import Path

import numpy as np

LABEL = """Object = IsisCube
  Object = Core
    StartByte = 8193
    Format = BandSequential
    Group = Dimensions
      Samples = {width}
      Lines = {height}
      Bands = 1
    End_Group
    Group = Pixels
      Type = {kind}
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
  Group = Instrument
    TargetName = Moon
    StartTime = {start}{exposure}
  End_Group
  Group = Kernels
    NaifFrameCode = -1
  End_Group
End_Object
Object = Label
  Bytes = 8192
End_Object
{tables}Object = NaifKeywords
  BODY301_RADII = (1737.4, 1737.4, 1737.4)
  INS-1_FOCAL_LENGTH = {focal_mm}
  INS-1_ITRANSS = (0.0, 50.0, 0.0)
  INS-1_ITRANSL = (0.0, 0.0, 50.0)
  {extra}
End_Object
End
"""
ROWS = {
    "InstrumentPointing": [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-3, 5.0],
    "InstrumentPosition": [1900.0, 1.0, 2.0, 0.1, 1.6, 0.2, 5.0],
    "BodyRotation": [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.7e-6, 5.0],
    "SunPosition": [0.0, 1.5e8, 0.0, 0.0, 0.0, 0.0, 5.0],
}
TYPES = {"UnsignedByte": np.uint8, "SignedWord": np.int16, "Real": np.float32}


def write_cube(
    path: Path,
    *,
    kind="Real",
    size=(24, 20),
    tables=tuple(ROWS),
    extra="",
    start="2000-01-01T12:00:00",
    exposure="",
    rows=1,
    focal_mm=100.0,
    without_rates=(),
) -> Path:
    """Write a cube of a few pixels with its tables."""
    width, height = size
    pixels = (np.arange(width * height).reshape(height, width) % 200).astype(TYPES[kind])
    begin, text, data = 8192 + pixels.nbytes, "", b""
    for name in tables:
        row = [*ROWS[name][:4], ROWS[name][-1]] if name in without_rates else ROWS[name]
        values = np.array([[*row[:-1], row[-1] + 10.0 * k] for k in range(rows)])
        fields = "".join(
            f"  Group = Field\n    Name = F{k}\n    Type = Double\n    Size = 1\n  End_Group\n"
            for k in range(values.shape[1])
        )
        text += (
            f"Object = Table\n  Name = {name}\n  StartByte = {begin + len(data) + 1}\n"
            f"  Bytes = {values.nbytes}\n  Records = {rows}\n  ByteOrder = Lsb\n{fields}End_Object\n"
        )
        data += b"".join(struct.pack("<d", value) for value in values.ravel())
    label = LABEL.format(
        width=width,
        height=height,
        kind=kind,
        start=start,
        exposure=exposure,
        tables=text,
        extra=extra,
        focal_mm=focal_mm,
    )
    path.write_bytes(label.encode().ljust(8192, b"\0") + pixels.tobytes() + data)
    return path
