"""Tracked points in the filter: copies of past poses stay in the state, ground points are eliminated.

The multi-state constraint of Mourikis and Roumeliotis (2007): when a track ends, its observations from the
poses that the filter still holds give the ground point; what of their residuals does not depend on that point
is an ordinary measurement of those poses.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from craternav_fg.camera import Camera
from craternav_fg.estimators.ekf.fusion import fuse_updates
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.linearisation import LinearMeasurement
from craternav_fg.estimators.point_features import (
    LEAST_OBSERVATIONS,
    SETTLED_ATTITUDE_RAD,
    linearise_points,
    lines_of_sight,
    triangulated,
)
from craternav_fg.frames import rotation_exp
from craternav_fg.sensors.point_features import FeatureTracks
from factors.arrays import FloatArray
from factors.kernels.strapdown import ATTITUDE

# Past poses that the state holds.
WINDOW = 12
# Refinements of a ground point by Gauss-Newton.
ITERATIONS = 4
# Variance that a copied pose gains, over its own: an exact copy would make the covariance singular.
CLONE_NOISE = 1e-8
# A track less likely than this is of no one point.
PROBABILITY = 0.999


@dataclass(frozen=True)
class _Clone:
    stamp_ns: int
    gTb: FloatArray


class FeatureWindow:
    """The filter's past poses and the tracks that they see.

    Parameters
    ----------
    tracks : FeatureTracks
    camera : Camera
    first : int
        Length of the error state without past poses: they come behind.
    """

    def __init__(self, tracks: FeatureTracks, camera: Camera, first: int) -> None:
        self._tracks = tracks
        self._camera = camera
        self._sigma = tracks.settings.sigma_px / camera.focal_px
        self._first = first
        self._clones: list[_Clone] = []
        # By track: stamps and image points of its observations from poses that are held.
        self._seen: dict[int, list[tuple[int, FloatArray]]] = {}

    def without_clones(self, state: FilterState) -> FilterState:
        """Return a state without its past poses."""
        keep = slice(0, self._first)
        biases = state.sensor_bias[: len(state.sensor_bias) - 6 * len(self._clones)]
        return replace(state, covariance=state.covariance[keep, keep], sensor_bias=biases)

    def update(self, state: FilterState, stamp_ns: int) -> FilterState:
        """Take a frame's observations: use the tracks that ended, and hold the pose of those that go on.

        Parameters
        ----------
        state : FilterState
            At the frame, with the past poses behind its error state.
        stamp_ns : int

        Returns
        -------
        FilterState
        """
        tracks, px = self._tracks.at(stamp_ns)
        attitude = np.diag(state.covariance)[ATTITUDE]
        if attitude.max() > SETTLED_ATTITUDE_RAD**2 and not self._clones:
            return state
        here = set(tracks.tolist())
        ended = [track for track in self._seen if track not in here]
        state = self._use(state, ended)
        if not len(tracks):
            return state
        state = self._hold(state, stamp_ns)
        for track, u in zip(tracks.tolist(), self._camera.normalised(px), strict=True):
            self._seen.setdefault(track, []).append((stamp_ns, u))
        if len(self._clones) > WINDOW:
            oldest = self._clones[0].stamp_ns
            state = self._use(state, [t for t, seen in self._seen.items() if seen[0][0] == oldest])
            state = self._drop_oldest(state)
        return state

    def _hold(self, state: FilterState, stamp_ns: int) -> FilterState:
        """Copy the present pose behind the error state."""
        self._clones.append(_Clone(stamp_ns, state.gTb))
        P = state.covariance
        n = len(P)
        whole = np.empty((n + 6, n + 6))
        whole[:n, :n], whole[n:, :n], whole[:n, n:] = P, P[POSE], P[:, POSE]
        whole[n:, n:] = P[POSE, POSE] + CLONE_NOISE * np.diag(np.diag(P[POSE, POSE]))
        return replace(state, covariance=whole, sensor_bias=np.append(state.sensor_bias, np.zeros(6)))

    def _drop_oldest(self, state: FilterState) -> FilterState:
        self._clones.pop(0)
        rows = np.delete(np.arange(len(state.covariance)), np.arange(self._first, self._first + 6))
        begin = len(state.sensor_bias) - 6 * (len(self._clones) + 1)
        biases = np.delete(state.sensor_bias, np.arange(begin, begin + 6))
        return replace(state, covariance=state.covariance[np.ix_(rows, rows)], sensor_bias=biases)

    def _poses(self, state: FilterState) -> dict[int, tuple[FloatArray, int]]:
        """Poses (4, 4) held, as corrected since, and where their errors begin, by stamp."""
        out = {}
        begin = len(state.sensor_bias) - 6 * len(self._clones)
        for k, clone in enumerate(self._clones):
            moved = state.sensor_bias[begin + 6 * k : begin + 6 * k + 6]
            gTb = clone.gTb.copy()
            gTb[:3, :3] = gTb[:3, :3] @ rotation_exp(moved[:3])
            gTb[:3, 3] += moved[3:]
            out[clone.stamp_ns] = gTb, self._first + 6 * k
        return out

    def _use(self, state: FilterState, tracks: list[int]) -> FilterState:
        """Update by some tracks, and forget their observations."""
        poses = self._poses(state)
        rows = []
        for track in tracks:
            seen = [(*poses[stamp], u) for stamp, u in self._seen.pop(track) if stamp in poses]
            measured = self._constraint(state, seen) if len(seen) >= LEAST_OBSERVATIONS else None
            if measured is not None:
                rows.append(measured)
        if not rows:
            return state
        A = np.concatenate([one.A for one in rows])
        residual = np.concatenate([one.residual for one in rows])
        if len(A) > A.shape[1]:
            # As many rows as unknowns carry it all.
            Q, A = np.linalg.qr(A)
            residual = Q.T @ residual
        delta, covariance = fuse_updates(state.covariance, [LinearMeasurement(A, residual)], "exact")
        return state.corrected(delta, covariance)

    def _constraint(
        self, state: FilterState, seen: list[tuple[FloatArray, int, FloatArray]]
    ) -> LinearMeasurement | None:
        """Measure the poses by a track, its ground point eliminated; None when it is of no one point."""
        gTb = np.array([pose for pose, _, _ in seen])
        u = np.array([point for _, _, point in seen])
        gTc = self._camera.gTc(gTb)
        point = triangulated(gTc[:, :3, 3], lines_of_sight(u, gTc), self._sigma)
        if point is None:
            return None
        for last in range(ITERATIONS, -1, -1):
            places = np.broadcast_to(point, (len(u), 3))
            found, of_point, H_poses = linearise_points(places, gTb, u, self._camera, self._sigma)
            residual, H_point = found.ravel(), of_point.reshape(-1, 3)
            if last:
                point = point + np.linalg.lstsq(H_point, residual, rcond=None)[0]
        A = np.zeros((len(residual), len(state.covariance)))
        for k, (_, first, _) in enumerate(seen):
            A[2 * k : 2 * k + 2, first : first + 6] = H_poses[k]
        null = np.linalg.qr(H_point, mode="complete")[0][:, 3:]
        A, residual = null.T @ A, null.T @ residual
        S = A @ state.covariance @ A.T + np.eye(len(A))
        if residual @ np.linalg.solve(S, residual) > chdtri(len(A), 1.0 - PROBABILITY):
            return None
        return LinearMeasurement(A, residual)
