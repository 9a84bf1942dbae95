"""Ground points of tracked features as variables of a graph.

A track becomes a variable when its observations show the point's distance: three of them, with a parallax
far above their noise. The reprojection factor is GTSAM's own; zero when the point's image is where it was
observed.
"""

from collections.abc import Callable

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X

from craternav_fg.camera import Camera
from craternav_fg.sensors.point_features import FeatureTracks

FloatArray = npt.NDArray[np.float64]

LETTER = "l"
LEAST_OBSERVATIONS = 3
# Parallax from which a track becomes a variable, and largest misfit of an observation then, in its sigmas.
PARALLAX_SIGMAS = 20.0
MISFIT_SIGMAS = 10.0
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
        # By track: observations (state's number, image point) that wait for parallax.
        self._waiting: dict[int, list[tuple[int, FloatArray]]] = {}
        self._variables: set[int] = set()
        self._last_ns = dict(zip(tracks.tracks.tolist(), tracks.stamps_ns.tolist(), strict=True))

    def enter(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        number: int,
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
        number : int
            Of the frame's state.
        stamp_ns : int
        pose : callable
            Estimate of a state's pose gTb (4, 4) by its number; None when it is no variable any more.
        point : callable
            Estimate of a ground point (3,) in g, m, by its key; None when it is no variable.
        """
        tracks, px = self._tracks.at(stamp_ns)
        for track, u in zip(tracks.tolist(), self._camera.normalised(px), strict=True):
            key = int(gtsam.symbol(LETTER, track))
            known = values.atPoint3(key) if values.exists(key) else point(key)
            if track in self._variables and known is not None:
                graph.push_back(self._factor(number, key, u))
            else:
                # A point that the solver gave up begins anew.
                self._variables.discard(track)
                self._waiting.setdefault(track, []).append((number, u))
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
        seen = [(n, u, gTb) for n, u in self._waiting[track] if (gTb := pose(n)) is not None]
        gTc = self._camera.gTc(np.array([gTb for _, _, gTb in seen]))
        place = known
        if place is None:
            if len(seen) < LEAST_OBSERVATIONS:
                return
            rays = np.array([[*u, 1.0] for _, u, _ in seen])
            rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
            rays = np.einsum("nij,nj->ni", gTc[:, :3, :3], rays)
            place = triangulated(gTc[:, :3, 3], rays, self._sigma)
            if place is None:
                return
            values.insert(key, place)
        self._variables.add(track)
        del self._waiting[track]
        range_m = float(np.linalg.norm(place - gTc[-1, :3, 3]))
        prior = gtsam.noiseModel.Isotropic.Sigma(3, PRIOR_SHARE * range_m)
        graph.push_back(gtsam.PriorFactorPoint3(key, place, prior))
        for n, u, _ in seen:
            graph.push_back(self._factor(n, key, u))

    def _factor(self, number: int, key: int, u: FloatArray) -> gtsam.NonlinearFactor:
        return gtsam.GenericProjectionFactorCal3_S2(
            u, self._noise, X(number), key, UNIT_CALIBRATION, False, False, self._bTc
        )
