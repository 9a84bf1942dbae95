"""A data set from ISIS cubes: of their own pixels, or of the photographs that they were made from."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import InputError
from craternav_fg.importing.assemble import ImportedFrame
from craternav_fg.importing.images import grey_images, grey_levels, stamps_of
from craternav_fg.importing.isis import Cube

# Grey levels of cubes are real numbers: of so many bits in the data set.
BIT_DEPTH = 12
# Largest difference, ns, of the times of a cube and of its photograph.
_SAME_TIME_NS = 1_000_000
# Largest difference of the principal points and focal lengths, px, of cubes of one camera.
_SAME_CAMERA_PX = 0.01


def of_cubes(cubes: Sequence[Cube]) -> tuple[Camera, list[ImportedFrame], list[ImageArray]]:
    """Take frames and pixels from cubes.

    Parameters
    ----------
    cubes : sequence of Cube
        Cubes of one camera: uncropped, or cropped at one place of the image.

    Returns
    -------
    camera : Camera
    frames : list of ImportedFrame
        In the order of time.
    images : list of ndarray of uint16, shape (height, width)
        Grey levels of `BIT_DEPTH` bits, scaled alike.

    Raises
    ------
    InputError
        When the cubes differ in size, resolution or place, or one has special pixels only.
    """
    cubes = sorted(cubes, key=lambda cube: cube.stamp_ns)
    first = cubes[0]
    for cube in cubes[1:]:
        one, other = first.camera, cube.camera
        if (one.width_px, one.height_px) != (other.width_px, other.height_px):
            expected = f"{one.width_px} x {one.height_px} px, as {first.path}"
            raise InputError(cube.path, f"expected {expected}, found {other.width_px} x {other.height_px}")
        off = np.abs(np.subtract(_intrinsics(one), _intrinsics(other))).max()
        if off > _SAME_CAMERA_PX:
            problem = f"shows another part of the photograph than {first.path} ({off:.0f} px apart)"
            raise InputError(cube.path, f"{problem}: give --photographs")
    frames = [ImportedFrame(cube.path, cube.stamp_ns, cube.state) for cube in cubes]
    images = grey_levels([cube.path for cube in cubes], [cube.pixels() for cube in cubes], BIT_DEPTH)
    return replace(first.camera, bit_depth=BIT_DEPTH), frames, images


def of_photographs(
    cubes: Sequence[Cube], images: Sequence[Path], times: Path
) -> tuple[Camera, list[ImportedFrame], list[ImageArray]]:
    """Take pixels from photographs of the whole field, and states from those cubes that are of one time.

    Parameters
    ----------
    cubes : sequence of Cube
    images : sequence of Path
        Grey images, each the whole photograph reduced to one size.
    times : Path
        Table of their times, see `importing.images`.

    Returns
    -------
    camera : Camera
        Camera of the images, by scaling that of the cubes' whole photographs.
    frames : list of ImportedFrame
        In the order of time.
    images : list of ndarray of uint8 or uint16, shape (height, width)
        Grey levels.

    Raises
    ------
    InputError
        When a cube has no photograph of its time, sizes differ, or an image is of another shape than the
        photograph.
    """
    stamps = stamps_of(images, times)
    frames = []
    left = list(cubes)
    for path, stamp in zip(images, stamps, strict=True):
        own = next((cube for cube in left if abs(cube.stamp_ns - stamp) <= _SAME_TIME_NS), None)
        if own is not None:
            left.remove(own)
        frames.append(ImportedFrame(path, stamp, None if own is None else own.state))
    if left:
        raise InputError(left[0].path, f"expected an image of its time among {len(images)}, found none")
    frames.sort(key=lambda frame: frame.stamp_ns)
    pixels = list(grey_images([frame.path for frame in frames]))
    height, width = pixels[0].shape
    parent = cubes[0].parent
    sx, sy = width / parent.width_px, height / parent.height_px
    if abs(sx / sy - 1.0) > 1.0 / min(width, height):
        expected = f"the shape of {parent.width_px} x {parent.height_px} samples and lines"
        raise InputError(frames[0].path, f"expected {expected}, found {width} x {height} px")
    # The outer edges of both coincide.
    camera = replace(
        parent,
        width_px=width, height_px=height, fx_px=sx * parent.fx_px, fy_px=sy * parent.fy_px,
        cx_px=sx * (parent.cx_px + 0.5) - 0.5, cy_px=sy * (parent.cy_px + 0.5) - 0.5,
        bit_depth=8 if pixels[0].dtype == np.uint8 else 16,
    )  # fmt: skip
    return camera, frames, pixels


def _intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    return camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
