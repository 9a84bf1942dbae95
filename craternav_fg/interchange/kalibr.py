"""Calibration files of Kalibr: camchain.yaml and imu.yaml, read and written."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field

from craternav_fg import frames, lens
from craternav_fg.camera import Camera
from craternav_fg.config import Positive, Section, line_of, read_text, validate
from craternav_fg.dataset.sensor_files import LENS_NAMES, intrinsics_problem, lens_of
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuNoise
from craternav_fg.sensors.yaml_files import mounting, parse_yaml

# Kalibr's names of the lens models that it knows.
_NAMES = {lens.RADIAL_TANGENTIAL: "radtan", lens.FISHEYE: "equidistant"}
Row = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]


class _CameraOfChain(Section):
    camera_model: Literal["pinhole"]
    intrinsics: tuple[Positive, Positive, float, float]
    distortion_model: str
    distortion_coeffs: tuple[float, ...] = ()
    resolution: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    T_cam_imu: Annotated[tuple[Row, ...], Field(min_length=4, max_length=4)]
    T_cn_cnm1: Any = None
    timeshift_cam_imu: float = 0.0
    cam_overlaps: Any = None
    rostopic: str | None = None


class _Imu(Section):
    accelerometer_noise_density: Positive
    accelerometer_random_walk: Positive
    gyroscope_noise_density: Positive
    gyroscope_random_walk: Positive
    rostopic: str | None = None
    update_rate: Positive = 100.0


def is_camchain(path: Path) -> bool:
    """Return whether a YAML file is a camera chain of Kalibr: its first key is `cam0`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool

    Raises
    ------
    InputError
        When it is no YAML.
    """
    return "cam0" in parse_yaml(path, read_text(path))


def read_camchain(path: Path, name: str = "cam0") -> tuple[Camera, float]:
    """Read a camera of a chain that Kalibr calibrated with an IMU.

    Parameters
    ----------
    path : Path
        `camchain-imucam.yaml`.
    name : str
        Which camera.

    Returns
    -------
    camera : Camera
        Its mounting is the inverse of `T_cam_imu`.
    timeshift_s : float
        What to add to a stamp of the camera to have that of the IMU.

    Raises
    ------
    InputError
        When the file is wrong, has no such camera, a lens model that is not known here, or intrinsics that do
        not fit the resolution.
    """
    text = read_text(path)
    chain = parse_yaml(path, text)
    if not isinstance(chain.get(name), dict):
        raise InputError(path, f"expected a camera {name}, found {', '.join(chain) or 'none'}")
    file = validate(path, chain[name], _CameraOfChain, text=text)
    model = lens.RADIAL_TANGENTIAL if file.distortion_model == "none" else lens_of(file.distortion_model)
    line = line_of(text, [name, "distortion_model"])
    if model is None:
        known = ", ".join(names[1] for names in LENS_NAMES.values())
        problem = f"expected one of {known} or none, found {file.distortion_model}"
        raise InputError(path, problem, line=line, column=f"{name}.distortion_model")
    coefficients = file.distortion_coeffs or (0.0,) * 4
    if model == lens.RADIAL_TANGENTIAL and len(coefficients) == 4:
        coefficients = (*coefficients, 0.0)
    cTb = mounting(path, text, tuple(np.array(file.T_cam_imu).ravel().tolist()), (name, "T_cam_imu"))
    (width, height), (fx, fy, cx, cy) = file.resolution, file.intrinsics
    if wrong := intrinsics_problem(width, height, file.intrinsics):
        raise InputError(path, wrong, line=line_of(text, [name, "intrinsics"]), column=f"{name}.intrinsics")
    try:
        camera = Camera(
            width, height, fx, fy, cx, cy, frames.inverse(cTb), coefficients, lens_model=model
        )  # fmt: skip
    except ValueError as error:
        raise InputError(path, str(error), line=line, column=f"{name}.distortion_coeffs") from None
    return camera, file.timeshift_cam_imu


def read_kalibr_imu(path: Path) -> ImuNoise:
    """Read the noise of an IMU.

    Parameters
    ----------
    path : Path
        `imu.yaml`, or the `imu0` of `imu.yaml` that Kalibr writes.

    Returns
    -------
    ImuNoise

    Raises
    ------
    InputError
        When the file is wrong.
    """
    file = _imu_file(path)
    return ImuNoise(
        gyro_density_rad_s_sqrt_hz=file.gyroscope_noise_density,
        accelerometer_density_m_s2_sqrt_hz=file.accelerometer_noise_density,
        gyro_walk_rad_s2_sqrt_hz=file.gyroscope_random_walk,
        accelerometer_walk_m_s3_sqrt_hz=file.accelerometer_random_walk,
    )


def read_kalibr_imu_rate_hz(path: Path) -> float:
    """Read the nominal rate of an IMU.

    Parameters
    ----------
    path : Path
        As for `read_kalibr_imu`.

    Returns
    -------
    float
        100 where the file does not state it.

    Raises
    ------
    InputError
        When the file is wrong.
    """
    return _imu_file(path).update_rate


def _imu_file(path: Path) -> _Imu:
    """Read what `imu.yaml` says of the IMU, or of the first one."""
    text = read_text(path)
    data = parse_yaml(path, text)
    if isinstance(data.get("imu0"), dict):
        data = {key: value for key, value in data["imu0"].items() if key in _Imu.model_fields}
    return validate(path, data, _Imu, text=text)


def camchain_yaml(camera: Camera, topic: str) -> str:
    """Compose a camera chain of one camera.

    Parameters
    ----------
    camera : Camera
    topic : str
        Topic of its images in a bag.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        When Kalibr has no model for the lens: a rational one, or one with k3.
    """
    coefficients = camera.distortion
    if camera.lens_model == lens.RADIAL_TANGENTIAL:
        coefficients = coefficients[:4]
    if camera.lens_model not in _NAMES or any(camera.distortion[4:]):
        raise ValueError("expected a lens of radtan (k1, k2, p1, p2) or equidistant: Kalibr has no other")
    cTb = frames.inverse(camera.bTc)
    values = {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [float(v) for v in (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)],
            "distortion_model": _NAMES[camera.lens_model],
            "distortion_coeffs": [float(v) for v in coefficients],
            "resolution": [camera.width_px, camera.height_px],
            "T_cam_imu": [[float(v) for v in row] for row in cTb],
            "timeshift_cam_imu": 0.0,
            "rostopic": topic,
        }
    }
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None)


def kalibr_imu_yaml(noise: ImuNoise, rate_hz: float, topic: str) -> str:
    """Compose an imu.yaml.

    Parameters
    ----------
    noise : ImuNoise
    rate_hz : float
        Nominal rate of the log.
    topic : str
        Topic of the log in a bag.

    Returns
    -------
    str
    """
    values = {
        "accelerometer_noise_density": noise.accelerometer_density_m_s2_sqrt_hz,
        "accelerometer_random_walk": noise.accelerometer_walk_m_s3_sqrt_hz,
        "gyroscope_noise_density": noise.gyro_density_rad_s_sqrt_hz,
        "gyroscope_random_walk": noise.gyro_walk_rad_s2_sqrt_hz,
        "rostopic": topic,
        "update_rate": rate_hz,
    }
    return yaml.safe_dump(values, sort_keys=False)
