"""Craters of a catalogue that are displaced alike: one of two sources that were put together without care.

Errors of independent craters average out; those of a group do not. Two kinds of groups are looked for in the
displacements that the rims of many images show: all craters beyond a line, by a step that a trend over the
region does not explain, and craters anywhere, by displacements that have two centres in place of one.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.model import Catalog
from craternav_fg.resection.map_variances import PlaceEquations
from factors.arrays import BoolArray, FloatArray, IntArray

# Fewer craters show no groups; least share of the smaller one.
_MIN_CRATERS, _LEAST_SHARE = 16, 0.15
# Directions of the lines that are tried.
_DIRECTIONS = 8
# Standard deviations of independent displacements that are tried, m.
_SIGMAS_M = np.geomspace(0.1, 3000.0, 45)
# Squared distance of a step from zero, the largest of all lines: over right maps and maps with independent
# errors of 20 and 100 m it was at most 23 in 39 descents.
_MIN_STEP2 = 30.0
# Twice the logarithm of the likelihood ratio of two centres to one, and their distance in standard
# deviations. Without groups a few craters at the edge make a second centre; one of more is nearer than 3.5.
_MIN_RATIO, _MIN_SEPARATION = 40.0, 4.0
# Variance of a displacement, as a share of that with which it is estimated, above which rims do not tell it.
_TOLD, _LOOSE = 0.25, 3.0
_EM_STEPS = 60


@dataclass(frozen=True)
class ShiftedGroup:
    """Craters that are displaced alike against the others.

    Attributes
    ----------
    rows : ndarray of int, shape (k,)
        Rows of the catalogue: those of the smaller group, as far as rims show it.
    seen, of : int
        How many craters of the group have rims, and how many of all.
    east_m, north_m : float
        By how much the catalogue's places of the group are farther east and north than those of the others.
    """

    rows: IntArray
    seen: int
    of: int
    east_m: float
    north_m: float

    @property
    def shift_m(self) -> float:
        """Length of the shift, m."""
        return float(np.hypot(self.east_m, self.north_m))

    @property
    def bearing_deg(self) -> float:
        """Direction of the shift from north over east, deg."""
        return float(np.degrees(np.arctan2(self.east_m, self.north_m)) % 360.0)

    def aligned(self, catalog: Catalog) -> Catalog:
        """Move the group and the others by half of the shift each, so that they meet in the middle.

        Parameters
        ----------
        catalog : Catalog

        Returns
        -------
        Catalog
            Which of both is right is not known: half of the shift is its common shift's standard deviation.
        """
        half = np.full(len(catalog), 0.5)
        half[self.rows] = -0.5
        radius_m = catalog.body.radius_m + catalog.height_m
        shift = catalog.common_shift or CommonShift.unknown(len(catalog))
        return replace(
            catalog,
            latitude_rad=catalog.latitude_rad + half * self.north_m / radius_m,
            longitude_rad=catalog.longitude_rad
            + half * self.east_m / (radius_m * np.cos(catalog.latitude_rad)),
            common_shift=replace(shift, place_m=np.full(len(catalog), 0.5 * self.shift_m)),
        )


def shifted_group(equations: PlaceEquations, catalog: Catalog) -> ShiftedGroup | None:
    """Find craters that are displaced alike against the others.

    Parameters
    ----------
    equations : PlaceEquations
    catalog : Catalog

    Returns
    -------
    ShiftedGroup or None
        None where independent displacements, and a trend over the region, explain what the rims show.
    """
    craters, A, b = equations
    if len(craters) < _MIN_CRATERS:
        return None
    at = _plane(catalog)
    places = at[craters]
    trend = np.asarray(np.kron(np.column_stack([np.ones(len(craters)), places]), np.eye(2)), dtype=np.float64)
    sigma_m = _independent_m(A, b, trend)
    line = _line(A, b, trend, places, sigma_m)
    if line.square > _MIN_STEP2:
        beyond, shift = at @ line.normal >= line.offset, line.shift
        group, seen = beyond, beyond[craters]
    else:
        found = _two_centres(A, b, trend, sigma_m)
        if found is None:
            return None
        seen, shift = found
        group = np.zeros(len(catalog), dtype=np.bool_)
        group[craters[seen]] = True
    if 2 * int(seen.sum()) > len(craters):
        # Of craters without rims only a line tells anything.
        others = ~group if line.square > _MIN_STEP2 else np.isin(np.arange(len(catalog)), craters[~seen])
        group, seen, shift = others, ~seen, -shift
    # Rims are displaced against the catalogue, which is off by the opposite.
    east_m, north_m = (-shift).tolist()
    return ShiftedGroup(np.flatnonzero(group), int(seen.sum()), len(craters), east_m, north_m)


def _plane(catalog: Catalog) -> FloatArray:
    """Places (n, 2) of all craters on the plane that touches the sphere in their middle, in radii."""
    middle = catalog.up.mean(axis=0)
    middle /= np.linalg.norm(middle)
    pole = np.eye(3)[np.argmin(np.abs(middle))]
    x = np.cross(pole, middle)
    x /= np.linalg.norm(x)
    return np.asarray(catalog.up @ np.stack([x, np.cross(middle, x)], axis=1))


def _independent_m(A: FloatArray, b: FloatArray, trend: FloatArray) -> float:
    """Estimate the standard deviation of independent displacements beside a trend, by REML, in m."""
    values, vectors = np.linalg.eigh(A)
    told = values > 1e-9 * values[-1]
    values, b, X = values[told], vectors[:, told].T @ b, vectors[:, told].T @ trend
    best, sigma_m = -np.inf, float(_SIGMAS_M[0])
    for one in _SIGMAS_M:
        spread = 1.0 + one**2 * values
        N = X.T @ ((values / spread)[:, None] * X)
        r = X.T @ (b / spread)
        square = np.sum(b**2 / (values * spread)) - r @ np.linalg.pinv(N, hermitian=True) @ r
        logs = np.log(np.maximum(np.linalg.eigvalsh(N), 1e-12 * np.trace(N))).sum()
        likelihood = -0.5 * float(square + np.log(spread).sum() + logs)
        if likelihood > best:
            best, sigma_m = likelihood, float(one)
    return sigma_m


class _Line(NamedTuple):
    """Step (2,), m, at a line, its squared distance from zero, and the line: normal (2,), offset."""

    square: float
    shift: FloatArray
    normal: FloatArray
    offset: float


def _line(A: FloatArray, b: FloatArray, trend: FloatArray, places: FloatArray, sigma_m: float) -> _Line:
    """Find the line beyond which craters are displaced most significantly against a trend."""
    n = len(places)
    K = np.linalg.inv(A + np.eye(2 * n) / sigma_m**2)
    M, r = A - A @ K @ A, b - A @ (K @ b)
    MX = M @ trend
    inverse = np.linalg.pinv(trend.T @ MX, hermitian=True)
    M, r = M - MX @ inverse @ MX.T, r - MX @ (inverse @ (trend.T @ r))
    blocks, rests = M.reshape(n, 2, n, 2), r.reshape(n, 2)
    least = max(int(np.ceil(_LEAST_SHARE * n)), 1)
    best = _Line(0.0, np.zeros(2), np.zeros(2), 0.0)
    for angle in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS:
        normal = np.array([np.cos(angle), np.sin(angle)])
        along = places @ normal
        order = np.argsort(along)[::-1]
        sums = blocks[order][:, :, order].cumsum(axis=0).cumsum(axis=2)
        N = np.moveaxis(np.diagonal(sums, axis1=0, axis2=2), -1, 0)[least - 1 : n - least]
        rest = rests[order].cumsum(axis=0)[least - 1 : n - least]
        shifts = np.einsum("kij,kj->ki", np.linalg.pinv(N, hermitian=True), rest)
        squares = np.sum(shifts * rest, axis=1)
        k = int(np.argmax(squares))
        if squares[k] > best.square:
            last = order[least - 1 + k : least + 1 + k]
            best = _Line(float(squares[k]), shifts[k], normal, float(along[last].mean()))
    return best


def _two_centres(
    A: FloatArray, b: FloatArray, trend: FloatArray, sigma_m: float
) -> tuple[BoolArray, FloatArray] | None:
    """Find craters (n,) whose displacements have another centre than the others', and its shift (2,)."""
    wide2 = (_LOOSE * sigma_m) ** 2
    K = np.linalg.inv(A + np.eye(len(A)) / wide2)
    if np.mean(np.diag(K) < _TOLD * wide2) < 1.0 - _LEAST_SHARE:
        return None
    u = K @ b
    x = (u - trend @ np.linalg.lstsq(trend, u, rcond=None)[0]).reshape(-1, 2)
    S = x.T @ x / len(x)
    one = -0.5 * len(x) * float(np.linalg.slogdet(S)[1] + 2.0)
    _, axes = np.linalg.eigh(S)
    starts = [
        along > np.quantile(along, share)
        for angle in np.arange(4) * np.pi / 4.0
        for along in [x @ axes @ [np.sin(angle), np.cos(angle)]]
        for share in (0.3, 0.5, 0.7)
    ]
    likelihood, weight, shift, separation = max(
        (_mixture(x, start) for start in starts), key=lambda found: found[0]
    )
    other = weight > 0.5
    share = min(float(other.mean()), 1.0 - float(other.mean()))
    if 2.0 * (likelihood - one) < _MIN_RATIO or separation < _MIN_SEPARATION or share < _LEAST_SHARE:
        return None
    return other, shift


def _mixture(x: FloatArray, start: BoolArray) -> tuple[float, FloatArray, FloatArray, float]:
    """Fit two normal distributions of one covariance to places (n, 2), by expectation-maximisation.

    Returns the logarithm of the likelihood, the weights (n,) of the second one, its distance (2,) from the
    first, and the same in standard deviations.
    """
    weight = np.where(start, 0.99, 0.01)
    for _ in range(_EM_STEPS):
        share = weight.mean()
        means = ((1.0 - weight) @ x / np.sum(1.0 - weight), weight @ x / weight.sum())
        from_means = [x - mean for mean in means]
        S = sum((w * d.T) @ d for w, d in zip((1.0 - weight, weight), from_means, strict=True)) / len(x)
        inverse = np.linalg.inv(S)
        logs = [
            np.log(s) - 0.5 * np.einsum("ni,ij,nj->n", d, inverse, d)
            for s, d in zip((1.0 - share, share), from_means, strict=True)
        ]
        both = np.logaddexp(*logs)
        weight = np.clip(np.exp(logs[1] - both), 1e-6, 1.0 - 1e-6)
    shift = means[1] - means[0]
    likelihood = float(both.sum()) - 0.5 * len(x) * float(np.linalg.slogdet(S)[1])
    return likelihood, weight, shift, float(np.sqrt(shift @ inverse @ shift))
