"""Ground points of tracked features as variables of a graph.

A track becomes a variable when its observations show the point's distance: three of them, with a parallax
far above their noise. The reprojection factor is GTSAM's own; zero when the point's image is where it was
observed.
"""

import copy
from collections.abc import Callable

import gtsam
import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.sensors.point_features import FeatureTracks
from factors.arrays import FloatArray

LETTER = "l"
# Two would triangulate a point without checking it.
LEAST_OBSERVATIONS = 3
# Parallax from which a track becomes a variable, and largest misfit of an observation then, in its sigmas.
PARALLAX_SIGMAS = 20.0
MISFIT_SIGMAS = 10.0
# Standard deviation of the attitude above which points are not used: triangulated from poses that are wrong
# by more, they hold the trajectory where it is.
SETTLED_ATTITUDE_RAD = 0.02
# Sigma of the prior of a point, over its distance: so wide that it only keeps the system determined.
PRIOR_SHARE = 1.0
UNIT_CALIBRATION = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)


def triangulated(centres: FloatArray, directions: FloatArray, sigma_rad: float) -> FloatArray | None:
    """Find the point nearest to lines of sight.

    Parameters
    ----------
    centres : ndarray, shape (n, 3)
        Where they begin, in g, m.
    directions : ndarray, shape (n, 3)
        Unit vectors in g.
    sigma_rad : float
        Standard deviation of a direction.

    Returns
    -------
    ndarray, shape (3,), or None
        In g, m; None without enough parallax, or when the lines do not meet ahead.
    """
    parallax_rad = float(np.max(np.linalg.norm(directions - directions[0], axis=1)))
    if parallax_rad < PARALLAX_SIGMAS * sigma_rad:
        return None
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    point = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centres))
    away = point - centres
    depth = np.sum(away * directions, axis=1)
    off = np.linalg.norm(away - depth[:, None] * directions, axis=1)
    good = np.all(depth > 0.0) and np.all(off < MISFIT_SIGMAS * sigma_rad * depth)
    return np.asarray(point) if good else None


def linearise_points(
    gL: FloatArray, gTb: FloatArray, u: FloatArray, camera: Camera, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Linearise reprojections of ground points, each in one pose.

    Parameters
    ----------
    gL : ndarray, shape (n, 3)
        Ground points in g, m.
    gTb : ndarray, shape (n, 4, 4)
        Poses of the body in g, m.
    u : ndarray, shape (n, 2)
        Observed normalised image coordinates.
    camera : Camera
    sigma : float
        Standard deviation of a normalised coordinate.

    Returns
    -------
    residual : ndarray, shape (n, 2)
        Whitened, measured minus predicted.
    of_point : ndarray, shape (n, 2, 3)
        Derivatives of the whitened prediction in the point, 1/m.
    of_pose : ndarray, shape (n, 2, 6)
        Derivatives in the pose's error: attitude (rotation vector in b, rad), position (in g, m).
    """
    bTc = camera.bTc
    bRg = np.swapaxes(gTb[:, :3, :3], 1, 2)
    in_b = np.einsum("nij,nj->ni", bRg, gL - gTb[:, :3, 3])
    x, y, z = ((in_b - bTc[:3, 3]) @ bTc[:3, :3]).T
    zero = np.zeros_like(z)
    slope = np.stack([1.0 / z, zero, -x / z**2, zero, 1.0 / z, -y / z**2], axis=-1).reshape(-1, 2, 3)
    slope = slope @ bTc[:3, :3].T / sigma
    cross = np.zeros((len(z), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -in_b[:, 2], in_b[:, 1], -in_b[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    of_point = slope @ bRg
    residual = (u - np.stack([x / z, y / z], axis=-1)) / sigma
    return residual, of_point, np.concatenate([slope @ cross, -of_point], axis=2)


def lines_of_sight(u: FloatArray, gTc: FloatArray) -> FloatArray:
    """Directions in g in which points are seen.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        Normalised image coordinates.
    gTc : ndarray, shape (n, 4, 4)
        Poses of the camera in g, m.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors.
    """
    rays = np.concatenate([u, np.ones((len(u), 1))], axis=1)
    return np.einsum("nij,nj->ni", gTc[:, :3, :3], rays / np.linalg.norm(rays, axis=1, keepdims=True))


class FeatureStates:
    """Variables and factors of a descent's tracks, frame by frame.

    Parameters
    ----------
    tracks : FeatureTracks
    camera : Camera
    """

    def __init__(self, tracks: FeatureTracks, camera: Camera) -> None:
        self._tracks = tracks
        self._camera = camera
        self._sigma = tracks.settings.sigma_px / camera.focal_px
        self._bTc = gtsam.Pose3(camera.bTc)
        huber = gtsam.noiseModel.mEstimator.Huber.Create(tracks.settings.loss_sigmas)
        self._noise = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(2, self._sigma))
        # By track: observations (key of the pose, image point) that wait for parallax.
        self._waiting: dict[int, list[tuple[int, FloatArray]]] = {}
        self._variables: set[int] = set()
        self._last_ns = dict(zip(tracks.tracks.tolist(), tracks.stamps_ns.tolist(), strict=True))

    def copy(self) -> "FeatureStates":
        """Return a copy, which stays as it is when further frames enter."""
        out = copy.copy(self)
        out._waiting = {track: list(seen) for track, seen in self._waiting.items()}
        out._variables = set(self._variables)
        return out

    def enter(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        pose_key: int,
        stamp_ns: int,
        pose: Callable[[int], FloatArray | None],
        point: Callable[[int], FloatArray | None],
    ) -> None:
        """Add what a frame's observations say, and the variables that they complete.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
            Gets the points that are new.
        pose_key : int
            Key of the pose gTb at the frame's exposure.
        stamp_ns : int
        pose : callable
            Estimate of a pose gTb (4, 4), m, by its key; None when it is no variable any more.
        point : callable
            Estimate of a ground point (3,) in g, m, by its key; None when it is no variable.
        """
        tracks, px = self._tracks.at(stamp_ns)
        for track, u in zip(tracks.tolist(), self._camera.normalised(px), strict=True):
            key = int(gtsam.symbol(LETTER, track))
            known = values.atPoint3(key) if values.exists(key) else point(key)
            if track in self._variables and known is not None:
                graph.push_back(self._factor(pose_key, key, u))
            else:
                # A point that the solver gave up starts again.
                self._variables.discard(track)
                self._waiting.setdefault(track, []).append((pose_key, u))
                self._begin(graph, values, track, key, pose, known)
            if self._last_ns[track] == stamp_ns:
                self._variables.discard(track)
                self._waiting.pop(track, None)

    def _begin(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        track: int,
        key: int,
        pose: Callable[[int], FloatArray | None],
        known: FloatArray | None,
    ) -> None:
        """Make a variable of a track as soon as its observations allow it, or as soon as it is one."""
        seen = [(at, u, gTb) for at, u in self._waiting[track] if (gTb := pose(at)) is not None]
        gTc = self._camera.gTc(np.array([gTb for _, _, gTb in seen]))
        place = known
        if place is None:
            if len(seen) < LEAST_OBSERVATIONS:
                return
            rays = lines_of_sight(np.array([u for _, u, _ in seen]), gTc)
            place = triangulated(gTc[:, :3, 3], rays, self._sigma)
            if place is None:
                return
            values.insert(key, place)
        self._variables.add(track)
        del self._waiting[track]
        range_m = float(np.linalg.norm(place - gTc[-1, :3, 3]))
        prior = gtsam.noiseModel.Isotropic.Sigma(3, PRIOR_SHARE * range_m)
        graph.push_back(gtsam.PriorFactorPoint3(key, place, prior))
        for at, u, _ in seen:
            graph.push_back(self._factor(at, key, u))

    def _factor(self, pose_key: int, key: int, u: FloatArray) -> gtsam.NonlinearFactor:
        return gtsam.GenericProjectionFactorCal3_S2(
            u, self._noise, pose_key, key, UNIT_CALIBRATION, False, False, self._bTc
        )
