"""Points of the ground followed from image to image by OpenCV's Lucas-Kanade tracker.

Corners away from measured rims are tracked into the next image and back again. A point that does not come
back to where it began is lost. A track ends after some frames, as the errors of its steps add up.

Between photographs from orbit a point moves by a quarter of the image, far more than the tracker finds. Where
the poses are known roughly, it therefore searches near the place that they predict for a point of the sphere.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.ellipse import points_on
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.point_features import FeatureSettings, FeatureTracks
from factors.arrays import FloatArray, IntArray

Image = npt.NDArray[np.uint8]

# Scale, px, of the shading that is taken out of an image, and the contrast of what remains, of 255 levels:
# the tracker compares grey levels as they are, and exposures differ.
SHADING_PX = 12.0
CONTRAST = 32.0
# Largest mean difference of a patch from one image to the next, as a share of that contrast.
LARGEST_DIFFERENCE = 0.5
# Steps and minimum change, px, at which the tracker's iteration ends.
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 0.005)


@dataclass(frozen=True)
class PointTrackOptions:
    """Which points are tracked, and how well they are known.

    Attributes
    ----------
    count : int
        Points tracked in an image; 0: none.
    sigma_px : float
        Standard deviation of an image coordinate that the estimators assume.
    longest_frames : int
        Frames after which a track ends.
    window_px : int
        Side of the patch that is compared, px.
    levels : int
        Halvings of the image: the tracker finds motions of about the window times 2 to this power.
    return_px : float
        Largest distance between a point and where the way back leads.
    distance_px : float
        Minimum distance between new points, and of points from measured rims.
    quality_share : float
        Minimum strength of a corner, as a share of the strongest.
    """

    count: int = 0
    sigma_px: float = 0.5
    longest_frames: int = 12
    window_px: int = 21
    levels: int = 4
    return_px: float = 0.5
    distance_px: float = 15.0
    quality_share: float = 0.02


@dataclass(frozen=True)
class GroundMotion:
    """Motion of the ground's image from frame to frame, as rough poses predict it.

    Attributes
    ----------
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g at the frames, m.
    radius_m : float
        Radius of the sphere that stands for the ground.
    """

    gTb: FloatArray
    radius_m: float

    def predicted(self, camera: Camera, index: int, points_px: FloatArray) -> FloatArray:
        """Predict where points of one image are in the next.

        Parameters
        ----------
        camera : Camera
        index : int
            Index of the next frame.
        points_px : ndarray, shape (n, 2)
            px, in the frame before.

        Returns
        -------
        ndarray, shape (n, 2)
            px; NaN for points beside the body or not in front of the camera.
        """
        before, after = camera.gTc(self.gTb[index - 1]), camera.gTc(self.gTb[index])
        seen = camera.normalised(points_px)
        ground, hit = ground_points(before[:3, :3], before[:3, 3], seen, self.radius_m)
        x, y, z = ((ground - after[:3, 3]) @ after[:3, :3]).T
        z = np.where(hit & (z > 0.0), z, np.nan)
        return np.asarray(camera.pixels(np.stack([x / z, y / z], axis=-1)))


class PointTracker:
    """Follows points through the images of a descent.

    Parameters
    ----------
    camera : Camera
    options : PointTrackOptions
    motion : GroundMotion, optional
        Without it points are searched where they were in the image before.
    """

    def __init__(
        self, camera: Camera, options: PointTrackOptions, motion: GroundMotion | None = None
    ) -> None:
        self._motion = motion
        self._index = 0
        self._camera = camera
        self._options = options
        self._before: Image | None = None
        self._points = np.empty((0, 2), dtype=np.float32)
        self._names = np.empty(0, dtype=np.int64)
        self._ages = np.empty(0, dtype=np.int64)
        self._begun = 0

    def follow(self, image: npt.NDArray[np.generic], frame: FrameMeasurement) -> tuple[IntArray, FloatArray]:
        """Track the points into the next image, and begin new ones.

        Parameters
        ----------
        image : ndarray, shape (height, width)
            Grey levels.
        frame : FrameMeasurement
            Its rims: no point begins near them.

        Returns
        -------
        tracks : ndarray of int, shape (n,)
        points_px : ndarray, shape (n, 2)
            px.
        """
        grey = _eight_bits(image)
        if self._before is not None and len(self._points):
            found, sound = self._tracked(self._before, grey)
            sound &= self._ages < self._options.longest_frames
            self._points, self._names = found[sound], self._names[sound]
            self._ages = self._ages[sound] + 1
        self._begin(grey, frame)
        self._before = grey
        self._index += 1
        return self._names.copy(), self._points.astype(np.float64)

    def _tracked(self, before: Image, grey: Image) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Points (n, 2) in the next image, and which of them come back to where they began."""
        tracker: dict[str, Any] = {
            "winSize": (self._options.window_px,) * 2,
            "maxLevel": self._options.levels,
            "criteria": CRITERIA,
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        }
        start = self._points.reshape(-1, 1, 2)
        guess = self._guess(start)
        known = np.isfinite(guess[:, 0]).all(axis=1)
        guess[~known] = start[~known]
        ahead, there, difference = cv2.calcOpticalFlowPyrLK(before, grey, start, guess.copy(), **tracker)
        back, again, _ = cv2.calcOpticalFlowPyrLK(grey, before, ahead, ahead + (start - guess), **tracker)
        away = np.linalg.norm((back - start)[:, 0], axis=1)
        found = np.asarray(ahead[:, 0], dtype=np.float32)
        inside = self._camera.contains(found.astype(np.float64), margin_px=0.5 * self._options.window_px)
        alike = difference[:, 0] < LARGEST_DIFFERENCE * CONTRAST
        sound = (there[:, 0] == 1) & (again[:, 0] == 1) & (away < self._options.return_px)
        return found, np.asarray(sound & alike & inside & known)

    def _guess(self, start: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Predict the points (n, 1, 2) in the next image."""
        if self._motion is None:
            return start.copy()
        points = self._motion.predicted(self._camera, self._index, start[:, 0].astype(np.float64))
        return points.astype(np.float32).reshape(-1, 1, 2)

    def _begin(self, grey: Image, frame: FrameMeasurement) -> None:
        """Begin tracks at corners away from points, rims and the border."""
        options = self._options
        missing = options.count - len(self._points)
        if missing <= 0:
            return
        border = options.window_px // 2 + 1
        mask = np.zeros_like(grey)
        mask[border:-border, border:-border] = 255
        radius = round(options.distance_px)
        for outline in points_on(frame.rims.chart):
            px = np.round(self._camera.pixels(outline)).astype(np.int32)
            cv2.polylines(mask, [px.reshape(-1, 1, 2)], True, 0, 2 * radius + 1)
        for x, y in np.round(self._points).astype(int).tolist():
            cv2.circle(mask, (x, y), radius, 0, -1)
        corners = cv2.goodFeaturesToTrack(
            grey, missing, options.quality_share, options.distance_px, mask=mask
        )
        if corners is None:
            return
        new = corners.reshape(-1, 2).astype(np.float32)
        self._points = np.concatenate([self._points, new])
        self._names = np.concatenate([self._names, self._begun + np.arange(len(new), dtype=np.int64)])
        self._ages = np.concatenate([self._ages, np.ones(len(new), dtype=np.int64)])
        self._begun += len(new)


def track_points(
    images: Iterable[npt.NDArray[np.generic]],
    frames: Sequence[FrameMeasurement],
    camera: Camera,
    options: PointTrackOptions,
    motion: GroundMotion | None = None,
) -> FeatureTracks:
    """Track points through the images of a descent.

    Parameters
    ----------
    images : iterable of ndarray, shape (height, width)
        Grey levels, one image for each frame.
    frames : sequence of FrameMeasurement
        Their stamps and rims.
    camera : Camera
    options : PointTrackOptions
    motion : GroundMotion, optional
        Motion from frame to frame that rough poses predict.

    Returns
    -------
    FeatureTracks
        Tracks of the points that are seen in two frames or more.
    """
    tracker = PointTracker(camera, options, motion)
    found = [tracker.follow(image, frame) for image, frame in zip(images, frames, strict=True)]
    stamps = np.repeat([frame.stamp_ns for frame in frames], [len(names) for names, _ in found])
    tracks = np.concatenate([names for names, _ in found])
    points = np.concatenate([px for _, px in found])
    seen = np.bincount(tracks, minlength=1)[tracks] > 1 if len(tracks) else np.zeros(0, dtype=np.bool_)
    settings = FeatureSettings(sigma_px=options.sigma_px)
    return FeatureTracks(settings, stamps[seen].astype(np.int64), tracks[seen], points[seen])


def _eight_bits(image: npt.NDArray[np.generic]) -> Image:
    """Take out the shading, and scale what remains to 8 bits."""
    levels = np.asarray(image, dtype=np.float32)
    detail = levels - cv2.GaussianBlur(levels, (0, 0), SHADING_PX)
    scale = CONTRAST / max(float(detail.std()), 1e-6)
    return np.clip(128.0 + scale * detail, 0.0, 255.0).astype(np.uint8)
