"""The files sensor.yaml of camera and IMU, with the keys of EuRoC."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from craternav_fg.camera import Camera
from craternav_fg.config import Positive, Section, line_of, read_text, validate
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuNoise
from craternav_fg.sensors.yaml_files import dump_yaml, matrix, mounting, parse_yaml

# The distortion model's name in EuRoC, in Kalibr and in ROS.
_RADIAL_TANGENTIAL = ("radial-tangential", "radtan", "plumb_bob")


# Accepted focal lengths in image sizes: fields of view of 157 deg to 0.6 deg. Others are in another unit.
_FOCAL_RANGE_IMAGES = (0.1, 100.0)


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


class _ImuFile(Section):
    sensor_type: Literal["imu"]
    comment: str | None = None
    T_BS: _Matrix
    rate_hz: Positive
    gyroscope_noise_density: Positive
    gyroscope_random_walk: Positive
    accelerometer_noise_density: Positive
    accelerometer_random_walk: Positive


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
    if not (0.0 <= cx <= width - 1 and 0.0 <= cy <= height - 1):
        raise InputError(
            path,
            f"expected the principal point inside the {width} x {height} image, found ({cx:g}, {cy:g})",
            line=line_of(text, ["intrinsics"]),
            column="intrinsics",
        )
    least, most = _FOCAL_RANGE_IMAGES
    if not (least <= fx / width <= most and least <= fy / height <= most):
        raise InputError(
            path,
            f"expected focal lengths in px that fit the {width} x {height} image, found {fx:g} and {fy:g}",
            line=line_of(text, ["intrinsics"]),
            column="intrinsics",
        )
    bTc = mounting(path, text, model.T_BS.data)
    k1, k2, p1, p2, k3 = _distortion(path, text, model)
    try:
        return Camera(
            width, height, fx, fy, cx, cy, bTc,
            (k1, k2, p1, p2, k3), model.psf_sigma_px, model.bit_depth,
        )  # fmt: skip
    except ValueError as error:
        line = line_of(text, ["distortion_coefficients"])
        raise InputError(path, str(error), line=line, column="distortion_coefficients") from None


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
        gyro_density=model.gyroscope_noise_density,
        accelerometer_density=model.accelerometer_noise_density,
        gyro_walk=model.gyroscope_random_walk,
        accelerometer_walk=model.accelerometer_random_walk,
    )


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
    coefficients = camera.distortion if camera.distortion[4] else camera.distortion[:4]
    return dump_yaml(
        {
            "sensor_type": "camera",
            "comment": "pixel (0, 0) is the centre of the top-left pixel",
            "T_BS": matrix(camera.bTc),
            "rate_hz": rate_hz,
            "resolution": [camera.width_px, camera.height_px],
            "camera_model": "pinhole",
            "intrinsics": [float(v) for v in (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)],
            "distortion_model": "radial-tangential",
            "distortion_coefficients": [float(v) for v in coefficients],
            "psf_sigma_px": float(camera.psf_sigma_px),
            "bit_depth": camera.bit_depth,
        }
    )


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
            "gyroscope_noise_density": noise.gyro_density,
            "gyroscope_random_walk": noise.gyro_walk,
            "accelerometer_noise_density": noise.accelerometer_density,
            "accelerometer_random_walk": noise.accelerometer_walk,
        }
    )


def _distortion(path: Path, text: str, model: _CameraFile) -> tuple[float, ...]:
    """Coefficients k1, k2, p1, p2 and k3, which the file may leave out."""
    found = model.distortion_coefficients
    if model.distortion_model is None and not any(found):
        return (0.0,) * 5
    if model.distortion_model not in _RADIAL_TANGENTIAL:
        # Even with zeros for coefficients: an equidistant lens without distortion is no pinhole.
        name = "distortion_model"
        problem = f"expected {_RADIAL_TANGENTIAL[0]}, found {model.distortion_model or 'none'}"
    elif len(found) not in (4, 5):
        name = "distortion_coefficients"
        problem = f"expected 4 or 5 numbers (k1, k2, p1, p2, k3), found {len(found)}"
    else:
        return (*found, 0.0) if len(found) == 4 else found
    raise InputError(path, problem, line=line_of(text, [name]), column=name)
