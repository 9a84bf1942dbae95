"""Images of PDS4 products: an XML label, and the raw array that it describes in a file beside it."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset.foreign_images import MAX_PIXELS
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, open_input, read_bytes

# Names under which labels are published.
LABEL_SUFFIXES = (".xml", ".lblx")
_TYPES = {
    "UnsignedByte": "u1", "UnsignedLSB2": "<u2", "UnsignedMSB2": ">u2", "UnsignedLSB4": "<u4",
    "UnsignedMSB4": ">u4", "SignedByte": "i1", "SignedLSB2": "<i2", "SignedMSB2": ">i2",
    "SignedLSB4": "<i4", "SignedMSB4": ">i4", "IEEE754LSBSingle": "<f4", "IEEE754MSBSingle": ">f4",
    "IEEE754LSBDouble": "<f8", "IEEE754MSBDouble": ">f8",
}  # fmt: skip
_ARRAYS = ("Array_2D_Image", "Array_3D_Image", "Array_2D", "Array_3D")
# Longest exposure, s: more is a line-scan camera's.
_MAX_EXPOSURE_S = 1.0


@dataclass(frozen=True)
class Pds4Image:
    """An image as its label describes it.

    Attributes
    ----------
    path : Path
        The label.
    data : Path
        File of the array.
    dtype : dtype
        As stored.
    offset : int
        First byte of the array.
    shape : (int, int)
        Elements along the first and the last axis, as stored.
    transposed : bool
        Whether lines run along the last axis.
    scale, shift : float
        A value is scale times what is stored, plus shift.
    upwards, leftwards : bool
        Whether the first line is the lowest, the first sample the rightmost.
    saturated, missing : tuple of float
        Stored numbers that stand for values beyond the largest, and for none.
    exposed : (str, str)
        Start and end of the exposure, as written; empty where the label has none.
    """

    path: Path
    data: Path
    dtype: np.dtype[np.generic]
    offset: int
    shape: tuple[int, int]
    transposed: bool
    scale: float
    shift: float
    upwards: bool
    leftwards: bool
    saturated: tuple[float, ...]
    missing: tuple[float, ...]
    exposed: tuple[str, str]

    def middle(self) -> datetime:
        """Return the middle of the exposure.

        Returns
        -------
        datetime
            UTC.

        Raises
        ------
        InputError
            When the label has no start time, or the image took longer than a framing camera's.
        """
        try:
            begin = datetime.fromisoformat(self.exposed[0])
            end = datetime.fromisoformat(self.exposed[1]) if self.exposed[1] else begin
            took_s = (end - begin).total_seconds()
        except (TypeError, ValueError):
            problem = f"expected a time, found {self.exposed[0]!r} to {self.exposed[1]!r}: give --times"
            raise InputError(self.path, problem, column="start_date_time") from None
        if not 0.0 <= took_s <= _MAX_EXPOSURE_S:
            problem = (
                f"expected an exposure of at most {_MAX_EXPOSURE_S:g} s, found {took_s:g} s: give --times"
            )
            raise InputError(self.path, problem, column="stop_date_time")
        return begin + 0.5 * (end - begin)

    def pixels(self) -> npt.NDArray[np.generic]:
        """Read the values.

        Returns
        -------
        ndarray of uint8, uint16 or float64, shape (height, width)
            Upright. Unsigned numbers of 8 and 16 bits without a scale stay as they are, with zero where there
            is no value. All others become float64, with NaN there.

        Raises
        ------
        InputError
            When the file is missing or shorter than the label says.
        """
        count = self.shape[0] * self.shape[1]
        with open_input(self.data, SizeLimit.RASTER) as stream:
            stream.seek(self.offset)
            raw = stream.read(count * self.dtype.itemsize)
        if len(raw) < count * self.dtype.itemsize:
            end = self.offset + count * self.dtype.itemsize
            problem = (
                f"is truncated: expected {end} bytes, as {self.path} says, found {self.offset + len(raw)}"
            )
            raise InputError(self.data, problem)
        stored = np.frombuffer(raw, self.dtype).reshape(self.shape)
        over, none = np.isin(stored, self.saturated), np.isin(stored, self.missing)
        values: npt.NDArray[np.generic]
        if self.dtype.kind == "u" and self.dtype.itemsize <= 2 and (self.scale, self.shift) == (1.0, 0.0):
            values = np.where(none, 0, stored).astype(self.dtype.newbyteorder("="))
        else:
            found = np.where(none, np.nan, stored.astype(np.float64) * self.scale + self.shift)
            valid = found[np.isfinite(found) & ~over]
            found[over] = valid.max() if valid.size else np.nan
            values = np.where(np.isfinite(found), found, np.nan)
        values = values.T if self.transposed else values
        values = values[::-1] if self.upwards else values
        return np.ascontiguousarray(values[:, ::-1] if self.leftwards else values)


def is_label(path: Path) -> bool:
    """Whether a file is named as a PDS4 label.

    Returns
    -------
    bool
    """
    return path.suffix.lower() in LABEL_SUFFIXES


def read_pds4(path: Path) -> Pds4Image:
    """Read the label of an image.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Pds4Image

    Raises
    ------
    InputError
        When the file is no PDS4 label, describes no image of one band, or describes it in a way that is not
        read.
    """
    text = read_bytes(path, SizeLimit.SETTINGS)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(path, f"expected a PDS4 label, found no XML: {error}") from None
    for element in root.iter():
        # Names are unique without their dictionary's namespace.
        element.tag = str(element.tag).rpartition("}")[2]
    if root.tag != "Product_Observational":
        raise InputError(path, f"expected a PDS4 label of Product_Observational, found {root.tag[:80]}")
    for area in root.iter("File_Area_Observational"):
        array = next((one for name in _ARRAYS for one in area.iter(name)), None)
        if array is not None:
            return _image(path, root, area, array)
    raise InputError(path, "expected an Array_2D_Image in File_Area_Observational, found none")


def _image(
    path: Path, root: ElementTree.Element, area: ElementTree.Element, array: ElementTree.Element
) -> Pds4Image:
    name = _text(path, area, "file_name")
    if Path(name).name != name:
        raise InputError(path, f"expected a file beside the label, found {name!r}", column="file_name")
    kind = _text(path, array, "data_type")
    if kind not in _TYPES:
        raise InputError(path, f"expected {', '.join(_TYPES)}, found {kind}", column="data_type")
    shape, transposed = _axes(path, array)
    constants = [
        (one.tag, _number(path, one.tag, one.text))
        for group in array.iter("Special_Constants")
        for one in group
        if one.tag.endswith(("_constant", "_saturation"))
    ]
    saturated = [value for tag, value in constants if tag.startswith(("high_", "saturated_"))]
    return Pds4Image(
        path=path,
        data=path.with_name(name),
        dtype=np.dtype(_TYPES[kind]),
        offset=_whole(path, array, "offset", least=0),
        shape=shape,
        transposed=transposed,
        scale=_number(path, "scaling_factor", array.findtext(".//scaling_factor", "1")),
        shift=_number(path, "value_offset", array.findtext(".//value_offset", "0")),
        upwards=root.findtext(".//vertical_display_direction", "").strip() == "Bottom to Top",
        leftwards=root.findtext(".//horizontal_display_direction", "").strip() == "Right to Left",
        saturated=tuple(saturated),
        missing=tuple(value for _, value in constants if value not in saturated),
        exposed=(
            root.findtext(".//Time_Coordinates/start_date_time", "").strip(),
            root.findtext(".//Time_Coordinates/stop_date_time", "").strip(),
        ),
    )


def _axes(path: Path, array: ElementTree.Element) -> tuple[tuple[int, int], bool]:
    """Sizes of the two axes that are longer than one, the slowest first; whether the lines are the last."""
    order = array.findtext("axis_index_order", "").strip()
    if order != "Last Index Fastest":
        raise InputError(path, f"expected Last Index Fastest, found {order!r}", column="axis_index_order")
    axes = [
        (
            _whole(path, axis, "sequence_number", least=1),
            _text(path, axis, "axis_name"),
            _whole(path, axis, "elements", least=1),
        )
        for axis in array.iter("Axis_Array")
    ]
    image = sorted(axis for axis in axes if axis[1] in ("Line", "Sample"))
    others = [
        f"{count} along {name}" for _, name, count in axes if name not in ("Line", "Sample") and count > 1
    ]
    if len(image) != 2 or image[0][1] == image[1][1] or others:
        found = ", ".join(others) or ", ".join(name for _, name, _ in axes) or "none"
        raise InputError(path, f"expected axes Line and Sample alone, found {found}", column="Axis_Array")
    first, second = image[0][2], image[1][2]
    if first * second > MAX_PIXELS:
        problem = f"expected at most {MAX_PIXELS // 10**6} million pixels, found {first} x {second}"
        raise InputError(path, problem, column="Axis_Array")
    return (first, second), image[0][1] == "Sample"


def _text(path: Path, element: ElementTree.Element, name: str) -> str:
    found = (element.findtext(f".//{name}") or "").strip()
    if not found:
        raise InputError(path, f"expected it in {element.tag}, found none", column=name)
    return found


def _whole(path: Path, element: ElementTree.Element, name: str, *, least: int) -> int:
    found = _text(path, element, name)
    # More digits than any file has bytes are no size.
    if not (found.isascii() and found.isdigit() and len(found) < 13 and int(found) >= least):
        raise InputError(path, f"expected a whole number from {least}, found {found[:40]!r}", column=name)
    return int(found)


def _number(path: Path, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(path, f"expected a number, found {(text or '')[:40]!r}", column=name)
    return value
