"""Geometry of the paper's simulated views: flat ground, craters in one plane, a camera of 44 deg by 44 deg.

No image is rendered: a scene is the camera's pose and the projected rims. g has its origin on the ground
and z up; body and camera coincide (bTc = 1).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.ellipse import half_sides
from craternav_fg.errors import CraternavError
from factors.arrays import FloatArray
from factors.kernels import conic

# Semi-axes of the craters of the paper's cases one and two, m (section 4.2.1).
SEMI_AXES_M = (500.0, 2500.0)
# Field of view of the paper's camera, 44 deg across 1024 px (section 4.2).
HALF_FIELD = float(np.tan(np.deg2rad(22.0)))
CAMERA = Camera(1024, 1024, 512.0 / HALF_FIELD, 512.0 / HALF_FIELD, 511.5, 511.5)
# Attitude of a camera that looks straight down, the top of its image to the north.
_NADIR = np.diag([1.0, -1.0, -1.0])
# Craters that are tried at one camera pose, and camera poses that are tried, before a scene is given up:
# hundreds are needed only where the image has next to no room.
_CRATER_TRIES = 200
_POSE_TRIES = 300
# Largest tilt of the optical axis from nadir; the tilt is uniform from 0.
_MAX_TILT_DEG = 30.0


@dataclass(frozen=True)
class FlatScene:
    """Craters, and a camera that has their whole rims in its image.

    Attributes
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera (and body) in g, m.
    centres : ndarray, shape (n, 3)
        Centres of the rims in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes of the rims in g, m.
    charts : ndarray, shape (n, 5)
        Projected rims in normalised image coordinates, without noise.
    """

    gTc: FloatArray
    centres: FloatArray
    axes: FloatArray
    charts: FloatArray


def tilted_camera(
    altitude: float, tilt_rad: float, azimuth_rad: float = 0.0, roll_rad: float = 0.0
) -> FloatArray:
    """Pose of a camera above the origin whose optical axis is tilted from nadir.

    Parameters
    ----------
    altitude : float
        In the unit of the scene's lengths.
    tilt_rad, azimuth_rad : float
        Angle from nadir, and the direction of the axis of this rotation.
    roll_rad : float
        Rotation about the optical axis.

    Returns
    -------
    ndarray, shape (4, 4)
        gTc.
    """
    tilt = tilt_rad * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    roll = np.array([0.0, 0.0, roll_rad])
    R = _NADIR @ frames.rotation_exp(tilt) @ frames.rotation_exp(roll)
    return frames.pose(R, np.array([0.0, 0.0, altitude]))


def ground_point(gTc: FloatArray, point: FloatArray) -> FloatArray:
    """Point of the ground that an image point shows.

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera.
    point : ndarray, shape (2,)
        Normalised image coordinates.

    Returns
    -------
    ndarray, shape (3,)
        In g, in the unit of the pose.
    """
    d = gTc[:3, :3] @ np.append(point, 1.0)
    return np.asarray(gTc[:3, 3] - d * gTc[2, 3] / d[2])


def flat_axes(semi_major: float, semi_minor: float, angle_rad: float) -> FloatArray:
    """Semi-axes of a rim that lies on the ground.

    Parameters
    ----------
    semi_major, semi_minor : float
    angle_rad : float
        Direction of the major axis, from x towards y.

    Returns
    -------
    ndarray, shape (2, 3)
        In g.
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[semi_major * c, semi_major * s, 0.0], [-semi_minor * s, semi_minor * c, 0.0]])


def inside(charts: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether rims lie wholly in the image.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        In normalised image coordinates.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    return np.asarray(np.all(np.abs(charts[:, :2]) + half_sides(charts) < HALF_FIELD, axis=1))


def random_scene(
    rng: np.random.Generator,
    craters: int,
    altitude_m: float,
    semi_axes_m: tuple[float, float] = SEMI_AXES_M,
) -> FlatScene:
    """Draw a scene of the paper's cases one and two: craters apart from one another, wholly in the image.

    At low altitude the image has no room for many large craters, and those that fit are smaller.

    Parameters
    ----------
    rng : Generator
    craters : int
    altitude_m : float
    semi_axes_m : tuple of float
        Each semi-axis is uniform between these; the longer of two is the major one.

    Returns
    -------
    FlatScene

    Raises
    ------
    CraternavError
        When the image has no room for that many.
    """
    for _ in range(_POSE_TRIES):
        tilt = np.deg2rad(_MAX_TILT_DEG) * rng.uniform()
        gTc = tilted_camera(altitude_m, tilt, *rng.uniform(0.0, 2.0 * np.pi, 2))
        centres: list[FloatArray] = []
        axes: list[FloatArray] = []
        charts: list[FloatArray] = []
        radii: list[float] = []
        for _ in range(_CRATER_TRIES):
            b, a = np.sort(rng.uniform(*semi_axes_m, 2))
            axis = flat_axes(a, b, rng.uniform(0.0, np.pi))
            centre = ground_point(gTc, rng.uniform(-HALF_FIELD, HALF_FIELD, 2))
            chart, visible = conic.project_rims(gTc, np.eye(4), centre[None], axis[None])
            if not (visible[0] and inside(chart)[0]):
                continue
            # Sufficient for rims that do not meet: circles around them do not.
            if any(np.hypot(*(centre - c)[:2]) < r + a for c, r in zip(centres, radii, strict=True)):
                continue
            centres.append(centre)
            axes.append(axis)
            charts.append(chart[0])
            radii.append(a)
            if len(centres) == craters:
                return FlatScene(gTc, np.array(centres), np.array(axes), np.array(charts))
    raise CraternavError(
        f"no room for {craters} craters with semi-axes of {semi_axes_m[0]:g} m or more in the image from "
        f"{altitude_m / 1e3:g} km: expected fewer craters or a higher altitude"
    )


def random_triple(rng: np.random.Generator, altitude: float, tilt_rad: float) -> FlatScene:
    """Draw a scene of the paper's section 2: three circles of radius 1 wholly in the image.

    The circles may overlap: from an altitude of 5 radii the image has no room for three that do not.

    Parameters
    ----------
    rng : Generator
    altitude : float
        In radii.
    tilt_rad : float
        Angle of the optical axis from nadir.

    Returns
    -------
    FlatScene
    """
    gTc = tilted_camera(altitude, tilt_rad, *rng.uniform(0.0, 2.0 * np.pi, 2))
    axes = np.repeat(flat_axes(1.0, 1.0, 0.0)[None], 3, axis=0)
    while True:
        points = rng.uniform(-HALF_FIELD, HALF_FIELD, (3, 2))
        centres = np.array([ground_point(gTc, point) for point in points])
        charts, visible = conic.project_rims(gTc, np.eye(4), centres, axes)
        if visible.all() and inside(charts).all():
            return FlatScene(gTc, centres, axes, charts)
