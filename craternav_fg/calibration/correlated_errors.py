"""Errors of rims that are correlated over frames or over rims, and how fast they change.

What the front end and the smoothers say of them together is a Gaussian distribution of all errors of a
descent: white errors, a Gauss-Markov process for each crater, and eight constants that all rims share. Its
parameters are those that make the errors of rendered descents likeliest. `excess_white_share` is held: it
guards against what the distribution leaves out.

One set of parameters serves three bodies, which differ: of Bennu alone, `crater_share` is 0.63 +- 0.09 and
the decay 0.92 +- 0.29. The Moon alone, whose outlines are ellipses, determines neither.

The craters of all three have one profile, so `size_share` comes out at a twentieth of a per cent. It is kept
larger: over ground of another renderer, whose profiles differ, sizes err by 0.1 to 0.4 % in the mean of a
descent (`tests/foreign`). So is `camera_shift_px`, of which one profile leaves a tenth: the crests of
`crest_asymmetry`, 0.7 px blurred, are displaced by 0.003 to 0.04 px per unit of lift more or less than the
canonical one of their steepness (root mean squares of the families), and over that ground rims are nearer to
the middle of a nadir image by up to 0.2 px per unit of tangent.
"""

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, Scale, estimate
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.calibration.rendered_descents import MeasuredDescent, measured_descents
from craternav_fg.ellipse import shape_change
from craternav_fg.estimators.correlated_errors import PLACE_SIZE, RimErrorOptions, correlation
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import SHARED_SIZE
from craternav_fg.vision.ellipse_kernel import BRIGHTNESS_ERROR_PER_OUTLINE
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions
from factors.arrays import FloatArray

# Squared distance, 5 degrees of freedom, of a rim that is another crater's.
_OUTLIER2 = 60.0
_SHARES = ("crater_share", "brightness_share")
_SIZES = ("camera_shift_px", "sun_shift_px", "stretch_px", "stretch_share", "size_px", "size_share")
# What the data give of sizes that are kept.
_KNOWN = {"camera_shift_px": 0.0025, "size_share": 0.0005}
# Sizes of the first seven shared errors, by their place in `_SIZES`: both camera shifts have one size.
_OF_SHARED = [0, 0, 1, 2, 3, 4, 5]


@dataclass(frozen=True)
class Tracks:
    """Craters that m frames of a descent show, n of them: arrays (n, m, ...), see `MeasuredRims`.

    Attributes
    ----------
    error, brightness : ndarray, shape (n, m, 5)
    slopes, crater, white : ndarray, shape (n, m, 5, 5)
    shared : ndarray, shape (n, m, 5, 7)
    change : ndarray, shape (n, m, m)
        Changes of the rims' images between frames, summed over those between.
    """

    error: FloatArray
    brightness: FloatArray
    slopes: FloatArray
    crater: FloatArray
    white: FloatArray
    shared: FloatArray
    change: FloatArray


def correlated_errors() -> list[Regenerated]:
    """Regenerate `CorrelatedErrorOptions` and `RimErrorOptions.decay_shape_change`.

    Returns
    -------
    list of Regenerated
    """
    descents = [tracks_of(descent) for descent in measured_descents()]
    shipped, decay = CorrelatedErrorOptions(), RimErrorOptions().decay_shape_change
    start = [Parameter(getattr(shipped, name), Scale.LOGIT) for name in _SHARES]
    start += [Parameter(getattr(shipped, name)) for name in _SIZES]

    def costs(values: FloatArray) -> FloatArray:
        return np.array([cost(tracks, values) for tracks in descents])

    values, errors = estimate(costs, [*start, Parameter(decay)])
    units = {"px": ", px", "share": ""}
    out = []
    for name, value, error in zip((*_SHARES, *_SIZES), values[:-1], errors[:-1], strict=True):
        relation = Relation.KEPT if name in _KNOWN else Relation.FITTED
        out.append(
            Regenerated(
                f"CorrelatedErrorOptions.{name}{units[name.rsplit('_')[-1]]}", getattr(shipped, name),
                float(value), float(error), relation, _KNOWN.get(name, np.nan),
            )
        )  # fmt: skip
    of_decay = Regenerated("RimErrorOptions.decay_shape_change", decay, float(values[-1]), float(errors[-1]))
    return [*out, of_decay]


def outline_brightness() -> list[Regenerated]:
    """Regenerate `ellipse_kernel.BRIGHTNESS_ERROR_PER_OUTLINE`, the other parameters held as shipped.

    Returns
    -------
    list of Regenerated
    """
    descents = [tracks_of(descent) for descent in measured_descents()]
    shipped = CorrelatedErrorOptions()
    others = np.array(
        [*(getattr(shipped, name) for name in (*_SHARES, *_SIZES)), RimErrorOptions().decay_shape_change]
    )

    def costs(values: FloatArray) -> FloatArray:
        factor = values[0] / BRIGHTNESS_ERROR_PER_OUTLINE
        scaled = [[replace(t, brightness=factor * t.brightness) for t in tracks] for tracks in descents]
        return np.array([cost(tracks, others) for tracks in scaled])

    values, errors = estimate(costs, [Parameter(BRIGHTNESS_ERROR_PER_OUTLINE)])
    name = "ellipse_kernel.BRIGHTNESS_ERROR_PER_OUTLINE"
    return [Regenerated(name, BRIGHTNESS_ERROR_PER_OUTLINE, float(values[0]), float(errors[0]))]


def tracks_of(descent: MeasuredDescent) -> list[Tracks]:
    """Sort the rims of a descent by crater, those of other craters left out.

    Parameters
    ----------
    descent : MeasuredDescent

    Returns
    -------
    list of Tracks
        One for each number of frames.
    """
    shipped = CorrelatedErrorOptions()
    sizes = np.array([getattr(shipped, name) for name in _SIZES])[_OF_SHARED]
    by_crater: dict[int, list[tuple[FloatArray, ...]]] = defaultdict(list)
    for rims in descent.rims:
        root = rims.shared * sizes
        whole = rims.points + rims.systematic + root @ np.swapaxes(root, 1, 2)
        good = squared_distance(rims.error, whole) < _OUTLIER2
        white = rims.points + shipped.excess_white_share * rims.excess
        of_rims = (rims.error, rims.brightness, rims.slopes, rims.crater, white, rims.shared, rims.chart)
        for i in np.flatnonzero(good):
            by_crater[int(rims.craters[i])].append(tuple(values[i] for values in of_rims))
    by_length: dict[int, list[list[FloatArray]]] = defaultdict(list)
    for seen in by_crater.values():
        by_length[len(seen)].append([np.array(values) for values in zip(*seen, strict=True)])
    out = []
    for seen_alike in by_length.values():
        error, brightness, slopes, crater, white, shared, charts = (
            np.array(values) for values in zip(*seen_alike, strict=True)
        )
        steps = shape_change(charts[:, :-1], charts[:, 1:])
        along = np.concatenate([np.zeros((len(charts), 1)), np.cumsum(steps, axis=1)], axis=1)
        change = np.abs(along[:, :, None] - along[:, None, :])
        out.append(Tracks(error, brightness, slopes, crater, white, shared, change))
    return out


def cost(descent: list[Tracks], values: FloatArray) -> float:
    """Negative log-likelihood of the errors of a descent, but for a constant.

    Parameters
    ----------
    descent : list of Tracks
    values : ndarray, shape (9,)
        The two shares of variances, the six sizes of shared errors, the decay.

    Returns
    -------
    float
    """
    crater_share, brightness_share = values[:2]
    sizes, decay = values[2:8][_OF_SHARED], values[8]
    # Shared errors are eliminated: their information, what the data say of them, and the rest of the cost.
    information, pull, total = np.eye(SHARED_SIZE), np.zeros(SHARED_SIZE), 0.0
    for tracks in descent:
        n, m = tracks.error.shape[:2]
        root = tracks.brightness[..., None]
        systematic = tracks.crater + (1.0 - brightness_share) * root @ np.swapaxes(root, -1, -2)
        inverse = np.linalg.inv(tracks.slopes)
        on_ground = crater_share * inverse @ systematic @ np.swapaxes(inverse, -1, -2)
        kept = tracks.slopes @ np.linalg.cholesky(0.5 * (on_ground + np.swapaxes(on_ground, -1, -2)))
        of_place, of_others = correlation(tracks.change, decay)
        place, others = kept[..., :PLACE_SIZE], kept[..., PLACE_SIZE:]
        covariance = np.einsum("nkab,nlcb,nkl->nkalc", place, place, of_place)
        covariance += np.einsum("nkab,nlcb,nkl->nkalc", others, others, of_others)
        frame = np.arange(m)
        # Indexing with arrays that are apart puts their axis first.
        covariance[:, frame, :, frame, :] += np.swapaxes(
            tracks.white + (1.0 - crater_share) * systematic, 0, 1
        )  # fmt: skip
        L = np.linalg.cholesky(covariance.reshape(n, 5 * m, 5 * m))
        shared = np.concatenate([tracks.shared * sizes, np.sqrt(brightness_share) * root], axis=-1)
        both = [shared.reshape(n, 5 * m, SHARED_SIZE), tracks.error.reshape(n, 5 * m, 1)]
        white = np.linalg.solve(L, np.concatenate(both, axis=-1))
        H, error = white[..., :SHARED_SIZE], white[..., SHARED_SIZE]
        information += np.einsum("nia,nib->ab", H, H)
        pull += np.einsum("nia,ni->a", H, error)
        total += float(np.sum(error**2) + 2.0 * np.sum(np.log(np.diagonal(L, axis1=1, axis2=2))))
    total += float(np.linalg.slogdet(information)[1] - pull @ np.linalg.solve(information, pull))
    return 0.5 * total
