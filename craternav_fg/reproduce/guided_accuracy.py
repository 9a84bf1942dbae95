"""How well catalogue rims are measured from predicted poses, on rendered ground."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.simulation.scenes import Scene
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import SINGLE_IMAGE, GuidedOptions
from factors.kernels.conic import project_rims

FloatArray = npt.NDArray[np.float64]

# Sizes of craters with a bias of their own are below this semi-minor axis.
SMALL_PX = 60.0
# Seeds apart from those by which the front end was set up, 200 to 530.
HELD_OUT = 2000


@dataclass(frozen=True)
class Prior:
    """How wrong a predicted pose is, and how wrong it is said to be.

    Attributes
    ----------
    shift_px : float
        Turn across the optical axis: length of the image's shift, its direction is drawn.
    scale : float
        Error of the range, up or down, as a share of it.
    told : float
        The same standard deviations in the prediction's covariance, over these.
    """

    shift_px: float = 1.5
    scale: float = 0.001
    told: float = 1.0


NEAR = Prior()
FAR = Prior(30.0, 0.03)


@dataclass(frozen=True)
class Errors:
    """Measured less true rims.

    Attributes
    ----------
    centre_px : ndarray, shape (n, 2)
    axes_px : ndarray, shape (n, 2)
        Of the semi-major and semi-minor axis.
    chi2 : ndarray, shape (n,)
        Of the chart, five degrees of freedom.
    minor_px : ndarray, shape (n,)
        True semi-minor axes.
    expected : int
        Rims that ought to be measured, with those that are.
    """

    centre_px: FloatArray
    axes_px: FloatArray
    chi2: FloatArray
    minor_px: FloatArray
    expected: int


def predicted(one: Scene, prior: Prior, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw a wrong pose (4, 4) for a scene and its covariance (6, 6), as `GuidedFrontEnd` takes them."""
    shift_rad = prior.shift_px / one.camera.focal_px
    range_m = one.range_m
    toward = rng.uniform(0.0, 2.0 * np.pi)
    turn = frames.rotation_exp(shift_rad * np.array([np.cos(toward), np.sin(toward), 0.0]))
    away_m = prior.scale * range_m * rng.choice([-1.0, 1.0])
    ahead = one.gTb[:3, 2]
    gTb = frames.pose(one.gTb[:3, :3] @ turn, one.gTb[:3, 3] - away_m * ahead)
    # A shift of a given length has its root of two in each direction; position across moves as turns do.
    sigma_rad, sigma_m = prior.told * shift_rad / np.sqrt(2.0), prior.told * prior.scale * range_m
    covariance = np.diag([sigma_rad**2] * 3 + [0.0] * 3)
    covariance[3:, 3:] = sigma_m**2 * (np.outer(ahead, ahead) + 1e-4 * np.eye(3))
    return gTb, covariance


def measure(
    one: Scene, options: GuidedOptions, prior: Prior, rng: np.random.Generator
) -> tuple[FrameMeasurement, Errors]:
    """Measure a scene's rims from a wrong prediction."""
    gTb, covariance = predicted(one, prior, rng)
    frame = GuidedFrontEnd(one.camera, one.catalog, options).measure(one.image, 0, gTb, covariance, one.sun_g)
    return frame, errors(one, frame, options)


def errors(one: Scene, frame: FrameMeasurement, options: GuidedOptions) -> Errors:
    """Compare a frame's rims with the scene's that ought to be measured: large, bright, whole in view."""
    clear, _ = one.catalog.visible(
        one.camera, one.gTb, min_semi_minor_px=options.min_semi_minor_px, margin_px=options.margin_px
    )
    wanted = np.intersect1d(one.craters[one.wanted], clear)
    rims = frame.rims.take(np.isin(frame.rims.craters, wanted))
    centres, axes = one.catalog.centres[rims.craters], one.catalog.axes[rims.craters]
    truth = project_rims(one.gTb, one.camera.bTc, centres, axes)[0]
    error = rims.chart - truth
    chi2 = np.einsum("ni,ni->n", error, np.linalg.solve(rims.covariance, error[..., None])[..., 0])
    measured, true = (axes_of_chart(pixel_chart(charts, one.camera)) for charts in (rims.chart, truth))
    difference = measured - true
    return Errors(difference[:, :2], difference[:, 2:4], chi2, true[:, 3], len(wanted))


def accuracy(
    scenes: list[Scene], prior: Prior = NEAR, options: GuidedOptions | None = None
) -> dict[str, float]:
    """Errors of single images' rims, px, their chi-square and the share of rims measured.

    Parameters
    ----------
    scenes : list of Scene
    prior : Prior
    options : GuidedOptions, optional
        As for a single image if not given.

    Returns
    -------
    dict
        Number of rims measured, `fit_rate`, mean absolute errors `centre_px`, `semi_major_px`,
        `semi_minor_px`, the largest signed mean `bias_px` of the centre's coordinates and the axes below
        `SMALL_PX`, and `chi2_5`, the mean chi-square over 5.
    """
    options = options or SINGLE_IMAGE
    rng = np.random.default_rng(0)
    every = [measure(one, options, prior, rng)[1] for one in scenes]
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


def sun_tilts(scenes: list[Scene]) -> dict[str, float]:
    """Rms errors of the sun's tilt: `tilt_deg`, over their sigmas `tilt_sigmas`; `tilt_share` measured."""
    rng = np.random.default_rng(0)
    errors = []
    for one in scenes:
        sun = measure(one, GuidedOptions(), NEAR, rng)[0].sun
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
