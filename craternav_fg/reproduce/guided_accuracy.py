"""Accuracy of rims and sun tilts measured from wrong predicted poses, in rendered scenes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from craternav_fg import frames
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.simulation.scenes import Scene
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import SINGLE_IMAGE, GuidedOptions
from factors.arrays import FloatArray, IntArray
from factors.kernels.conic import project_rims

# The bias of the sizes is taken over the rims below this semi-minor axis: a bias in px is largest there.
SMALL_PX = 60.0
# First seed of the images that are kept for tests; the front end was set up with seeds 200 to 530.
HELD_OUT_SEED = 2000
# Position errors across the optical axis move the image as rotations do: nearly all are left to those.
_ACROSS_VARIANCE = 1e-4


@dataclass(frozen=True)
class PredictionError:
    """How wrong a predicted pose is, as its covariance says.

    Attributes
    ----------
    shift_px : float
        Rotation across the optical axis, as the shift of the image in a random direction.
    scale : float
        Error of the range as a share of it; its sign is random.
    """

    shift_px: float = 1.5
    scale: float = 0.001


# Errors of a tracked lander, and of one that has nearly lost track.
USUAL_ERROR = PredictionError()
LARGE_ERROR = PredictionError(30.0, 0.03)


@dataclass(frozen=True)
class RimErrors:
    """Measured minus true rims.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Rows of the catalogue.
    centre_px : ndarray, shape (n, 2)
    axes_px : ndarray, shape (n, 2)
        Errors of the semi-major and the semi-minor axis.
    chi2 : ndarray, shape (n,)
        Chi-square of the chart, five degrees of freedom.
    minor_px : ndarray, shape (n,)
        True semi-minor axes.
    expected : int
        Number of rims that should be measured, including those that are.
    """

    craters: IntArray
    centre_px: FloatArray
    axes_px: FloatArray
    chi2: FloatArray
    minor_px: FloatArray
    expected: int


def predicted(one: Scene, error: PredictionError, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw a predicted pose of a scene and its covariance, as `GuidedFrontEnd` takes them.

    Parameters
    ----------
    one : Scene
    error : PredictionError
    rng : Generator

    Returns
    -------
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    covariance : ndarray, shape (6, 6)
        Covariance of the rotation in b, rad, and of the position in g, m.
    """
    shift_rad = error.shift_px / one.camera.focal_px
    range_m = one.range_m
    toward = rng.uniform(0.0, 2.0 * np.pi)
    turn = frames.rotation_exp(shift_rad * np.array([np.cos(toward), np.sin(toward), 0.0]))
    away_m = error.scale * range_m * rng.choice([-1.0, 1.0])
    ahead = one.gTb[:3, 2]
    gTb = frames.pose(one.gTb[:3, :3] @ turn, one.gTb[:3, 3] - away_m * ahead)
    # A shift of fixed length in a random direction has 1 / sqrt(2) of it as RMS along each axis.
    sigma_rad = shift_rad / np.sqrt(2.0)
    sigma_m = error.scale * range_m
    covariance = np.diag([sigma_rad**2] * 3 + [0.0] * 3)
    covariance[3:, 3:] = sigma_m**2 * (np.outer(ahead, ahead) + _ACROSS_VARIANCE * np.eye(3))
    return gTb, covariance


def measure(
    one: Scene, options: GuidedOptions, error: PredictionError, rng: np.random.Generator
) -> tuple[FrameMeasurement, RimErrors]:
    """Measure a scene's rims from a wrong predicted pose.

    Parameters
    ----------
    one : Scene
    options : GuidedOptions
    error : PredictionError
    rng : Generator

    Returns
    -------
    FrameMeasurement
    RimErrors
    """
    gTb, covariance = predicted(one, error, rng)
    frame = GuidedFrontEnd(one.camera, one.catalog, options).measure(one.image, 0, gTb, covariance, one.sun_g)
    return frame, rim_errors(one, frame, options)


def rim_errors(one: Scene, frame: FrameMeasurement, options: GuidedOptions) -> RimErrors:
    """Compare a frame's rims with those that should be measured: large, well shaded, whole in the image.

    Parameters
    ----------
    one : Scene
    frame : FrameMeasurement
    options : GuidedOptions

    Returns
    -------
    RimErrors
    """
    clear, _ = one.catalog.visible(
        one.camera, one.gTb, min_semi_minor_px=options.min_semi_minor_px, margin_px=options.margin_px
    )
    wanted = np.intersect1d(one.craters[one.wanted], clear)
    rims = frame.rims.take(np.isin(frame.rims.craters, wanted))
    centres, axes = one.catalog.centres[rims.craters], one.catalog.axes[rims.craters]
    truth = project_rims(one.gTb, one.camera.bTc, centres, axes)[0]
    error = rims.chart - truth
    chi2 = squared_distance(error, rims.covariance)
    measured, true = (axes_of_chart(pixel_chart(charts, one.camera)) for charts in (rims.chart, truth))
    difference = measured - true
    return RimErrors(rims.craters, difference[:, :2], difference[:, 2:4], chi2, true[:, 3], len(wanted))


def accuracy(scenes: Sequence[Scene], error: PredictionError = USUAL_ERROR) -> dict[str, float]:
    """Errors of the rims over all scenes, their chi-square and the share of rims measured.

    Parameters
    ----------
    scenes : sequence of Scene
    error : PredictionError

    Returns
    -------
    dict of str to float
        `rims`, the number of rims measured; `fit_rate`; mean absolute errors `centre_px`, `semi_major_px`,
        `semi_minor_px`; `bias_px`, the largest mean of the centre's coordinates and the semi-axes of rims
        below `SMALL_PX`; `chi2_5`, the mean chi-square over 5.
    """
    rng = np.random.default_rng(0)
    every = [measure(one, SINGLE_IMAGE, error, rng)[1] for one in scenes]
    centre, axes, chi2, minor = (
        np.concatenate([getattr(e, name) for e in every])
        for name in ("centre_px", "axes_px", "chi2", "minor_px")
    )
    small = minor < SMALL_PX
    return {
        "rims": len(chi2),
        "fit_rate": len(chi2) / sum(e.expected for e in every),
        "centre_px": float(np.mean(np.hypot(*centre.T))),
        "semi_major_px": float(np.mean(np.abs(axes[:, 0]))),
        "semi_minor_px": float(np.mean(np.abs(axes[:, 1]))),
        "bias_px": float(np.max(np.abs(np.mean(np.hstack([centre, axes])[small], axis=0)))),
        "chi2_5": float(np.mean(chi2) / 5.0),
    }


def sun_tilts(scenes: Sequence[Scene]) -> dict[str, float]:
    """RMS errors of the measured sun tilts over all scenes.

    Parameters
    ----------
    scenes : sequence of Scene

    Returns
    -------
    dict of str to float
        `tilt_deg`, the RMS error; `tilt_sigmas`, that of the errors over their standard deviations;
        `tilt_share`, the share of the scenes with a sun tilt.
    """
    rng = np.random.default_rng(0)
    errors = []
    for one in scenes:
        sun = measure(one, GuidedOptions(), USUAL_ERROR, rng)[0].sun
        if sun is not None:
            x, y, _ = one.camera.gTc(one.gTb)[:3, :3].T @ sun.direction
            error = float(np.angle(np.exp(1j * (sun.tilt_rad - np.arctan2(y, x)))))
            errors.append((np.rad2deg(error), error / sun.sigma_rad))
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else np.full(2, np.nan)
    return {
        "tilt_deg": float(rms[0]),
        "tilt_sigmas": float(rms[1]),
        "tilt_share": len(errors) / len(scenes),
    }
