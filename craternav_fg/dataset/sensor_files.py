"""The files sensor.yaml of camera and IMU, with the keys of EuRoC."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from craternav_fg import lens
from craternav_fg.camera import Camera
from craternav_fg.config import Positive, Section, line_of, read_text, validate
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuNoise
from craternav_fg.sensors.yaml_files import dump_yaml, matrix, mounting, parse_yaml

# Names of the lens models here and in EuRoC, in Kalibr, in ROS and in OpenCV.
LENS_NAMES = {
    lens.RADIAL_TANGENTIAL: ("radial-tangential", "radtan", "plumb_bob"),
    lens.RATIONAL: ("rational_polynomial", "rational"),
    lens.FISHEYE: ("equidistant", "fisheye", "kannala-brandt"),
}

# Accepted focal lengths in image sizes: fields of view of 157 deg to 0.6 deg. Others are in another unit.
_FOCAL_RANGE_IMAGES = (0.1, 100.0)


# Densities in SI units; larger ones are in another unit, or tell nothing.
_GyroNoise = Annotated[float, Field(gt=0.0, le=10.0)]
_AccelerometerNoise = Annotated[float, Field(gt=0.0, le=1e4)]


class _Matrix(Section):
    cols: Literal[4]
    rows: Literal[4]
    data: Annotated[tuple[float, ...], Field(min_length=16, max_length=16)]


class _CameraFile(Section):
    sensor_type: Literal["camera"]
    comment: str | None = None
    T_BS: _Matrix
    rate_hz: Positive
    resolution: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    camera_model: Literal["pinhole"]
    intrinsics: tuple[Positive, Positive, float, float]
    distortion_model: str | None = None
    distortion_coefficients: tuple[float, ...] = ()
    psf_sigma_px: Annotated[float, Field(ge=0.0, le=10.0)] = Camera.psf_sigma_px
    bit_depth: Annotated[int, Field(ge=8, le=16)] = Camera.bit_depth
    focal_sigma_percent: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    principal_sigma_px: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    lever_arm_sigma_m: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    mounting_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] | None = None


class _ImuFile(Section):
    sensor_type: Literal["imu"]
    comment: str | None = None
    T_BS: _Matrix
    rate_hz: Positive
    gyroscope_noise_density: _GyroNoise
    gyroscope_random_walk: _GyroNoise
    accelerometer_noise_density: _AccelerometerNoise
    accelerometer_random_walk: _AccelerometerNoise


def read_camera(path: Path) -> Camera:
    """Read the camera's sensor.yaml.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Camera

    Raises
    ------
    InputError
        When the file is wrong, the distortion is of another model or folds inside the image, or the
        intrinsics do not fit the resolution.
    """
    text = read_text(path)
    model = validate(path, parse_yaml(path, text), _CameraFile, text=text)
    (width, height), (fx, fy, cx, cy) = model.resolution, model.intrinsics
    if wrong := intrinsics_problem(width, height, model.intrinsics):
        raise InputError(path, wrong, line=line_of(text, ["intrinsics"]), column="intrinsics")
    bTc = mounting(path, text, model.T_BS.data)
    lens_model, coefficients = _lens(path, text, model)
    try:
        return Camera(
            width, height, fx, fy, cx, cy, bTc,
            coefficients, model.psf_sigma_px, model.bit_depth, lens_model,
            model.focal_sigma_percent, model.principal_sigma_px, model.lever_arm_sigma_m,
            model.mounting_sigma_deg,
        )  # fmt: skip
    except ValueError as error:
        line = line_of(text, ["distortion_coefficients"])
        raise InputError(path, str(error), line=line, column="distortion_coefficients") from None


def intrinsics_problem(width: int, height: int, intrinsics: tuple[float, float, float, float]) -> str:
    """Describe what is wrong about intrinsics that do not belong to an image.

    Parameters
    ----------
    width, height : int
        Size of the image, px.
    intrinsics : tuple of float
        Focal lengths and principal point: fx, fy, cx, cy, px.

    Returns
    -------
    str
        What was expected and found; empty when they fit.
    """
    fx, fy, cx, cy = intrinsics
    if not (0.0 <= cx <= width - 1 and 0.0 <= cy <= height - 1):
        return f"expected the principal point inside the {width} x {height} image, found ({cx:g}, {cy:g})"
    least, most = _FOCAL_RANGE_IMAGES
    if not (least <= fx / width <= most and least <= fy / height <= most):
        return f"expected focal lengths in px that fit the {width} x {height} image, found {fx:g} and {fy:g}"
    return ""


def read_imu_noise(path: Path) -> ImuNoise:
    """Read the IMU's sensor.yaml.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ImuNoise

    Raises
    ------
    InputError
        When the file is wrong, or the IMU's frame is not b.
    """
    text = read_text(path)
    model = validate(path, parse_yaml(path, text), _ImuFile, text=text)
    if not np.array_equal(mounting(path, text, model.T_BS.data), np.eye(4)):
        raise InputError(
            path,
            "expected the identity: b is the IMU's frame",
            line=line_of(text, ["T_BS"]),
            column="T_BS",
        )
    return ImuNoise(
        gyro_density_rad_s_sqrt_hz=model.gyroscope_noise_density,
        accelerometer_density_m_s2_sqrt_hz=model.accelerometer_noise_density,
        gyro_walk_rad_s2_sqrt_hz=model.gyroscope_random_walk,
        accelerometer_walk_m_s3_sqrt_hz=model.accelerometer_random_walk,
    )


def read_imu_rate_hz(path: Path) -> float:
    """Read the nominal rate in the IMU's sensor.yaml.

    Parameters
    ----------
    path : Path

    Returns
    -------
    float

    Raises
    ------
    InputError
        When the file is wrong.
    """
    text = read_text(path)
    return float(validate(path, parse_yaml(path, text), _ImuFile, text=text).rate_hz)


def camera_yaml(camera: Camera, rate_hz: float) -> str:
    """Compose the text of the camera's sensor.yaml.

    Parameters
    ----------
    camera : Camera
    rate_hz : float
        Nominal rate of the images.

    Returns
    -------
    str
    """
    coefficients = camera.distortion
    if camera.lens_model == lens.RADIAL_TANGENTIAL and not any(coefficients[4:]):
        coefficients = coefficients[:4]
    values = {
        "sensor_type": "camera",
        "comment": "pixel (0, 0) is the centre of the top-left pixel",
        "T_BS": matrix(camera.bTc),
        "rate_hz": rate_hz,
        "resolution": [camera.width_px, camera.height_px],
        "camera_model": "pinhole",
        "intrinsics": [float(v) for v in (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)],
        "distortion_model": LENS_NAMES[camera.lens_model][0],
        "distortion_coefficients": [float(v) for v in coefficients],
        "psf_sigma_px": float(camera.psf_sigma_px),
        "bit_depth": camera.bit_depth,
    }
    for name in ("focal_sigma_percent", "principal_sigma_px", "lever_arm_sigma_m", "mounting_sigma_deg"):
        if (sigma := getattr(camera, name)) is not None:
            values[name] = float(sigma)
    return dump_yaml(values)


def imu_yaml(noise: ImuNoise, rate_hz: float) -> str:
    """Compose the text of the IMU's sensor.yaml.

    Parameters
    ----------
    noise : ImuNoise
    rate_hz : float
        Nominal rate of the log.

    Returns
    -------
    str
    """
    return dump_yaml(
        {
            "sensor_type": "imu",
            "comment": "each row is the mean over the interval that ends at its stamp",
            "T_BS": matrix(np.eye(4)),
            "rate_hz": rate_hz,
            "gyroscope_noise_density": noise.gyro_density_rad_s_sqrt_hz,
            "gyroscope_random_walk": noise.gyro_walk_rad_s2_sqrt_hz,
            "accelerometer_noise_density": noise.accelerometer_density_m_s2_sqrt_hz,
            "accelerometer_random_walk": noise.accelerometer_walk_m_s3_sqrt_hz,
        }
    )


def lens_of(name: str) -> str | None:
    """Return the lens model that a name means; None when it means none that is known.

    Parameters
    ----------
    name : str
        Name in EuRoC, Kalibr, ROS or OpenCV.

    Returns
    -------
    str or None
    """
    return next((model for model, names in LENS_NAMES.items() if name.lower() in names), None)


def _lens(path: Path, text: str, file: _CameraFile) -> tuple[str, tuple[float, ...]]:
    """Model and coefficients of the lens, k3 among those of a radial-tangential one."""
    found = file.distortion_coefficients
    if file.distortion_model is None and not any(found):
        return lens.RADIAL_TANGENTIAL, (0.0,) * 5
    model = lens_of(file.distortion_model or "")
    if model is None:
        known = ", ".join(names[0] for names in LENS_NAMES.values())
        problem = f"expected one of {known}, found {file.distortion_model or 'none'}"
        raise InputError(path, problem, line=line_of(text, ["distortion_model"]), column="distortion_model")
    if model == lens.RADIAL_TANGENTIAL and len(found) == 4:
        found = (*found, 0.0)
    return model, found
