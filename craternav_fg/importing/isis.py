"""One ISIS cube of a framing camera: pixels, camera, state, sun.

ISIS counts samples and lines from 1 at the centre of the first pixel, here pixels count from 0. Its camera
frame has axes of its own for each instrument; what the focal plane's x and y are in the image says the label
(ITRANSS, ITRANSL). Here x is along the samples, y along the lines, z = x cross y into the scene.

ISIS computes the SPICE tables of a framing camera for the middle of the exposure: StartTime and half of
ExposureDuration. Labels of Apollo's Metric camera have no ExposureDuration, and the tables are of StartTime.
"""

import math
import warnings
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.importing.assemble import CameraState
from craternav_fg.importing.images import stamp_of
from craternav_fg.importing.labels import CubeLabel, read_label
from factors.arrays import FloatArray

# Below it ISIS stores special pixels (NULL, saturation) of 32-bit cubes.
_LEAST_VALID = -3.4e38
# Largest displacement by a lens, px, that is left out: rims are measured to a tenth of a pixel.
_MAX_DISTORTION_PX = 0.2
# Longest exposure, s, which the tables of one image may cover: more is a line-scan camera's.
_MAX_EXPOSURE_S = 1.0
_SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
}


@dataclass(frozen=True)
class Cube:
    """A cube's image and what its label says of it.

    Attributes
    ----------
    path : Path
    stamp_ns : int
        UTC of the middle of the exposure, ns since 1970 without leap seconds.
    camera : Camera
        Camera of the cube's own pixels.
    parent : Camera
        Camera of the whole image that the cube was cropped from or reduced, in its full resolution.
    body : Body
        Its gravity is not in a cube: `mu_m3_s2` is 0.
    state : CameraState
    """

    path: Path
    stamp_ns: int
    camera: Camera
    parent: Camera
    body: Body
    state: CameraState

    def pixels(self) -> FloatArray:
        """Read the grey levels.

        Returns
        -------
        ndarray, shape (height, width)
            As stored, scaled by base and multiplier; NaN at special pixels.

        Raises
        ------
        CraternavError
            When rasterio is not installed.
        InputError
            When the pixels cannot be read.
        """
        try:
            import rasterio
        except ImportError:
            raise CraternavError("ISIS cubes need pvl, rasterio: pip install 'craternav_fg[isis]'") from None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
                with rasterio.open(self.path) as raster:
                    values = raster.read(1, masked=True).astype(np.float64)
                    values = values.filled(np.nan) * raster.scales[0] + raster.offsets[0]
        # rasterio decodes what GDAL says of a damaged label, byte by byte.
        except (rasterio.errors.RasterioError, UnicodeDecodeError) as error:
            raise InputError(self.path, f"pixels cannot be read: {' '.join(str(error).split())}") from None
        return np.where(values > _LEAST_VALID, values, np.nan)


def read_cube(path: Path) -> Cube:
    """Read the label and the SPICE tables of a cube.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Cube

    Raises
    ------
    CraternavError
        When pvl is not installed.
    InputError
        When the file is no cube, is cut, has no SPICE tables, or is not of a framing camera with little
        distortion.
    """
    label = read_label(path)
    width, height = _size(label)
    code = label.group("IsisCube", "Kernels").get("NaifFrameCode")
    naif = label.group("NaifKeywords")
    parent, axes = _parent_camera(label, naif, code, width, height)
    camera = _cropped(label, parent, width, height)
    body, state = _state(label, naif, axes)
    return Cube(path, _stamp_ns(label), camera, parent, body, state)


def _size(label: CubeLabel) -> tuple[int, int]:
    """Read samples and lines; refuse a file that ends before its pixels do."""
    core = label.group("IsisCube", "Core")
    dimensions = label.group("IsisCube", "Core", "Dimensions")
    kind = label.group("IsisCube", "Core", "Pixels").get("Type")
    sizes = {"UnsignedByte": 1, "SignedWord": 2, "UnsignedWord": 2, "Real": 4}
    if kind not in sizes:
        raise InputError(label.path, f"expected pixels of {', '.join(sizes)}, found {kind}", column="Type")
    width, height = int(label.number(dimensions, "Samples")), int(label.number(dimensions, "Lines"))
    end = int(label.number(core, "StartByte")) - 1 + sizes[kind] * width * height
    if end > len(label.data):
        problem = f"is truncated: expected {end} bytes or more, found {len(label.data)}"
        raise InputError(label.path, problem, column="Core")
    return width, height


def _stamp_ns(label: CubeLabel) -> int:
    """Return the middle of the exposure, to which the SPICE tables belong."""
    instrument = label.group("IsisCube", "Instrument")
    start = instrument.get("StartTime")
    if not isinstance(start, datetime):
        raise InputError(label.path, f"expected a time, found {start}", column="StartTime")
    return stamp_of(start) + round(0.5e9 * _exposure_s(label, instrument.get("ExposureDuration", 0.0)))


def _exposure_s(label: CubeLabel, stated: Any) -> float:
    """Read a duration; one without a unit is in ms."""
    unit = str(getattr(stated, "units", "ms")).lower()
    try:
        seconds = _SECONDS[unit] * float(getattr(stated, "value", stated))
    except (KeyError, TypeError, ValueError):
        seconds = math.nan
    if not 0.0 <= seconds <= _MAX_EXPOSURE_S:
        problem = f"expected an exposure of at most {_MAX_EXPOSURE_S:g} s, found {stated}"
        raise InputError(label.path, problem, column="ExposureDuration")
    return seconds


def _numbers(label: CubeLabel, naif: Any, name: str, count: int) -> FloatArray:
    """Read a keyword of the instrument kernel."""
    value = naif.get(name)
    try:
        values = np.atleast_1d(np.array(value, dtype=np.float64))
    except (TypeError, ValueError):
        values = np.empty(0)
    if len(values) < count or not np.isfinite(values).all():
        raise InputError(label.path, f"expected {count} numbers, found {value}", column=name)
    return values[:count]


def _parent_camera(
    label: CubeLabel, naif: Any, code: Any, width: int, height: int
) -> tuple[Camera, FloatArray]:
    """Camera of the whole image, and its axes (3, 3) in ISIS's camera frame, one per row."""
    if "AlphaCube" in label.label["IsisCube"]:
        alpha = label.group("IsisCube", "AlphaCube")
        width, height = (int(label.number(alpha, name)) for name in ("AlphaSamples", "AlphaLines"))
    focal_mm = float(_numbers(label, naif, f"INS{code}_FOCAL_LENGTH", 1)[0])
    sample = _numbers(label, naif, f"INS{code}_ITRANSS", 3)
    line = _numbers(label, naif, f"INS{code}_ITRANSL", 3)
    axes = np.stack([[*sample[1:], 0.0], [*line[1:], 0.0]])
    px_mm = np.linalg.norm(axes, axis=1)
    axes /= px_mm[:, None]
    axes = np.stack([axes[0], axes[1], np.cross(axes[0], axes[1])])
    # Detector coordinates count from the boresight, by default half the image's size in ISIS's pixels.
    boresight = np.array([0.5 * width, 0.5 * height])
    for k, name in enumerate(("BORESIGHT_SAMPLE", "BORESIGHT_LINE")):
        if f"INS{code}_{name}" in naif:
            boresight[k] = _numbers(label, naif, f"INS{code}_{name}", 1)[0]
    point_mm = np.zeros(2)
    if f"INS{code}_PP" in naif:
        point_mm = _numbers(label, naif, f"INS{code}_PP", 2)
    centre = boresight - 1.0 + [sample[0] + sample[1:] @ point_mm, line[0] + line[1:] @ point_mm]
    camera = Camera(width, height, focal_mm * px_mm[0], focal_mm * px_mm[1], centre[0], centre[1])
    _require_pinhole(label, naif, code, camera, focal_mm)
    return camera, axes


def _require_pinhole(label: CubeLabel, naif: Any, code: Any, camera: Camera, focal_mm: float) -> None:
    """Refuse a lens whose distortion rims would notice: each instrument has a model of its own in ISIS."""
    name = f"INS{code}_OD_K"
    if name not in naif:
        return
    k = np.atleast_1d(np.array(naif[name], dtype=np.float64))
    corner = math.hypot(camera.width_px / camera.fx_px, camera.height_px / camera.fy_px) * 0.5 * focal_mm
    radius = np.linspace(0.0, corner, 50)
    shift_mm = radius * sum(c * radius ** (2 * i) for i, c in enumerate(k))
    # What is proportional to the radius is a focal length.
    shift_mm -= radius * (radius @ shift_mm) / (radius @ radius)
    largest_px = float(np.abs(shift_mm).max()) * camera.fx_px / focal_mm
    width_px = label.number(label.group("IsisCube", "Core", "Dimensions"), "Samples")
    if largest_px * width_px / camera.width_px > _MAX_DISTORTION_PX:
        raise InputError(
            label.path,
            f"expected a lens that displaces by at most {_MAX_DISTORTION_PX} px, found {largest_px:.2f} px",
            column=name,
        )


def _cropped(label: CubeLabel, parent: Camera, width: int, height: int) -> Camera:
    """Camera of the cube's pixels, which may be a crop of the whole image at a lower resolution."""
    if "AlphaCube" not in label.label["IsisCube"]:
        return parent
    alpha = label.group("IsisCube", "AlphaCube")
    first, last, cropped = (
        np.array([label.number(alpha, before + name + after) for name in ("Sample", "Line")])
        for before, after in (("AlphaStarting", ""), ("AlphaEnding", ""), ("Beta", "s"))
    )
    step = (last - first) / cropped
    # Both ends are outer edges of pixels, in ISIS's count: the first pixel's centre is half a step inside.
    centre = (np.array([parent.cx_px, parent.cy_px]) + 1.0 - first) / step - 0.5
    return replace(
        parent,
        width_px=width, height_px=height, fx_px=parent.fx_px / step[0], fy_px=parent.fy_px / step[1],
        cx_px=float(centre[0]), cy_px=float(centre[1]),
    )  # fmt: skip


def _state(label: CubeLabel, naif: Any, axes: FloatArray) -> tuple[Body, CameraState]:
    """Body and state of the camera at the image."""
    pointing = _rotation(label, "InstrumentPointing")
    fixed = _rotation(label, "BodyRotation")
    if fixed[1] is None:
        problem = "expected the body's angular velocity beside its attitude, found attitudes only"
        raise InputError(label.path, problem, column="BodyRotation")
    position = _at_middle(label, "InstrumentPosition", 7)
    sun = _at_middle(label, "SunPosition", 4)
    # Body-fixed and camera axes from those of J2000.
    gRj, cRj = fixed[0], axes @ pointing[0]
    spin = gRj @ fixed[1]
    gP = 1e3 * gRj @ position[:3]
    gV = 1e3 * gRj @ position[3:6] - np.cross(spin, gP)
    # Few kernels of attitudes lack rates; a camera without is taken to keep its attitude among the stars.
    rate = np.zeros(3) if pointing[1] is None else cRj @ pointing[1]
    name = str(label.group("IsisCube", "Instrument").get("TargetName", "")).strip().capitalize()
    radii = [key for key, _ in naif.items() if key.startswith("BODY") and key.endswith("_RADII")]
    if not radii:
        raise InputError(label.path, "expected BODYnnn_RADII in NaifKeywords, found none")
    radius_m = 1e3 * round(float(np.mean(_numbers(label, naif, radii[0], 3))), 6)
    body = Body(name, radius_m, 0.0, (float(spin[0]), float(spin[1]), float(spin[2])))
    towards = gRj @ sun[:3]
    gTc = frames.pose(gRj @ cRj.T, gP)
    return body, CameraState(gTc, gV, rate, towards / np.linalg.norm(towards))


def _at_middle(label: CubeLabel, name: str, columns: int) -> FloatArray:
    """Row of a table at the middle of its time, which is its last column; vectors in km and km/s."""
    _, rows = label.table(name, columns)
    _require_short(label, name, rows)
    middle = 0.5 * (rows[0, -1] + rows[-1, -1])
    return np.array([np.interp(middle, rows[:, -1], rows[:, k]) for k in range(rows.shape[1])])


def _rotation(label: CubeLabel, name: str) -> tuple[FloatArray, FloatArray | None]:
    """Rotation (3, 3) from J2000 amid a table's time; angular velocity (3,) in J2000, rad/s, if stated."""
    keywords, rows = label.table(name, 5)
    _require_short(label, name, rows)
    middle = 0.5 * (rows[0, -1] + rows[-1, -1])
    k = int(np.argmin(np.abs(rows[:, -1] - middle)))
    # SPICE's quaternions, scalar first, turn coordinates from J2000.
    q = rows[k, :4]
    # The largest of four numbers whose squares sum to 1; those of very large ones are not finite.
    if not 0.49 < np.abs(q).max() < 1.01:
        raise InputError(label.path, f"expected unit quaternions, found {q.tolist()}", column=name)
    R = frames.from_quaternion_wxyz(q / np.linalg.norm(q))
    rate = rows[k, 4:7] if rows.shape[1] >= 8 else None
    constant = keywords.get("ConstantRotation")
    if constant is not None:
        R = np.array(constant, dtype=np.float64).reshape(3, 3) @ R
    return R, rate


def _require_short(label: CubeLabel, name: str, rows: FloatArray) -> None:
    covered_s = abs(float(rows[-1, -1] - rows[0, -1]))
    if covered_s > _MAX_EXPOSURE_S:
        problem = f"expected a framing camera's, found one over {covered_s:.1f} s: a line scan"
        raise InputError(label.path, problem, column=name)
