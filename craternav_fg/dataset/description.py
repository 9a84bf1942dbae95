"""The file dataset.toml: format version, body, initial state, motion model."""

from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import tomli_w
from pydantic import Field

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.config import (
    BodySection,
    Positive,
    Section,
    Vector,
    line_of,
    load_toml,
    parse_toml,
    read_text,
)
from craternav_fg.dataset import layout
from craternav_fg.errors import InputError
from craternav_fg.motion.model import Motion
from craternav_fg.motion.settings import MotionSection, motion_table
from craternav_fg.trajectory import InitialState
from factors.arrays import BoolArray, FloatArray

# Largest deviation of a quaternion's length from 1, from numbers of seven digits.
_UNIT_TOLERANCE = 1e-6
# A position nearer to the body's centre than this is in a wrong unit, or relative to the surface.
_MIN_RANGE_RADII = 0.5


class _Initial(Section):
    stamp_ns: Annotated[int, Field(ge=0)]
    position_m: Vector
    attitude_wxyz: tuple[float, float, float, float]
    velocity_m_s: Vector
    attitude_sigma_rad: Positive
    position_sigma_m: Positive
    velocity_sigma_m_s: Positive
    angular_velocity_sigma_rad_s: Positive
    gyro_bias_sigma_rad_s: Positive
    accelerometer_bias_sigma_m_s2: Positive
    angular_velocity_rad_s: Vector | None = None


class _Description(Section):
    format_version: int
    body: BodySection
    motion: MotionSection | None = None
    initial: _Initial | None = None


def read_description(path: Path) -> tuple[Body, InitialState | None]:
    """Read dataset.toml.

    Parameters
    ----------
    path : Path

    Returns
    -------
    body : Body
    initial : InitialState or None
        None without the table `initial`.

    Raises
    ------
    InputError
        When the file is missing or wrong, or of another format version.
    """
    text = read_text(path)
    _check_version(path, text)
    model = load_toml(path, _Description)
    initial = model.initial
    if initial is None:
        return model.body.body(), None
    norm = float(np.linalg.norm(initial.attitude_wxyz))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        _fail(path, text, "attitude_wxyz", f"expected a unit quaternion, its length is {norm:.9g}")
    gP = np.array(initial.position_m)
    if deep_in_body(gP, model.body.radius_m):
        _fail(path, text, "position_m", too_deep(gP))
    R = frames.from_quaternion_wxyz(np.array(initial.attitude_wxyz))
    return model.body.body(), InitialState(
        stamp_ns=initial.stamp_ns,
        gTb=frames.pose(R, gP),
        gV=np.array(initial.velocity_m_s),
        attitude_sigma_rad=initial.attitude_sigma_rad,
        position_sigma_m=initial.position_sigma_m,
        velocity_sigma_m_s=initial.velocity_sigma_m_s,
        angular_velocity_sigma_rad_s=initial.angular_velocity_sigma_rad_s,
        gyro_bias_sigma_rad_s=initial.gyro_bias_sigma_rad_s,
        accelerometer_bias_sigma_m_s2=initial.accelerometer_bias_sigma_m_s2,
        angular_velocity_rad_s=initial.angular_velocity_rad_s,
    )


def deep_in_body(gP: FloatArray, radius_m: float) -> BoolArray:
    """Tell which positions are in another unit, or relative to the surface.

    Parameters
    ----------
    gP : ndarray, shape (..., 3)
        In g, m.
    radius_m : float
        The body's radius.

    Returns
    -------
    ndarray of bool, shape (...,)
        False outside the body, or nearly so.
    """
    return np.asarray(np.linalg.norm(gP, axis=-1) < _MIN_RANGE_RADII * radius_m)


def too_deep(gP: FloatArray) -> str:
    """Say what is wrong with a position that is deep in the body.

    Parameters
    ----------
    gP : ndarray, shape (3,)
        In g, m.

    Returns
    -------
    str
    """
    return f"expected metres from the body's centre, found {np.linalg.norm(gP):g} m: deep in the body"


def read_motion(path: Path) -> Motion | None:
    """Read the motion model of dataset.toml; None without the table `motion`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Motion or None

    Raises
    ------
    InputError
        When the file, or that of the gravity field beside it, is missing or wrong.
    """
    model = load_toml(path, _Description)
    return None if model.motion is None else model.motion.motion(model.body.body(), path.parent)


def description_toml(body: Body, initial: InitialState | None, motion: Motion | None = None) -> str:
    """Compose the text of dataset.toml.

    Parameters
    ----------
    body : Body
    initial : InitialState or None
    motion : Motion, optional
        A gravity field that is more than a point mass is named `layout.GRAVITY`.

    Returns
    -------
    str
    """
    lines = [
        f"format_version = {layout.FORMAT_VERSION}",
        "",
        "[body]",
        tomli_w.dumps({"name": body.name}).strip(),
        f"radius_m = {float(body.radius_m)!r}",
        f"mu_m3_s2 = {float(body.mu_m3_s2)!r}",
        f"spin_rad_s = {_list(body.spin_rad_s)}",
    ]
    if motion is not None:
        table = motion_table(motion, layout.GRAVITY)
        lines += ["", tomli_w.dumps({"motion": table}).strip()]
    if initial is None:
        return "\n".join(lines) + "\n"
    q = frames.to_quaternion_wxyz(initial.gTb[:3, :3])
    lines += [
        "",
        "[initial]",
        f"stamp_ns = {initial.stamp_ns}",
        f"position_m = {_list(initial.gTb[:3, 3])}",
        f"attitude_wxyz = {_list(q)}",
        f"velocity_m_s = {_list(initial.gV)}",
    ]
    for key in (
        "attitude_sigma_rad",
        "position_sigma_m",
        "velocity_sigma_m_s",
        "angular_velocity_sigma_rad_s",
        "gyro_bias_sigma_rad_s",
        "accelerometer_bias_sigma_m_s2",
    ):
        lines.append(f"{key} = {float(getattr(initial, key))!r}")
    if initial.angular_velocity_rad_s is not None:
        lines.append(f"angular_velocity_rad_s = {_list(initial.angular_velocity_rad_s)}")
    return "\n".join(lines) + "\n"


def _list(values: object) -> str:
    return "[" + ", ".join(repr(float(v)) for v in np.asarray(values, dtype=np.float64)) + "]"


def _check_version(path: Path, text: str) -> None:
    """Refuse another format version before its keys are called unknown."""
    version = parse_toml(path, text).get("format_version")
    if isinstance(version, int) and version != layout.FORMAT_VERSION:
        later = ": written by a later version" if version > layout.FORMAT_VERSION else ""
        raise InputError(
            path,
            f"expected {layout.FORMAT_VERSION}, found {version}{later}",
            line=line_of(text, ["format_version"]),
            column="format_version",
        )


def _fail(path: Path, text: str, key: str, problem: str) -> NoReturn:
    raise InputError(path, problem, line=line_of(text, ["initial", key]), column=f"initial.{key}")
