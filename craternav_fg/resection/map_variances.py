"""Errors of a catalogue that states none, estimated from measured rims: variance components by REML.

Rims of one image that contradict each other at every pose contradict the map. Each image has a pose of its
own here, so neither the IMU nor the camera's mounting has a part in it. The standard deviations are those at
which the residuals are likeliest; the pose of each image is projected out.

References
----------
Patterson, Thompson, Biometrika 58 (1971) 545, DOI 10.1093/biomet/58.3.545: restricted maximum likelihood.
Hartley, Rao, Biometrika 54 (1967) 93, DOI 10.1093/biomet/54.1-2.93: its iteration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimSet
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.conic import chart_jacobian
from factors.kernels.gauss_newton import move
from factors.kernels.rim_errors import ground_slopes

# Fewer rims leave little redundancy. Frames, evenly spaced, that are asked at most.
_MIN_RIMS, _FRAMES = 3, 60
# Standard deviations at which the search begins: places in px, and as shares of the radius; sizes as shares;
# heights in px; and the share by which the variances of the measurement are larger.
_START = np.array([0.5, 0.01, 0.01, 0.5, 0.1])
_NOISE = np.array([False, False, False, False, True])
# Iterations: of the variances, between linearisations, and of a pose.
_ITERATIONS, _LINEARISATIONS, _POSE_STEPS = 12, 4, 6
# A rim whose residual is so many times the median of all is a wrong match or a gross error.
_OUTLIER = 10.0
# Gain of the log likelihood over larger errors of the measurement, counting each crater once, that a map with
# errors must bring. Rims over an exact map bring up to 2 on ground of another renderer (`tests/foreign`),
# sizes that are off by 1 % 14, places by an eighth of a pixel 40.
_LEAST_GAIN = 8.0
# Standard deviations below these are not told.
_NEGLIGIBLE_M, _NEGLIGIBLE_SHARE = 0.05, 5e-4
# Errors of places, in radii, beyond which it is not the map that is wrong.
_LARGEST_PLACE = 0.3


@dataclass(frozen=True)
class EstimatedErrors:
    """Standard deviations of a map: constant ones, and one part of the places that grows with the radius.

    Attributes
    ----------
    place_m, place_share : float
        Of a rim's centre, per axis along the ground: m, and share of the radius; both together.
    size_share : float
        Of each semi-axis, as a share of itself.
    height_m : float
        Of the height of a rim's plane, m.
    """

    place_m: float
    place_share: float
    size_share: float
    height_m: float

    def of(self, catalog: Catalog) -> MapErrors:
        """Return the errors of all craters of a catalogue.

        Parameters
        ----------
        catalog : Catalog

        Returns
        -------
        MapErrors
        """
        one = np.ones(len(catalog))
        place_m = np.hypot(self.place_m, self.place_share * _radii_m(catalog))
        return MapErrors(place_m, self.size_share * one, self.height_m * one)

    def scaled(self, factor: float) -> "EstimatedErrors":
        """Multiply all standard deviations by a factor.

        Parameters
        ----------
        factor : float
        """
        return EstimatedErrors(*(factor * getattr(self, one.name) for one in fields(self)))

    def exceed(self, others: "EstimatedErrors", factor: float) -> bool:
        """Whether one of the standard deviations is larger than another estimate by a factor.

        Parameters
        ----------
        others : EstimatedErrors
        factor : float

        Returns
        -------
        bool
        """
        least = (_NEGLIGIBLE_M, _NEGLIGIBLE_SHARE, _NEGLIGIBLE_SHARE, _NEGLIGIBLE_M)
        return any(
            getattr(self, one.name) > factor * max(getattr(others, one.name), negligible)
            for one, negligible in zip(fields(self), least, strict=True)
        )

    @property
    def words(self) -> str:
        """The standard deviations that are not negligible, in words."""
        place = [f"{self.place_m:.2g} m"] if self.place_m > _NEGLIGIBLE_M else []
        if self.place_share > _NEGLIGIBLE_SHARE:
            place.append(f"{100.0 * self.place_share:.2g} % of the radius")
        told = [f"places {' and '.join(place)} per axis"] if place else []
        if self.size_share > _NEGLIGIBLE_SHARE:
            told.append(f"semi-axes {100.0 * self.size_share:.2g} %")
        if self.height_m > _NEGLIGIBLE_M:
            told.append(f"heights {self.height_m:.2g} m")
        return ", ".join(told)


def estimated_errors(
    frames: Sequence[FrameMeasurement], gTb: FloatArray, camera: Camera, catalog: Catalog
) -> EstimatedErrors | None:
    """Estimate the standard deviations of a catalogue from the rims of many images.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
        With the errors of the measurement alone.
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m, near which those of the rims are.
    camera : Camera
    catalog : Catalog
        Its stated errors are not used.

    Returns
    -------
    EstimatedErrors or None
        None where the rims do not contradict an exact map, or larger errors of the measurement explain them
        as well.
    """
    seen = [(f.rims, T) for f, T in zip(frames, gTb, strict=True) if len(f.rims) >= _MIN_RIMS]
    seen = seen[:: 1 + len(seen) // _FRAMES]
    if not seen:
        return None
    exact = np.zeros(5)
    rims = _linearised(seen, camera, catalog, exact)
    if not rims or not (_rises(rims, exact) & ~_NOISE).any():
        return None
    start = _start(seen, camera, catalog)
    variances = exact
    for _ in range(_LINEARISATIONS):
        # All errors are taken to be the map's: a part for the noise would take those of wrong edges.
        variances = _likeliest(rims, variances if variances.any() else np.where(_NOISE, 0.0, start))
        rims = _linearised(seen, camera, catalog, variances)
        if not rims:
            return None
    both, noise = (_likeliest(rims, one) for one in (variances + _NOISE * start, _NOISE * start))
    craters = np.concatenate([one.craters for one in rims])
    gain = (_log_likelihood(rims, both) - _log_likelihood(rims, noise)) / len(craters)
    if gain * len(np.unique(craters)) < _LEAST_GAIN:
        return None
    found = EstimatedErrors(*np.sqrt(variances[~_NOISE]).tolist())
    in_radii = found.of(catalog).place_m[craters] / _radii_m(catalog)[craters]
    return found if np.median(in_radii) <= _LARGEST_PLACE else None


@dataclass(frozen=True)
class _Rims:
    """Rims of an image, linearised in its pose.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
    residual : ndarray, shape (5 n,)
        Measured minus predicted.
    slopes : ndarray, shape (5 n, 6)
        Derivatives in the pose.
    covariance : ndarray, shape (5 n, 5 n)
        Of the measurement alone.
    roots : tuple of ndarray, shapes (n, 5, m)
        By component, the derivatives in errors of unit standard deviation.
    """

    craters: IntArray
    residual: FloatArray
    slopes: FloatArray
    covariance: FloatArray
    roots: tuple[FloatArray, ...]

    def total(self, variances: FloatArray) -> FloatArray:
        """Covariance with the errors of the map."""
        out = self.covariance.copy()
        blocks = _blocks(out)
        for variance, root in zip(variances, self.roots, strict=True):
            blocks += variance * (root @ np.swapaxes(root, 1, 2))
        _blocks(out, blocks)
        return out

    def projected(self, variances: FloatArray) -> tuple[FloatArray, float]:
        """Weights (5 n, 5 n) that are left once the pose is estimated, and the log determinants with them."""
        V = self.total(variances)
        W = np.linalg.inv(V)
        scale = np.sqrt(np.einsum("ij,ij->j", self.slopes, W @ self.slopes))
        X = self.slopes / scale
        WX = W @ X
        N = X.T @ WX
        P = W - WX @ np.linalg.solve(N, WX.T)
        logs = np.linalg.slogdet(V)[1] + np.linalg.slogdet(N)[1] + 2.0 * np.sum(np.log(scale))
        return P, float(logs)

    def take(self, kept: BoolArray) -> "_Rims":
        """Select rims, with a mask (n,)."""
        rows = np.repeat(kept, 5)
        return _Rims(
            self.craters[kept],
            self.residual[rows],
            self.slopes[rows],
            self.covariance[np.ix_(rows, rows)],
            tuple(root[kept] for root in self.roots),
        )


def _blocks(matrix: FloatArray, values: FloatArray | None = None) -> FloatArray:
    """Copy of the diagonal blocks (n, 5, 5) of a matrix; set before if values are given."""
    n = len(matrix) // 5
    each = np.arange(n)
    blocks = matrix.reshape(n, 5, n, 5)
    if values is not None:
        blocks[each, :, each, :] = values
    return np.asarray(blocks[each, :, each, :])


def _radii_m(catalog: Catalog) -> FloatArray:
    return np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)


def _start(seen: Sequence[tuple[RimSet, FloatArray]], camera: Camera, catalog: Catalog) -> FloatArray:
    """Variances (5,) at which the search begins."""
    ranges_m = [np.linalg.norm(catalog.centres[rims.craters] - T[:3, 3], axis=1) for rims, T in seen]
    px_m = float(np.median(np.concatenate(ranges_m))) / camera.focal_px
    return np.asarray((_START * np.array([px_m, 1.0, 1.0, px_m, 1.0])) ** 2)


def _linearised(
    seen: Sequence[tuple[RimSet, FloatArray]], camera: Camera, catalog: Catalog, variances: FloatArray
) -> list[_Rims]:
    """Linearise frames at the poses that their rims give, without outliers."""
    every = [_at_own_pose(rims, T, camera, catalog, variances) for rims, T in seen]
    found = [one for one in every if one is not None]
    away = [_distances(one, variances) for one in found]
    limit = _OUTLIER * float(np.median(np.concatenate(away))) if found else 0.0
    kept = [one.take(d <= limit) for one, d in zip(found, away, strict=True)]
    return [one for one in kept if len(one.craters) >= _MIN_RIMS]


def _distances(rims: _Rims, variances: FloatArray) -> FloatArray:
    """Mahalanobis distances (n,) of the rims' residuals."""
    own = _blocks(rims.total(variances))
    r = rims.residual.reshape(-1, 5)
    return np.sqrt(np.einsum("ni,ni->n", r, np.linalg.solve(own, r[:, :, None])[:, :, 0]))


def _at_own_pose(
    rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog, variances: FloatArray
) -> _Rims | None:
    """Linearise a frame at the pose that most of its rims give; None where they give none."""
    gTb = np.array(gTb, order="C")
    for _ in range(_POSE_STEPS):
        at = _at(rims, gTb, camera, catalog)
        if at is None:
            return None
        # Least absolute distances: a wrong match does not decide.
        weights = 1.0 / np.maximum(_distances(at, variances), 1.0)
        L = np.linalg.cholesky(_blocks(at.total(variances)))
        A = np.linalg.solve(L, at.slopes.reshape(-1, 5, 6)) * np.sqrt(weights)[:, None, None]
        b = np.linalg.solve(L, at.residual.reshape(-1, 5, 1)) * np.sqrt(weights)[:, None, None]
        A = A.reshape(-1, 6)
        scale = np.linalg.norm(A, axis=0)
        move(gTb, np.linalg.lstsq(A / scale, b.ravel(), rcond=None)[0] / scale)
    return _at(rims, gTb, camera, catalog)


def _at(rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog) -> _Rims | None:
    """Linearise the rims that a pose sees; None where they are too few."""
    rows = rims.craters
    charts, jacobians, visible = chart_jacobian(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    if visible.sum() < _MIN_RIMS:
        return None
    rims, rows, charts, jacobians = rims.take(visible), rows[visible], charts[visible], jacobians[visible]
    ground = ground_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    radius_m = _radii_m(catalog)[rows][:, None, None]
    covariance = np.zeros((5 * len(rows), 5 * len(rows)))
    own = rims.covariance
    if rims.shared is not None:
        own = own - rims.shared @ np.swapaxes(rims.shared, 1, 2)
        together = rims.shared.reshape(len(covariance), -1)
        covariance = together @ together.T
    _blocks(covariance, _blocks(covariance) + own)
    place, size = ground[:, :, :2], ground[:, :, 3:] * np.array([1.0, np.sqrt(0.5), 1.0])
    noise = np.asarray(np.linalg.cholesky(rims.covariance), float)
    return _Rims(
        rows,
        (rims.chart - charts).ravel(),
        jacobians.reshape(-1, 6),
        covariance,
        (place / radius_m, place, size, ground[:, :, 2:3] / radius_m, noise),
    )


def _likeliest(frames: Sequence[_Rims], variances: FloatArray) -> FloatArray:
    """Variances (5,) at which the residuals are likeliest; those that are zero stay so."""
    for _ in range(_ITERATIONS):
        found, expected = _moments(frames, variances)
        variances = variances * found / expected
    return variances


def _rises(frames: Sequence[_Rims], variances: FloatArray) -> BoolArray:
    """Whether (5,) the likelihood rises with each variance."""
    found, expected = _moments(frames, variances)
    return found > expected


def _moments(frames: Sequence[_Rims], variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of the weighted residuals along each component, and what is expected of them, (5,) each."""
    found, expected = np.zeros(5), np.zeros(5)
    for frame in frames:
        P, _ = frame.projected(variances)
        Pr, own = (P @ frame.residual).reshape(-1, 5, 1), _blocks(P)
        for k, root in enumerate(frame.roots):
            found[k] += np.sum((np.swapaxes(root, 1, 2) @ Pr) ** 2)
            expected[k] += np.sum(root * (own @ root))
    return found, expected


def _log_likelihood(frames: Sequence[_Rims], variances: FloatArray) -> float:
    """Restricted log likelihood of the residuals, but for a constant."""
    total = 0.0
    for frame in frames:
        P, logs = frame.projected(variances)
        total -= 0.5 * (float(frame.residual @ P @ frame.residual) + logs)
    return total
