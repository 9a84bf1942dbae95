"""PNG images: checks without decoding, reading as grey levels, and writing."""

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, open_input, read_bytes

ImageArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
_COLOUR_TYPES = {2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}
# Types of 8 bits that are converted: grey, colour, and both with an alpha channel, which is not used.
_GREY, _CONVERTED = 0, (0, 2, 4, 6)
# How images are written: noise has no repetitions but runs of one grey level to look for. It takes half the
# time of zlib's usual strategy at its lowest level, for files that are smaller by a sixth.
_PNG = [
    cv2.IMWRITE_PNG_COMPRESSION, 1,
    cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
]  # fmt: skip
# OpenCV 4.10 and 4.11 have another filter and no choice.
if hasattr(cv2, "IMWRITE_PNG_FILTER"):
    _PNG += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_AVG]


def check_image(path: Path, width_px: int, height_px: int, bit_depth: int = 8) -> bool:
    """Check by its first and last bytes that a file is a whole PNG, grey or in 8-bit colour.

    Parameters
    ----------
    path : Path
    width_px, height_px : int
        Its size.
    bit_depth : int
        Bits of its grey levels: 8 are stored as 8, more as 16.

    Returns
    -------
    bool
        Whether the image is grey; one in colour is read as its luma.

    Raises
    ------
    InputError
        When the file cannot be opened, see `craternav_fg.files.open_input`, or is not such an image.
    """
    with open_input(path, SizeLimit.IMAGE) as stream:
        head = stream.read(33)
        stream.seek(max(stream.seek(0, os.SEEK_END) - len(_END), 0))
        tail = stream.read()
    if not head.startswith(_SIGNATURE):
        raise InputError(path, "expected a PNG image")
    if len(head) < 33 or tail != _END:
        raise InputError(path, "image is truncated")
    width, height, depth, colour = struct.unpack(">IIBB", head[16:26])
    if (width, height) != (width_px, height_px):
        raise InputError(
            path, f"expected {width_px} x {height_px} px as in sensor.yaml, found {width} x {height}"
        )
    stored = 8 if bit_depth == 8 else 16
    allowed = _CONVERTED if stored == 8 else (_GREY,)
    if colour not in allowed or depth != stored:
        found = _COLOUR_TYPES.get(colour, "grey")
        expected = "an 8-bit" if stored == 8 else "a 16-bit"
        raise InputError(path, f"expected {expected} grey image, found {depth}-bit {found}")
    return bool(colour == _GREY)


def read_image(path: Path, width_px: int, height_px: int, bit_depth: int = 8) -> ImageArray:
    """Read an image.

    Parameters
    ----------
    path : Path
    width_px, height_px, bit_depth : int
        As in `check_image`.

    Returns
    -------
    ndarray of uint8 or uint16, shape (height, width)
        Grey levels; the luma (ITU-R BT.601) of an image in colour.

    Raises
    ------
    InputError
        When the file is missing, damaged or not such an image, or has grey levels beyond its bits.
    """
    grey = check_image(path, width_px, height_px, bit_depth)
    data = read_bytes(path, SizeLimit.IMAGE)
    _check_chunks(path, data)
    flag = cv2.IMREAD_UNCHANGED if grey else cv2.IMREAD_COLOR
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flag)
    if image is not None and not grey:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if image is None or image.shape != (height_px, width_px):
        raise InputError(path, "image is damaged")
    if bit_depth == 8:
        return image.astype(np.uint8, copy=False)
    if int(image.max()) >= 2**bit_depth:
        raise InputError(path, f"expected grey levels of {bit_depth} bits, found {int(image.max())}")
    return image.astype(np.uint16, copy=False)


def write_image(path: Path, image: ImageArray) -> None:
    """Write an image as PNG.

    Parameters
    ----------
    path : Path
    image : ndarray of uint8 or uint16, shape (height, width)
        Grey levels.
    """
    _, data = cv2.imencode(".png", image, _PNG)
    path.write_bytes(data.tobytes())


def _check_chunks(path: Path, data: bytes) -> None:
    """Refuse a chunk that is cut or damaged: the decoder would fill in black rows."""
    at = len(_SIGNATURE)
    while at < len(data):
        if at + 12 > len(data):
            raise InputError(path, "image is truncated")
        (length,) = struct.unpack(">I", data[at : at + 4])
        body = data[at + 4 : at + 8 + length]
        stored = data[at + 8 + length : at + 12 + length]
        if len(stored) < 4:
            raise InputError(path, "image is truncated")
        if zlib.crc32(body) != struct.unpack(">I", stored)[0]:
            raise InputError(path, "image is damaged: a checksum is wrong")
        at += 12 + length
