"""What users get wrong in tables of rims and craters, and whether undoing it makes them agree.

The filter predicts each frame's rims from all earlier data: only rims that are what they claim agree.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.instruments import RIMS
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.innovations import innovations
from craternav_fg.measurements import RimSet
from factors.arrays import FloatArray

# NIS per dimension of a rim, median over all, below which a correction is confirmed.
_CONFIRMED = 2.0
# By how much the median must fall, too.
_FALL = 10.0
# Step of the derivatives of charts, which are of order one.
_STEP = 1e-6


@dataclass(frozen=True)
class _Mistake:
    """A mistake, and charts (n, 5) or a catalogue without it."""

    what: str
    charts: Callable[[FloatArray], FloatArray] | None = None
    catalog: Callable[[Catalog], Catalog] | None = None


def likely_rim_mistake(problem: Problem) -> str:
    """Name the mistake in rims or catalogue that explains why they contradict each other.

    Parameters
    ----------
    problem : Problem
        With measured rims.

    Returns
    -------
    str
        What the rims agree without; empty when undoing no mistake helps.
    """
    best, likely = min(_CONFIRMED, _median_nis(problem) / _FALL), ""
    for one in _mistakes():
        try:
            nis = _median_nis(_undone(one, problem))
        except NUMERICAL_ERRORS:
            continue
        if nis < best:
            best, likely = nis, one.what
    return likely


def _mistakes() -> Iterator[_Mistake]:
    half, double = np.log(0.5) * np.array([0, 0, 1, 0, 1]), np.log(2.0) * np.array([0, 0, 1, 0, 1])
    yield _Mistake("the angles of the ellipses are counted from x away from y", _mirrored)
    yield _Mistake("the angles of the ellipses are those of their minor axes", _turned)
    yield _Mistake("y of the image is upwards", lambda chart: _mirrored(chart) * [1, -1, 1, 1, 1])
    yield _Mistake("the images are mirrored left to right", lambda chart: _mirrored(chart) * [-1, 1, 1, 1, 1])
    yield _Mistake("x and y of the image are interchanged", _transposed)
    yield _Mistake("chart[2] and chart[4] are not halved", lambda chart: chart * [1, 1, 0.5, 1, 0.5])
    yield _Mistake("the ellipses have diameters for semi-axes", lambda chart: chart + half)
    yield _Mistake("the ellipses have halves of semi-axes", lambda chart: chart + double)
    yield _Mistake("the catalogue has radii for diameters", catalog=lambda c: _resized(c, 2.0))
    yield _Mistake("the catalogue's diameters are twice too large", catalog=lambda c: _resized(c, 0.5))
    for what, offset, sign in (
        ("is counted from north towards east", 0.5 * np.pi, -1.0),
        ("is counted from east towards south", 0.0, -1.0),
        ("is counted from north, or is that of the minor axis", 0.5 * np.pi, 1.0),
    ):
        yield _Mistake(f"DIAM_ELLI_ANGLE_IMG {what}", catalog=partial(_turned_on_ground, offset, sign))
    yield _Mistake(
        "the catalogue's longitudes are positive west",
        catalog=lambda c: replace(c, longitude_rad=np.mod(-c.longitude_rad, 2.0 * np.pi)),
    )
    yield _Mistake(
        "the catalogue's latitudes are positive south",
        catalog=lambda c: replace(c, latitude_rad=-c.latitude_rad),
    )
    yield _Mistake("RIM_HEIGHT_M is positive downwards", catalog=lambda c: replace(c, height_m=-c.height_m))
    yield _Mistake("RIM_HEIGHT_M is in km", catalog=lambda c: replace(c, height_m=1e3 * c.height_m))


def _resized(catalog: Catalog, factor: float) -> Catalog:
    return replace(
        catalog, semi_major_m=factor * catalog.semi_major_m, semi_minor_m=factor * catalog.semi_minor_m
    )


def _turned_on_ground(offset_rad: float, sign: float, catalog: Catalog) -> Catalog:
    return replace(catalog, angle_rad=offset_rad + sign * catalog.angle_rad)


def _mirrored(chart: FloatArray) -> FloatArray:
    return chart * [1, 1, 1, -1, 1]


def _transposed(chart: FloatArray) -> FloatArray:
    """Charts with x and y interchanged, of the same ellipses."""
    width2, shear = np.exp(2.0 * chart[:, 2]), chart[:, 3]
    height2 = np.exp(2.0 * chart[:, 4]) + shear**2 * width2
    turned = shear * width2 / height2
    rest = np.log(width2 - turned**2 * height2)
    return np.stack([chart[:, 1], chart[:, 0], 0.5 * np.log(height2), turned, 0.5 * rest], axis=1)


def _turned(chart: FloatArray) -> FloatArray:
    """Charts of ellipses turned by 90 deg about their centres."""
    out = _mirrored(_transposed(chart))
    out[:, :2] = chart[:, :2]
    return out


def _undone(mistake: _Mistake, problem: Problem) -> Problem:
    catalog = problem.catalog if mistake.catalog is None else mistake.catalog(problem.catalog)
    frames = problem.frames
    if mistake.charts is not None:
        frames = [replace(one, rims=_corrected(one.rims, mistake.charts)) for one in frames]
    corrected = replace(problem, catalog=catalog, frames=frames)
    return replace(corrected, start=find_start(corrected, frames))


def _corrected(rims: RimSet, change: Callable[[FloatArray], FloatArray]) -> RimSet:
    steps = _STEP * np.eye(5)
    J = np.stack(
        [(change(rims.chart + step) - change(rims.chart - step)) / (2.0 * _STEP) for step in steps], axis=2
    )
    return RimSet(rims.craters, change(rims.chart), J @ rims.covariance @ J.transpose(0, 2, 1))


def _median_nis(problem: Problem) -> float:
    """NIS per dimension of a rim, median over the frames; infinite where the rims are lost."""
    try:
        run = ekf().run(problem)
        every = innovations(problem, run.states, run.predictions).of(RIMS)
    except (EstimationError, *NUMERICAL_ERRORS):
        return float("inf")
    expected = sum(len(frame.rims) for frame in problem.frames[problem.start.frame + 1 :])
    # Rims that are out of sight have no innovation.
    if 2 * len(every.nis) < expected or not len(every.nis):
        return float("inf")
    return float(np.median(every.nis / every.dimension))
