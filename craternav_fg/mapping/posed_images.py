"""Rims of a catalogue measured in images whose poses are known.

Such images come from orbit, or are rendered over an elevation model along the planned trajectory, under the
sun of that day. Each rim is measured by the guided front end in all images that show it, so the map becomes
what this front end sees: what it makes of a worn or overlapping rim from there is part of the map and not an
error any more. From elsewhere, or under another sun, the rim may look different.

The height of a rim stays that of the catalogue: what it errs goes into the centre, as these views show it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.mapping.apply_errors import CorrectedRims, RunOutcome, apply_errors
from craternav_fg.measurements import RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import FloatArray
from factors.kernels import conic

Progress = Callable[[int, int], None]
# A crater's errors (n, 5) in the images that show it, by its row in the catalogue.
Seen = dict[int, FloatArray]

# Images of a descent whose errors average out as those of one do, as neighbouring images show a rim alike.
# Fitted by `craternav_fg.calibration.posed_images`.
IMAGES_PER_VIEW = 3.0
# Weight of all craters' scatter in that of one, images: chosen.
_POOLED_IMAGES = 4.0
# An error beyond so many standard deviations, of images of the same crater, counts as that many.
_MAX_SIGMAS = 3.0
# Rounding of a body's radius in a file.
_SAME_RADIUS_M = 1.0
# Place of the height among a crater's six errors.
_HEIGHT = 2
# The front end wants a covariance of the poses that are known: rad^2, m^2.
_POSE_COVARIANCE = np.diag([1e-10] * 3 + [1.0] * 3)
# Steps of Newton's method from the map's rim to the measured one, and the largest last one, in radii.
_STEPS, _MAX_LAST_STEP = 8, 1e-3


def rims_in_posed_images(
    catalog: Catalog,
    images: Sequence[Dataset],
    progress: Progress | None = None,
) -> CorrectedRims:
    """Correct the rims that images with known poses show.

    All rims are measured a second time from where they were found: with the errors that are left, the front
    end finds more of them, and they depend less on where the catalogue has them.

    Parameters
    ----------
    catalog : Catalog
    images : sequence of Dataset
        With images, and with a ground truth that gives their poses. Their own catalogues are not used.
    progress : callable, optional
        Called with the number of images measured and of all; each is measured twice.

    Returns
    -------
    CorrectedRims
        Corrected rims have no common shift any more: the poses are on the body.

    Raises
    ------
    InputError
        When a data set has no ground truth or no images, or is of another body.
    """
    for one in images:
        _check(one, catalog)
    count = sum(len(one.image_paths) for one in images)

    def measured(known: Catalog, before: int) -> CorrectedRims:
        report = None if progress is None else (lambda done: progress(before + done, 2 * count))
        return apply_errors(known, combined(known, errors_in_images(known, images, report)))

    first = measured(catalog, 0)
    return _both(catalog, first, measured(first.catalog, count))


def errors_in_images(
    catalog: Catalog,
    images: Sequence[Dataset],
    progress: Callable[[int], None] | None = None,
) -> Seen:
    """Measure the errors of craters on the map in images with known poses.

    Parameters
    ----------
    catalog : Catalog
    images : sequence of Dataset
        With ground truth.
    progress : callable, optional
        Called with the number of images measured.

    Returns
    -------
    dict of int to ndarray, shape (n, 5)
        By row of the crater, see `map_errors_of_rims`.
    """
    seen: dict[int, list[FloatArray]] = {}
    done = 0
    for one in images:
        assert one.truth is not None
        front_end = GuidedFrontEnd(one.camera, catalog, GuidedOptions())
        for k, stamp_ns in enumerate(one.stamps_ns.tolist()):
            gTb, sun_g = one.truth.gTb[k], one.sun.at(stamp_ns)
            rims = front_end.measure(one.image(k), stamp_ns, gTb, _POSE_COVARIANCE, sun_g).rims
            errors = map_errors_of_rims(rims, gTb, one.camera, catalog)
            for row, error in zip(rims.craters.tolist(), errors, strict=True):
                if np.isfinite(error).all():
                    seen.setdefault(row, []).append(error)
            done += 1
            if progress is not None:
                progress(done)
    return {row: np.array(errors) for row, errors in seen.items()}


def map_errors_of_rims(rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Compute the errors of craters on the map from rims in an image with a known pose.

    Parameters
    ----------
    rims : RimSet
        Of n craters.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n, 5)
        Shift along l1 and l2 in mean radii; growth along l1, shear, growth along l2. NaN where the measured
        ellipse is no rim in the crater's plane.
    """
    centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
    lengths = np.linalg.norm(axes, axis=-1)
    along = axes / lengths[:, :, None]
    radius_m = np.sqrt(lengths.prod(axis=-1))
    slopes = in_plane_slopes(rims.craters, gTb, camera, catalog)
    place, stretch = np.zeros((len(rims), 2)), np.tile(np.eye(2), (len(rims), 1, 1))
    step = np.full((len(rims), 5), np.inf)
    for _ in range(_STEPS):
        at = centres + radius_m[:, None] * np.einsum("nk,nkj->nj", place, along)
        now = np.einsum("nab,nb,naj->nbj", stretch, lengths, along)
        charts, _, _ = conic.chart_jacobian(gTb, camera.bTc, at, now)
        step = np.linalg.solve(slopes, (rims.chart - charts)[:, :, None])[:, :, 0]
        place = place + step[:, :2]
        stretch = stretch + step[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    errors = np.concatenate([place, (stretch - np.eye(2)).reshape(-1, 4)[:, [0, 1, 3]]], axis=1)
    settled = np.max(np.abs(step), axis=1, initial=0.0) < _MAX_LAST_STEP
    return np.where(settled[:, None], errors, np.nan)


def combined(catalog: Catalog, seen: Seen) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Combine the errors that single images show.

    An image of a later flight errs as much from a crater's mean as those seen, so that scatter stays.

    Parameters
    ----------
    catalog : Catalog
    seen : dict of int to ndarray, shape (n, 5)
        By row, see `map_errors_of_rims`.

    Returns
    -------
    dict of int to (ndarray, ndarray), shape (6,) each
        By row: errors and what is left of them, one sigma, see `trajectory.Calibrated.map_errors`. Empty
        where no crater is in enough images to tell how images differ.
    """
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    height_m = np.zeros(len(catalog)) if catalog.errors is None else catalog.errors.height_m
    mean, variance = moments(seen, IMAGES_PER_VIEW)
    out: dict[int, tuple[FloatArray, FloatArray]] = {}
    for row in variance:
        sigma = np.sqrt((1.0 + IMAGES_PER_VIEW / len(seen[row])) * variance[row])
        left = np.insert(sigma, _HEIGHT, height_m[row] / radius_m[row])
        out[row] = np.insert(mean[row], _HEIGHT, 0.0), left
    return out


def moments(seen: Seen, images_per_view: float) -> tuple[Seen, Seen]:
    """Compute the mean error of each crater, and the variance of single images about it.

    Parameters
    ----------
    seen : dict of int to ndarray, shape (n, 5)
        By row, see `map_errors_of_rims`.
    images_per_view : float
        Number of images whose errors are one and the same: so many do not count for the variance.

    Returns
    -------
    mean, variance : dict of int to ndarray, shape (5,)
        By row. The variance of a crater is pooled with that of all; it is empty where no crater is in enough
        images to tell.
    """
    mean = {row: _mean(errors) for row, errors in seen.items()}
    squares = {row: np.sum((errors - mean[row]) ** 2, axis=0) for row, errors in seen.items()}
    free = {row: len(errors) - images_per_view for row, errors in seen.items()}
    often = [row for row in seen if free[row] > 0.0]
    if not often:
        return mean, {}
    pooled = sum(squares[row] for row in often) / sum(free[row] for row in often)
    variance = {
        row: (_POOLED_IMAGES * pooled + squares[row]) / (_POOLED_IMAGES + max(free[row], 0.0)) for row in seen
    }
    return mean, variance


def _check(images: Dataset, catalog: Catalog) -> None:
    if images.truth is None:
        raise InputError(images.path, "expected a ground truth: it gives the poses of the images")
    if images.measurements is not None or not images.image_paths:
        raise InputError(images.path, "expected images, found measured rims")
    expected, found = catalog.body.radius_m, images.body.radius_m
    if abs(found - expected) > _SAME_RADIUS_M:
        raise InputError(images.path, f"expected a body of radius {expected:g} m, found {found:g} m")


def _mean(errors: FloatArray) -> FloatArray:
    """Mean (5,) of errors (n, 5), with far ones drawn in."""
    middle = np.median(errors, axis=0)
    limit = _MAX_SIGMAS * 1.4826 * np.median(np.abs(errors - middle), axis=0)
    return np.asarray(middle + np.clip(errors - middle, -limit, limit).mean(axis=0))


def _both(catalog: Catalog, first: CorrectedRims, second: CorrectedRims) -> CorrectedRims:
    """Join two rounds; rims that the second leaves alone keep what the first found."""
    again = np.array([outcome is RunOutcome.REFINED for outcome in second.outcomes])
    outcomes = tuple(
        two if two is RunOutcome.REFINED or one is RunOutcome.NOT_SEEN else one
        for one, two in zip(first.outcomes, second.outcomes, strict=True)
    )
    rows = np.flatnonzero([outcome is RunOutcome.REFINED for outcome in outcomes])
    shift_m = np.full_like(first.shift_m, np.nan)
    off_m = second.catalog.centres[rows] - catalog.centres[rows]
    shift_m[rows] = np.einsum("nij,ni->nj", catalog.gRl[rows], off_m)
    sigma_m = np.where(again[:, None], second.sigma_m, first.sigma_m)
    refined, common = second.catalog, second.catalog.common_shift
    if common is not None:
        refined = replace(refined, common_shift=common.replaced(rows, CommonShift.zeros(len(rows))))
    return CorrectedRims(refined, outcomes, shift_m, sigma_m)
