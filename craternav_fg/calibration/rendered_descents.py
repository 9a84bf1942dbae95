"""Errors of rims that are measured in rendered descents.

Outlines are ellipses on the Moon, irregular on Dione and Bennu, whose ground has another reflectance. The
scenarios are those that are shipped, with fewer frames and the sun anywhere; their trials are others than
those of any test or figure. Rims are measured from predictions that are a little wrong.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from craternav_fg import frames
from craternav_fg.calibration.single_rims import SingleRims, fitted_alone
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.ellipse import pixel_chart, semi_minor
from craternav_fg.ellipse_distance import signed_distances
from craternav_fg.measurements import ArcSet, RimSet
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.world import World, make_world
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, in_plane_slopes
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import FloatArray, IntArray
from factors.kernels.conic import project_rims

_SCENARIOS = ("lunar_descent", "dione_descent", "bennu_descent")
# Per scenario: descents, frames of each, first trial (tests use others), and range of the sun's elevation.
_DESCENTS = 8
_FRAMES = 11
_FIRST_TRIAL = 900
_SUN_ELEVATION_DEG = (15.0, 60.0)
# Predictions: standard deviation of each angle, rad, half a pixel; of each coordinate over the altitude.
_ATTITUDE_SIGMA_RAD, _POSITION_SIGMA_SHARE = 7e-4, 1e-3
# With each size 1 the front end's roots are the patterns alone, which the fits then scale.
_UNIT = CorrelatedErrorOptions(
    crater_share=1.0, excess_white_share=1.0, camera_shift_px=1.0, sun_shift_px=1.0, stretch_px=1.0,
    stretch_share=1.0, size_px=1.0, size_share=1.0, brightness_share=1.0,
)  # fmt: skip
# Column of the brightness error in the roots of the shared errors.
_BRIGHTNESS = 7


@dataclass(frozen=True)
class MeasuredRims:
    """Errors of a frame's rims, and of what their covariances are made. Charts are normalised.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
    error : ndarray, shape (n, 5)
        Measured less true charts.
    chart : ndarray, shape (n, 5)
        True charts.
    slopes : ndarray, shape (n, 5, 5)
        See `in_plane_slopes`.
    points : ndarray, shape (n, 5, 5)
        Covariance from the scatter of the edge points.
    crater : ndarray, shape (n, 5, 5)
        Systematic covariance but for the part from the reference brightness.
    brightness : ndarray, shape (n, 5)
        Root of that part.
    shared : ndarray, shape (n, 5, 7)
        Roots of the errors that all rims share, of size 1, without that from the brightness.
    excess : ndarray, shape (n, 5, 5)
        White covariance that is added for an `excess_white_share` of 1.
    outline_share : ndarray, shape (n,)
        See `RimQuality`.
    """

    craters: IntArray
    error: FloatArray
    chart: FloatArray
    slopes: FloatArray
    points: FloatArray
    crater: FloatArray
    brightness: FloatArray
    shared: FloatArray
    excess: FloatArray
    outline_share: FloatArray

    @property
    def systematic(self) -> FloatArray:
        """Covariance (n, 5, 5) of all that is systematic."""
        return self.crater + self.brightness[:, :, None] * self.brightness[:, None, :]


@dataclass(frozen=True)
class MeasuredArcs:
    """Errors of a frame's arcs.

    Attributes
    ----------
    shift_px : ndarray, shape (n,)
        Weighted mean of the edge points' distances outside the true rim.
    white_px2 : ndarray, shape (n,)
        Its variance as the points' white errors have it.
    minor_px : ndarray, shape (n,)
        True semi-minor axes of the rims.
    outline_share : float
        Median of the frame's rims.
    """

    shift_px: FloatArray
    white_px2: FloatArray
    minor_px: FloatArray
    outline_share: float


@dataclass(frozen=True)
class MeasuredDescent:
    """Rims and arcs of the frames of one descent that show any, and the errors of single rims.

    Attributes
    ----------
    rims : tuple of MeasuredRims
    arcs : tuple of MeasuredArcs
    single : tuple of SingleRims
    """

    rims: tuple[MeasuredRims, ...]
    arcs: tuple[MeasuredArcs, ...]
    single: tuple[SingleRims, ...]


@cache
def measured_descents() -> tuple[MeasuredDescent, ...]:
    """Render and measure the descents: about two minutes, once in a process."""
    return tuple(
        _measured(_world(name, trial), trial)
        for name in _SCENARIOS
        for trial in range(_FIRST_TRIAL, _FIRST_TRIAL + _DESCENTS)
    )


def _world(name: str, trial: int) -> World:
    scenario = load_scenario(name)
    rng = np.random.default_rng([trial, 0])
    trajectory, sun = scenario.trajectory, scenario.sun
    interval_s = trajectory.duration_s / (_FRAMES - 1)
    azimuth_deg, elevation_deg = float(rng.uniform(0.0, 360.0)), float(rng.uniform(*_SUN_ELEVATION_DEG))
    changed = {
        "trajectory": trajectory.model_copy(update={"frame_interval_s": interval_s}),
        "sun": sun.model_copy(update={"azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}),
    }
    return make_world(scenario.model_copy(update=changed), rng, trial=True)


def _measured(world: World, trial: int) -> MeasuredDescent:
    rng = np.random.default_rng([trial, 1])
    renderer, poses = world.renderer(), world.descent.evaluate(np.multiply(world.stamps_ns, 1e-9)).gTb
    rims, arcs, single = [], [], []
    for stamp, gTb in zip(world.stamps_ns.tolist(), poses, strict=True):
        sun_g = world.sun.at(stamp)
        image = renderer.render(gTb, sun_g, rng)
        sigma_m = _POSITION_SIGMA_SHARE * float(np.linalg.norm(gTb[:3, 3]) - world.descent.body.radius_m)
        sigma = np.repeat([_ATTITUDE_SIGMA_RAD, sigma_m], 3)
        off = sigma * rng.standard_normal(6)
        predicted = frames.pose(gTb[:3, :3] @ frames.rotation_exp(off[:3]), gTb[:3, 3] + off[3:])
        single.append(fitted_alone(image, world.camera, world.catalog, (predicted, gTb), sun_g))
        frame, excess = _measure(world, image, predicted, sigma, sun_g)
        if len(frame[0]):
            rims.append(_rims(frame[0], excess, gTb, world.camera, world.catalog))
        if len(frame[1]):
            outline = float(np.median(rims[-1].outline_share))
            arcs.append(_arcs(frame[1], outline, gTb, world.camera, world.catalog))
    return MeasuredDescent(tuple(rims), tuple(arcs), tuple(single))


def _measure(
    world: World, image: ImageArray, gTb: FloatArray, sigma: FloatArray, sun_g: FloatArray
) -> tuple[tuple[RimSet, ArcSet], FloatArray]:
    """Measure an image; rims with the unit patterns, arcs, covariance (n, 5, 5) of a unit excess."""
    front_end = GuidedFrontEnd(world.camera, world.catalog, GuidedOptions(correlated_errors=_UNIT))
    frame = front_end.measure(image, 0, gTb, np.diag(sigma**2), sun_g)
    return (frame.rims, frame.arcs), frame.rims.fused_white_covariance - frame.rims.uncorrelated_covariance


def _rims(
    rims: RimSet, excess: FloatArray, gTb: FloatArray, camera: Camera, catalog: Catalog
) -> MeasuredRims:
    assert rims.correlated is not None
    assert rims.shared is not None
    assert rims.quality is not None
    rows = rims.craters
    chart = project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[0]
    return MeasuredRims(
        rows,
        rims.chart - chart,
        chart,
        in_plane_slopes(rows, gTb, camera, catalog),
        rims.uncorrelated_covariance,
        rims.correlated @ np.swapaxes(rims.correlated, 1, 2),
        rims.shared[:, :, _BRIGHTNESS],
        rims.shared[:, :, :_BRIGHTNESS],
        excess,
        rims.quality.outline_share,
    )


def _arcs(
    arcs: ArcSet, outline_share: float, gTb: FloatArray, camera: Camera, catalog: Catalog
) -> MeasuredArcs:
    rows = arcs.craters
    charts_px = pixel_chart(
        project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[0], camera
    )
    shift, white = np.empty(len(rows)), np.empty(len(rows))
    for i, chart in enumerate(charts_px):
        points = camera.pinhole.pixels(arcs.points[i])
        weight = (arcs.sigmas[i] * camera.focal_px) ** -2.0
        distance = signed_distances(points, chart)[0]
        shift[i], white[i] = weight @ distance / weight.sum(), 1.0 / weight.sum()
    return MeasuredArcs(shift, white, semi_minor(charts_px), outline_share)
