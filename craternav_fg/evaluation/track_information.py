"""Information of a descent's tracked points about its poses, for the posterior Cramér-Rao bound."""

from collections.abc import Mapping

import numpy as np

from craternav_fg.body import ground_points
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.point_features import (
    PRIOR_SHARE,
    linearise_points,
    lines_of_sight,
    triangulated,
)
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

POINT_SIZE = 3
_POSE = slice(0, 6)


class TrackInformation:
    """Observations of the tracks that are seen twice, linearised at true poses.

    A track's ground point is triangulated from the true poses; where its lines of sight are too close for
    that, it is where the first of them meets the body's sphere.

    Parameters
    ----------
    tracks : FeatureTracks
    descent : Descent
    truth : Trajectory
        At the frames' stamps.
    """

    def __init__(self, tracks: FeatureTracks, descent: Descent, truth: Trajectory) -> None:
        self._camera = descent.camera
        self._sigma = tracks.settings.sigma_px / descent.camera.focal_px
        self._gTb = truth.gTb
        self._points: dict[int, FloatArray] = {}
        # Standard deviation of a point's prior, m: the unit of its unknowns.
        self._unit_m: dict[int, float] = {}
        row_of = {stamp: k for k, stamp in enumerate(truth.stamps_ns.tolist())}
        used = np.isin(tracks.stamps_ns, truth.stamps_ns)
        self._rows = np.array([row_of[stamp] for stamp in tracks.stamps_ns[used].tolist()], dtype=np.int64)
        self._tracks = tracks.tracks[used]
        self._u = descent.camera.normalised(tracks.points_px[used])
        gTc = descent.camera.gTc(truth.gTb)
        for track in np.unique(self._tracks).tolist():
            mine = np.flatnonzero(self._tracks == track)
            if len(mine) > 1:
                self._place(track, self._u[mine], gTc[self._rows[mine]], descent.body.radius_m)
        known = np.isin(self._tracks, list(self._points))
        self._rows, self._tracks, self._u = self._rows[known], self._tracks[known], self._u[known]
        self._span = {
            track: (int(seen.min()), int(seen.max()))
            for track in self._points
            if len(seen := self._rows[self._tracks == track])
        }

    def _place(self, track: int, u: FloatArray, gTc: FloatArray, radius_m: float) -> None:
        point = triangulated(gTc[:, :3, 3], lines_of_sight(u, gTc), self._sigma)
        if point is None:
            level, hit = ground_points(gTc[0, :3, :3], gTc[0, :3, 3], u[:1], radius_m)
            if not hit[0]:
                return
            point = level[0]
        self._points[track] = point
        self._unit_m[track] = PRIOR_SHARE * float(np.linalg.norm(point - gTc[-1, :3, 3]))

    def alive(self, index: int) -> list[int]:
        """Tracks that were seen at a frame or before, and will be seen then or later.

        Parameters
        ----------
        index : int
            Index of the frame.

        Returns
        -------
        list of int
        """
        return [track for track, (first, last) in self._span.items() if first <= index <= last]

    def add(self, information: FloatArray, index: int, first: Mapping[int, int], sigmas: FloatArray) -> None:
        """Add the information of a frame's observations.

        Parameters
        ----------
        information : ndarray, shape (n, n)
            Information of all unknowns, changed in place.
        index : int
            Index of the frame.
        first : mapping of int to int
            Where the unknowns of each track's point begin.
        sigmas : ndarray, shape (15,)
            Units of the lander's state.
        """
        mine = np.flatnonzero(self._rows == index)
        if not len(mine):
            return
        names = self._tracks[mine].tolist()
        gL = np.array([self._points[track] for track in names])
        gTb = np.broadcast_to(self._gTb[index], (len(mine), 4, 4))
        _, of_point, of_pose = linearise_points(gL, gTb, self._u[mine], self._camera, self._sigma)
        of_pose = of_pose * sigmas[_POSE]
        for track, in_point, in_pose in zip(names, of_point, of_pose, strict=True):
            there = slice(first[track], first[track] + POINT_SIZE)
            in_point = in_point * self._unit_m[track]
            information[_POSE, _POSE] += in_pose.T @ in_pose
            information[_POSE, there] += in_pose.T @ in_point
            information[there, _POSE] += in_point.T @ in_pose
            information[there, there] += in_point.T @ in_point
