"""SPICE kernels of a camera in orbit about the Moon."""

from pathlib import Path

import numpy as np
import spiceypy as spice

from craternav_fg import frames

BEGIN, END = -1000.0, 1000.0
SPIN = 2.6617e-6
LSK = r"""KPL/LSK
\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT = ( 10, @1972-JAN-1 32, @1999-JAN-1 )
\begintext
"""
# A body-fixed frame that turns about z, a clock of whole seconds, and the frame of a camera with a C kernel.
TEXT = r"""KPL/FK
\begindata
FRAME_CAM = -999100
FRAME_-999100_NAME = 'CAM'
FRAME_-999100_CLASS = 3
FRAME_-999100_CLASS_ID = -999100
FRAME_-999100_CENTER = -999
CK_-999100_SCLK = -999
CK_-999100_SPK = -999
BODY301_POLE_RA = ( 0. 0. 0. )
BODY301_POLE_DEC = ( 90. 0. 0. )
BODY301_PM = ( -90. 13.17635 0. )
SCLK_KERNEL_ID = ( @2000-JAN-1 )
SCLK_DATA_TYPE_999 = ( 1 )
SCLK01_TIME_SYSTEM_999 = ( 1 )
SCLK01_N_FIELDS_999 = ( 1 )
SCLK01_MODULI_999 = ( 1000000000 )
SCLK01_OFFSETS_999 = ( 0 )
SCLK01_OUTPUT_DELIM_999 = ( 1 )
SCLK_PARTITION_START_999 = ( 0 )
SCLK_PARTITION_END_999 = ( 1000000000 )
SCLK01_COEFFICIENTS_999 = ( 0 -100000 1 )
\begintext
"""
RATE = np.array([1e-4, -9e-4, 2e-4])
R0 = frames.rotation_exp(np.array([0.3, -0.4, 0.5]))


def attitude_of(et: float) -> np.ndarray:
    """Rotation from the camera to J2000."""
    return R0 @ frames.rotation_exp(RATE * et)


def write_kernels(folder: Path) -> Path:
    """Write leap seconds, frames, orbit and attitude of a camera, and the meta-kernel, which is returned."""
    (folder / "naif.tls").write_text(LSK)
    (folder / "frames.tf").write_text(TEXT)
    epochs = np.linspace(BEGIN, END, 401)
    handle = spice.spkopn(str(folder / "orbit.bsp"), "test", 0)
    w, r = 9e-4, 1850.0
    states = np.stack(
        [r * np.cos(w * epochs), r * np.sin(w * epochs), 0 * epochs,
         -r * w * np.sin(w * epochs), r * w * np.cos(w * epochs), 0 * epochs], axis=1,
    )  # fmt: skip
    spice.spkw09(
        handle, -999, 301, "J2000", BEGIN, END, "orbit", 7, len(epochs), np.ascontiguousarray(states), epochs
    )
    sun = np.tile([1.0e8, 1.1e8, 2.0e6, 0.0, 0.0, 0.0], (len(epochs), 1))
    spice.spkw09(
        handle, 10, 301, "J2000", BEGIN, END, "sun", 7, len(epochs), np.ascontiguousarray(sun), epochs
    )
    spice.spkcls(handle)
    spice.furnsh(str(folder / "naif.tls"))
    spice.furnsh(str(folder / "frames.tf"))
    handle = spice.ckopn(str(folder / "attitude.bc"), "test", 0)
    ticks = np.array([spice.sce2c(-999, et) for et in epochs])
    quats = np.array([spice.m2q(np.ascontiguousarray(attitude_of(et).T)) for et in epochs])
    rates = np.array([attitude_of(et) @ RATE for et in epochs])
    spice.ckw03(
        handle,
        ticks[0],
        ticks[-1],
        -999100,
        "J2000",
        True,
        "attitude",
        len(epochs),
        ticks,
        quats,
        rates,
        1,
        ticks[:1],
    )
    spice.ckcls(handle)
    spice.kclear()
    meta = folder / "all.tm"
    names = ["naif.tls", "frames.tf", "orbit.bsp", "attitude.bc"]
    listed = " ".join(f"'$K/{name}'" for name in names)
    meta.write_text(
        f"KPL/MK\n\\begindata\nPATH_VALUES = ( '{folder}' )\nPATH_SYMBOLS = ( 'K' )\n"
        f"KERNELS_TO_LOAD = ( {listed} )\n\\begintext\n"
    )
    return meta
