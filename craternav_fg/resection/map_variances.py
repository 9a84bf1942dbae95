"""Errors of a catalogue that states none, estimated from measured rims: variance components by REML.

Rims of one image that contradict each other at every pose contradict the map. Each image has a pose of its
own here, so neither the IMU nor the camera's mounting has a part in it. The standard deviations are those at
which the residuals are likeliest; the pose of each image is projected out.

References
----------
Patterson, Thompson, Biometrika 58 (1971) 545, DOI 10.1093/biomet/58.3.545: restricted maximum likelihood.
Hartley, Rao, Biometrika 54 (1967) 93, DOI 10.1093/biomet/54.1-2.93: its iteration.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import SHARED_SIZE, FrameMeasurement, RimSet
from craternav_fg.resection.estimated_errors import EstimatedErrors, radii_m
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.conic import chart_jacobian
from factors.kernels.gauss_newton import move
from factors.kernels.rim_errors import ground_slopes, tilt_slopes

# Fewer rims leave little redundancy. Frames, evenly spaced, that are asked at most.
_MIN_RIMS, _FRAMES = 3, 60
# Standard deviations at which the search begins: places in px, and as shares of the radius; sizes as shares;
# heights like places; slopes in rad; and the root of the share by which the variances of the measurement are
# larger.
_START = np.array([0.5, 0.01, 0.01, 0.5, 0.01, 0.03, 0.1])
_IN_PX = np.array([True, False, False, True, False, False, False])
_TILT, _NOISE = np.arange(7) == 5, np.arange(7) == 6
# Iterations: of the variances, between linearisations, and of a pose.
_ITERATIONS, _LINEARISATIONS, _FIRST_POSE_STEPS, _POSE_STEPS = 12, 4, 6, 2
# A rim whose residual is so many times the median of all is a wrong match or a gross error: with the map as
# exact, where those of near rims are larger, and with its errors.
_FIRST_OUTLIER, _OUTLIER = 10.0, 4.0
# Gain of the log likelihood over larger errors of the measurement that a map with errors must bring, and that
# slopes of planes must bring over all other errors. Chosen: rims over an exact map bring up to 3.6 in 32
# descents on ground of another renderer (`tests/foreign`), sizes that are off by 1 % bring 14 on our own,
# places by an eighth of a pixel 40.
_LEAST_GAIN = 5.0
# Median squared distance of rims from displaced craters above which matches are wrong: 4 where all are right.
_LARGEST_SQUARE = 20.0
# Craters whose displacements are asked at most: the cost grows with the third power.
_MOST_DISPLACED = 400
# Errors of places, in radii, beyond which it is not the map that is wrong.
_LARGEST_PLACE = 0.3


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
    images = _Images.of(frames, gTb, camera, catalog)
    found = _found(images, slopes=False)
    # Slopes have a part only where the others do not explain the rims as well: they would take from them.
    sloping = _found(images, slopes=True) if catalog.plane_tilt_rad is None else None
    return found if sloping is None else sloping


def _found(images: "_Images", *, slopes: bool) -> EstimatedErrors | None:
    """Estimate the errors, with slopes of planes or without; None where the rims do not need them."""
    errors = ~_NOISE if slopes else ~(_NOISE | _TILT)
    exact = np.zeros(len(_START))
    rims = images.linearised(exact, _FIRST_POSE_STEPS, _FIRST_OUTLIER)
    if rims is None or not (_rises(rims, exact) & errors).any():
        return None
    start = images.start()
    variances = exact
    for _ in range(_LINEARISATIONS):
        # All errors are taken to be the map's: a part for the noise would take those of wrong edges.
        variances = _likeliest(rims, variances if variances.any() else errors * start)
        rims = images.linearised(variances, _POSE_STEPS, _OUTLIER)
        if rims is None:
            return None
    others = ~_TILT if slopes else _NOISE
    both, rest = (_likeliest(rims, one) for one in (variances + _NOISE * start, others * start))
    gain = rims.weighted(both).log_likelihood - rims.weighted(rest).log_likelihood
    if any(one.correlated is not None or one.of_map is not None for one in images.rims):
        # What a crater keeps is the same in all frames: they count once.
        gain *= len(np.unique(rims.craters)) / len(rims.craters)
    if gain < _LEAST_GAIN:
        return None
    found = EstimatedErrors(*np.sqrt(variances[~_NOISE]).tolist())
    in_radii = found.of(images.catalog).place_m[rims.craters] / radii_m(images.catalog)[rims.craters]
    return found if np.median(in_radii) <= _LARGEST_PLACE else None


def _of_most_seen(frames: Sequence[FrameMeasurement], most: int) -> list[FrameMeasurement]:
    """Keep the rims of the craters that most frames show."""
    seen = np.bincount(np.concatenate([frame.rims.craters for frame in frames] or [np.empty(0, np.int64)]))
    kept = np.zeros(len(seen), dtype=np.bool_)
    kept[np.argsort(-seen, kind="stable")[:most]] = True
    return [replace(frame, rims=frame.rims.take(kept[frame.rims.craters])) for frame in frames]


class PlaceEquations(NamedTuple):
    """Normal equations A x = b of the displacements x of craters, east and north of each after the other.

    The poses of the images are eliminated, so that a displacement of all craters alike changes nothing.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Rows of the catalogue.
    A : ndarray, shape (2n, 2n)
        Information on the displacements, which are in m.
    b : ndarray, shape (2n,)
        A times the displacements in m.
    """

    craters: IntArray
    A: FloatArray
    b: FloatArray


def place_equations(
    frames: Sequence[FrameMeasurement],
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    errors: EstimatedErrors | None,
) -> PlaceEquations | None:
    """Set up the equations for how far the craters of a catalogue are displaced along the ground.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
        With the errors of the measurement alone.
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m, near which those of the rims are.
    camera : Camera
    catalog : Catalog
    errors : EstimatedErrors or None
        Of the catalogue, if they are known. Those of places are not used but for the poses.

    Returns
    -------
    PlaceEquations or None
        None where no image has enough rims, or the displacements do not explain them.
    """
    images = _Images.of(_of_most_seen(frames, _MOST_DISPLACED), gTb, camera, catalog)
    if not images.rims:
        return None
    variances = images.start()
    if errors is not None:
        variances[~_NOISE] = [getattr(errors, one.name) ** 2 for one in fields(errors)]
    variances[_NOISE] = 0.0
    # Where half of the craters are displaced none of them is an outlier.
    rims = images.linearised(variances, _FIRST_POSE_STEPS, np.inf)
    if rims is None:
        return None
    variances[:2] = 0.0
    W = np.linalg.inv(rims.total(variances))
    angle = catalog.angle_rad[rims.craters]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    place, X = rims.roots[0] @ turn, rims.slopes
    craters, index = np.unique(rims.craters, return_inverse=True)
    A, b = np.zeros((2 * len(craters), 2 * len(craters))), np.zeros(2 * len(craters))
    eliminated: list[tuple[slice, FloatArray]] = []
    for first, end in itertools.pairwise([*rims.first.tolist(), len(index)]):
        own = slice(first, end)
        columns = (2 * index[own, None] + np.arange(2)).ravel()
        Z = np.zeros((end - first, 5, len(columns)))
        for i in range(end - first):
            Z[i, :, 2 * i : 2 * i + 2] = place[first + i]
        WX, WZ = W[own] @ X[own], W[own] @ Z
        N = np.einsum("nij,nik->jk", X[own], WX)
        N[range(SHARED_SIZE), range(SHARED_SIZE)] += 1.0
        scale = np.sqrt(np.diag(N))
        inverse = np.linalg.inv(N / np.outer(scale, scale)) / np.outer(scale, scale)
        XZ = np.einsum("nij,nik->jk", WX, Z)
        left = rims.residual[own] - X[own] @ (inverse @ np.einsum("nij,ni->j", WX, rims.residual[own]))
        np.add.at(A, (columns[:, None], columns), np.einsum("nij,nik->jk", Z, WZ) - XZ.T @ inverse @ XZ)
        np.add.at(b, columns, np.einsum("nij,ni->j", WZ, left))
        eliminated.append((own, inverse))
    x = np.linalg.lstsq(A, b, rcond=1e-9)[0].reshape(-1, 2)
    left = rims.residual - np.einsum("nij,nj->ni", place, x[index])
    for own, inverse in eliminated:
        left[own] -= X[own] @ (inverse @ np.einsum("nij,nik,nk->j", X[own], W[own], left[own]))
    squares = np.einsum("ni,nij,nj->n", left, W, left)
    # Displacements do not explain rims that are matched with other craters in other images.
    return PlaceEquations(craters, A, b) if np.median(squares) < _LARGEST_SQUARE else None


class _Weighted(NamedTuple):
    """Rims with their poses projected out: weighted residuals (n, 5), weights of each rim (n, 5, 5)."""

    residual: FloatArray
    weights: FloatArray
    log_likelihood: float


@dataclass(frozen=True)
class _Rims:
    """Rims of all images, those of an image together, linearised in its pose.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
    first : ndarray of int, shape (k,)
        Where the rims of each image begin.
    residual : ndarray, shape (n, 5)
        Measured minus predicted.
    slopes : ndarray, shape (n, 5, 14)
        Derivatives in what all rims of an image have in common: errors of unit variance (`RimSet.shared`),
        then the pose.
    covariance : ndarray, shape (n, 5, 5)
        Of each measurement alone.
    roots : tuple of ndarray, shapes (n, 5, m)
        By component, the derivatives in errors of unit standard deviation.
    """

    craters: IntArray
    first: IntArray
    residual: FloatArray
    slopes: FloatArray
    covariance: FloatArray
    roots: tuple[FloatArray, ...]

    @classmethod
    def joined(cls, parts: "Sequence[_Rims]") -> "_Rims":
        """Join images."""
        first = np.cumsum([0, *(len(one.craters) for one in parts[:-1])])
        names = ("craters", "residual", "slopes", "covariance")
        craters, residual, slopes, covariance = (
            np.concatenate([getattr(one, name) for one in parts]) for name in names
        )
        roots = tuple(np.concatenate(every) for every in zip(*(one.roots for one in parts), strict=True))
        return cls(craters, first, residual, slopes, covariance, roots)

    def total(self, variances: FloatArray) -> FloatArray:
        """Covariances (n, 5, 5) with the errors of the map, but without what rims have in common."""
        out = self.covariance.copy()
        for variance, root in zip(variances, self.roots, strict=True):
            out += variance * (root @ np.swapaxes(root, 1, 2))
        return out

    def distances(self, variances: FloatArray) -> FloatArray:
        """Mahalanobis distances (n,) of the residuals."""
        return np.sqrt(squared_distance(self.residual, self.total(variances)))

    def weighted(self, variances: FloatArray) -> _Weighted:
        """Project the poses out."""
        V = self.total(variances)
        W = np.linalg.inv(V)
        WZ = W @ self.slopes
        N = np.add.reduceat(np.swapaxes(self.slopes, 1, 2) @ WZ, self.first)
        N[:, range(SHARED_SIZE), range(SHARED_SIZE)] += 1.0
        scale = np.sqrt(np.diagonal(N, axis1=1, axis2=2))
        unscaled = np.linalg.inv(N / (scale[:, :, None] * scale[:, None, :]))
        inverse = unscaled / (scale[:, :, None] * scale[:, None, :])
        counts = np.diff([*self.first, len(self.craters)])
        image = np.repeat(np.arange(len(self.first)), counts)
        b = np.add.reduceat(np.einsum("nik,ni->nk", WZ, self.residual), self.first)
        common = np.einsum("fkl,fl->fk", inverse, b)[image]
        residual = np.einsum("nij,nj->ni", W, self.residual) - np.einsum("nik,nk->ni", WZ, common)
        weights = W - WZ @ inverse[image] @ np.swapaxes(WZ, 1, 2)
        logs = (
            np.linalg.slogdet(V)[1].sum() - np.linalg.slogdet(unscaled)[1].sum() + 2.0 * np.log(scale).sum()
        )
        return _Weighted(residual, weights, -0.5 * float(np.sum(residual * self.residual) + logs))


@dataclass(frozen=True)
class _Images:
    """Images and the poses of the body near them, which are corrected in place."""

    rims: Sequence[RimSet]
    poses: Sequence[FloatArray]
    camera: Camera
    catalog: Catalog

    @classmethod
    def of(
        cls, frames: Sequence[FrameMeasurement], gTb: FloatArray, camera: Camera, catalog: Catalog
    ) -> "_Images":
        """Take some of the images that have enough rims."""
        seen = [(f.rims, T) for f, T in zip(frames, gTb, strict=True) if len(f.rims) >= _MIN_RIMS]
        some = seen[:: 1 + len(seen) // _FRAMES]
        return cls([rims for rims, _ in some], [np.array(T, order="C") for _, T in some], camera, catalog)

    def start(self) -> FloatArray:
        """Variances (7,) at which the search begins."""
        ranges_m = [
            np.linalg.norm(self.catalog.centres[rims.craters] - T[:3, 3], axis=1)
            for rims, T in zip(self.rims, self.poses, strict=True)
        ]
        px_m = float(np.median(np.concatenate(ranges_m))) / self.camera.focal_px
        return np.asarray((_START * np.where(_IN_PX, px_m, 1.0)) ** 2)

    def linearised(self, variances: FloatArray, steps: int, outlier: float) -> _Rims | None:
        """Linearise at the poses that the rims give, without outliers; None where none are left."""
        every = [
            self._at_own_pose(rims, T, variances, steps)
            for rims, T in zip(self.rims, self.poses, strict=True)
        ]
        found = [one for one in every if one is not None]
        if not found:
            return None
        away = [one.distances(variances) for one in found]
        limit = outlier * float(np.median(np.concatenate(away)))
        kept = [_taken(one, d <= limit) for one, d in zip(found, away, strict=True)]
        enough = [one for one in kept if len(one.craters) >= _MIN_RIMS]
        return _Rims.joined(enough) if enough else None

    def _at_own_pose(self, rims: RimSet, gTb: FloatArray, variances: FloatArray, steps: int) -> _Rims | None:
        """Linearise an image at the pose that most of its rims give; None where they give none."""
        for _ in range(steps):
            at = self._at(rims, gTb)
            if at is None:
                return None
            # Least absolute distances: a wrong match does not decide.
            weights = np.sqrt(1.0 / np.maximum(at.distances(variances), 1.0))[:, None, None]
            W = weights * np.linalg.inv(np.linalg.cholesky(at.total(variances)))
            A = (W @ at.slopes[:, :, SHARED_SIZE:]).reshape(-1, 6)
            b = (W @ at.residual[:, :, None]).ravel()
            scale = np.linalg.norm(A, axis=0)
            move(gTb, np.linalg.lstsq(A / scale, b, rcond=None)[0] / scale)
        return self._at(rims, gTb)

    def _at(self, rims: RimSet, gTb: FloatArray) -> _Rims | None:
        """Linearise the rims that a pose sees; None where they are too few."""
        catalog, bTc = self.catalog, self.camera.bTc
        centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
        charts, jacobians, visible = chart_jacobian(gTb, bTc, centres, axes)
        if visible.sum() < _MIN_RIMS:
            return None
        ground = ground_slopes(gTb, bTc, centres, axes)
        radius_m = radii_m(catalog)[rims.craters][:, None, None]
        shared = np.zeros((len(rims), 5, SHARED_SIZE)) if rims.shared is None else rims.shared
        covariance = rims.covariance - shared @ np.swapaxes(shared, 1, 2)
        place, size = ground[:, :, :2], ground[:, :, 3:] * np.array([1.0, np.sqrt(0.5), 1.0])
        height = ground[:, :, 2:3]
        tilts = tilt_slopes(gTb, bTc, centres, axes)
        noise = np.asarray(np.linalg.cholesky(rims.covariance), float)
        at = _Rims(
            rims.craters,
            np.zeros(1, dtype=np.int64),
            rims.chart - charts,
            np.concatenate([shared, jacobians], axis=2),
            covariance,
            (place / radius_m, place, size, height / radius_m, height, tilts, noise),
        )
        return at if visible.all() else _taken(at, visible)


def _taken(rims: _Rims, kept: BoolArray) -> _Rims:
    """Select rims of one image, with a mask (n,)."""
    return _Rims(
        rims.craters[kept],
        rims.first,
        rims.residual[kept],
        rims.slopes[kept],
        rims.covariance[kept],
        tuple(root[kept] for root in rims.roots),
    )


def _likeliest(rims: _Rims, variances: FloatArray) -> FloatArray:
    """Variances (7,) at which the residuals are likeliest; those that are zero stay so."""
    for _ in range(_ITERATIONS):
        found, expected = _moments(rims, variances)
        variances = variances * found / expected
    return variances


def _rises(rims: _Rims, variances: FloatArray) -> BoolArray:
    """Whether (7,) the likelihood rises with each variance."""
    found, expected = _moments(rims, variances)
    return found > expected


def _moments(rims: _Rims, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of the weighted residuals along each component, and what is expected of them, (7,) each."""
    seen = rims.weighted(variances)
    found = [np.sum(np.einsum("nim,ni->nm", root, seen.residual) ** 2) for root in rims.roots]
    expected = [np.sum(root * (seen.weights @ root)) for root in rims.roots]
    return np.array(found), np.array(expected)
