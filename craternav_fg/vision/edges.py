"""Sub-pixel edge points along the normals of a predicted rim.

A rim crest is level across the rim, so it is as bright as locally flat terrain: the edge is where the
brightness crosses that reference, between the inner wall and the outer slope. The strongest gradient lies
inside the crest, further inside for larger craters. The slope contrast (see `photometry`) gives the side that
is the bright one. Where it runs along the rim there is no contrast across the rim, and no edge point.

Blurring moves the crossing, as the inner wall is steeper than the outer slope, and an oblique view does; see
`crest_tables`.
"""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.vision import edge_kernel, flank_kernel
from craternav_fg.vision.crest_tables import CrestTables, crest_tables
from craternav_fg.vision.ground_level import LEVEL_TERMS, smooth_level
from craternav_fg.vision.rim_shading import RimShading
from factors.arrays import FloatArray, ImageArray


@dataclass(frozen=True)
class EdgeOptions:
    """How edge points are searched along the normals of a rim.

    Attributes
    ----------
    smoothing_px, smoothing_share : float
        Standard deviation of the Gaussian smoothing along the normal: smoothing_px, at least smoothing_share
        of the radius. More smoothing suppresses texture and noise, but displaces the edge on an asymmetric
        rim crest.
    min_slope_contrast : float
        Minimum slope contrast across the rim of a normal that is searched (see `photometry`).
    min_step_share : float
        Minimum relative brightness step across an edge, for a slope contrast of 1.
    step_sigmas : float
        Minimum brightness step across an edge, in standard deviations of the pixel noise.
    """

    smoothing_px: float = 0.4
    smoothing_share: float = 0.02
    min_slope_contrast: float = 0.12
    min_step_share: float = 0.02
    step_sigmas: float = 3.0

    def noise_step(self, noise: float) -> float:
        """Return the least brightness step across an edge that noise of a standard deviation leaves."""
        # The difference of two pixels has twice the variance of one.
        return self.step_sigmas * float(np.sqrt(2.0)) * noise

    def crest_tables(self, psf_px: float) -> CrestTables:
        """Return what the canonical crest shows in images of a point-spread function, px, so smoothed."""
        return crest_tables(psf_px, self.smoothing_px, self.smoothing_share)


@dataclass(frozen=True)
class EdgePoints:
    """Edge points of one rim.

    Attributes
    ----------
    points_px : ndarray, shape (n, 2)
        In the pixels of `Camera.pinhole`.
    sigma_ratio : ndarray, shape (n,)
        Standard deviations relative to one another.
    motion : ndarray, shape (n, 2)
        Motion of the points, px, per relative change of the reference brightness.
    level : ndarray, shape (n,)
        Brightness of level ground at the points, relative to the reference, less 1, as the flanks of the rim
        crest show it; see `ground_level`.
    evidence : ndarray, shape (2,)
        How much the levels explain, see `ground_level.evidence_of_level`.
    tried : int
        Normals with enough contrast that lie in the image.
    normals : int
        All normals around the rim.
    """

    points_px: FloatArray
    sigma_ratio: FloatArray
    motion: FloatArray
    level: FloatArray
    evidence: FloatArray
    tried: int
    normals: int

    def __len__(self) -> int:
        return len(self.points_px)

    def at_level(self, share: float) -> "EdgePoints":
        """Move the points to where the brightness crosses the level of the ground.

        Parameters
        ----------
        share : float
            Share of the level to apply: 0 leaves the crossings of the reference brightness.
        """
        return replace(self, points_px=self.points_px + (share * self.level)[:, None] * self.motion)


def find_edge_points(
    image: ImageArray,
    camera: Camera,
    chart_px: FloatArray,
    shading: RimShading,
    radius_px: float,
    reach_px: float,
    noise: float,
    options: EdgeOptions,
    ground: FloatArray | None = None,
    *,
    thorough: bool = False,
) -> EdgePoints:
    """Find the edge points of one predicted rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    camera : Camera
    chart_px : ndarray, shape (5,)
        Predicted rim, chart in the pixels of `camera.pinhole`.
    shading : RimShading
    radius_px : float
        Size of the rim: sets the number of normals.
    reach_px : float
        Half length of the normals.
    noise : float
        Standard deviation of the pixel noise.
    options : EdgeOptions
    ground : ndarray, shape (5,), optional
        Level of the ground around the rim, see `level_around`; that of the reference if not given.
    thorough : bool
        Whether the rim is measured and not only found: an edge is also searched by its flanks alone, where
        the brightness crosses no reference; its place between samples follows a cubic, and its displacement
        depends on how narrow the crest and how steep the crater is. Edges of faint rims scatter more by
        that.

    Returns
    -------
    EdgePoints
        Possibly empty.
    """
    count = flank_kernel.normal_count(radius_px)
    noise_step = options.noise_step(noise) / shading.reference
    points, ratio, motion, tried, level, evidence = edge_kernel.trace_rim(
        image, chart_px, shading, reach_px, options.smoothing_share, options.smoothing_px,
        camera.psf_sigma_px, options.min_slope_contrast, options.min_step_share, noise_step, count,
        options.crest_tables(camera.psf_sigma_px), camera.lens,
        np.zeros(LEVEL_TERMS) if ground is None else ground, thorough,
    )  # fmt: skip
    return EdgePoints(points, ratio, motion, level, evidence, tried, count)


def level_around(
    image: ImageArray,
    camera: Camera,
    chart_px: FloatArray,
    shading: RimShading,
    radius_px: float,
    options: EdgeOptions,
) -> FloatArray:
    """Measure the smooth level of the ground around a fitted rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    camera : Camera
    chart_px : ndarray, shape (5,)
        Fitted rim, chart in the pixels of `camera.pinhole`.
    shading : RimShading
    radius_px : float
        As in `find_edge_points`.
    options : EdgeOptions

    Returns
    -------
    ndarray, shape (5,)
        See `ground_level.smooth_level`.
    """
    flanks = flank_kernel.flanks_around(
        image, chart_px, shading, options.smoothing_share, options.smoothing_px, camera.psf_sigma_px,
        flank_kernel.normal_count(radius_px), options.crest_tables(camera.psf_sigma_px), camera.lens,
    )  # fmt: skip
    return smooth_level(*flanks)
