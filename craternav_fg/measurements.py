"""Measurements of one image: rims as ellipse charts, parts of rims as edge points, and the sun's tilt."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from craternav_fg.errors import EstimationError
from factors import validation
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.errors import FactorError
from factors.kernels.compiled import njit

# A predicted shape farther than this from the measured one, in standard deviations, is not believed.
EXPECTED_SIGMAS = 5.0
# Unknowns of a rim's time-correlated error: five in the rim's plane.
CORRELATED_SIZE = 5
# Unknowns of a crater's error on the map, those of `factors.kernels.rim_errors.ground_slopes`, and the slopes
# of its rim's plane.
MAP_SIZE, TILT_SIZE = 6, 2
# Unknowns of the error that all rims of a descent share, see `vision.error_model.correlated`.
SHARED_SIZE = 8


@njit(cache=True, error_model="numpy")
def _at_predicted(
    chart: FloatArray, covariance: FloatArray, predicted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Factors T (n, 5, 5) of errors at predicted charts, and the covariances T S T', see `expected_at`.

    The identity where the prediction is not finite or contradicts the measurement.
    """
    n = len(chart)
    T = np.zeros((n, 5, 5))
    out = np.empty((n, 5, 5))
    for k in range(n):
        t, S = T[k], covariance[k]
        for i in range(5):
            t[i, i] = 1.0
        a, b, c = chart[k, 2] - predicted[k, 2], chart[k, 3] - predicted[k, 3], chart[k, 4] - predicted[k, 4]
        # Adjugate of the shape's covariance: two logarithms and a ratio are of like size.
        p, q, r = S[2, 2], S[3, 3], S[4, 4]
        d, e, f = S[3, 2], S[4, 2], S[4, 3]
        aa, bb, cc = q * r - f * f, p * r - e * e, p * q - d * d
        ab, ac, bc = e * f - d * r, d * f - e * q, d * e - p * f
        squared = aa * a * a + bb * b * b + cc * c * c + 2.0 * (ab * a * b + ac * a * c + bc * b * c)
        if squared / (p * aa + d * ab + e * ac) < EXPECTED_SIGMAS**2:
            t[2, 2] = t[3, 3] = np.exp(a)
            t[3, 2] = t[2, 2] * b
            t[4, 4] = np.exp(c)
        for i in range(5):
            for j in range(i + 1):
                total = 0.0
                for u in range(max(0, i - 1), i + 1):
                    for v in range(max(0, j - 1), j + 1):
                        total += t[i, u] * S[u, v] * t[j, v]
                out[k, i, j] = total
                out[k, j, i] = total
    return T, out


@dataclass(frozen=True)
class RimQuality:
    """How well the rims of one frame could be seen, one value per rim.

    Attributes
    ----------
    slope_contrast : ndarray, shape (n,)
        Relative change of the ground's brightness per unit slope, for a slope along the direction in which it
        changes most (see `photometry`).
    found_share : ndarray, shape (n,)
        Edge points that the fit kept, as a share of the places searched with enough contrast.
    arc_share : ndarray, shape (n,)
        Share of the rim that the edge points cover.
    rms_px : ndarray, shape (n,)
        Root mean square of the edge points' distances to the ellipse.
    outline_share : ndarray, shape (n,)
        Root mean square of the rim's deviation from an ellipse, in radii; 0 where the rim was fitted as one.
    """

    slope_contrast: FloatArray
    found_share: FloatArray
    arc_share: FloatArray
    rms_px: FloatArray
    outline_share: FloatArray

    def take(self, rows: BoolArray | IntArray) -> "RimQuality":
        """Select the quality of some rims.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), or of int, shape (k,)
            A mask or indices.
        """
        return RimQuality(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence["RimQuality"]) -> "RimQuality":
        """Join the qualities of several sets of rims, possibly none.

        Parameters
        ----------
        parts : sequence of RimQuality
        """
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([np.empty(0), *(getattr(one, name) for one in parts)]) for name in names))


@dataclass(frozen=True)
class RimSet:
    """Measured rims of one frame, matched to catalogue craters.

    The error of a rim's chart has up to four independent parts: white (new in each frame), time-correlated
    per crater (`correlated`), from the crater's error on the map (`of_map`) and common to all rims of a
    descent (`shared`).

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each rim's crater in the catalogue.
    chart : ndarray, shape (n, 5)
        Ellipse charts in normalised image coordinates, see `ellipse`; the first two are the centre of the
        image ellipse, which is not the image of the crater's centre.
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the whole error of each chart.
    quality : RimQuality or None
        None when the rims were not measured in an image.
    correlated : ndarray, shape (n, 5, 5), optional
        Root A of the time-correlated part A A' of the covariance. The error is A z, with a z per crater that
        changes little from frame to frame, so the columns belong to directions fixed to the ground: five in
        the rim's plane, of which the first two displace it. None when no such part is known.
    of_map : ndarray, shape (n, 5, m), optional
        Root A of the part from errors of the map: the error is A z, with a z per crater that is the same in
        all frames, but see `with_changing_place`. Of the columns, the first six displace, raise and stretch
        the rim, in the order of `factors.kernels.rim_errors.ground_slopes`, and the last two tilt its plane;
        m is 6, 2 or 8. None when the map counts as exact.
    shared : ndarray, shape (n, 5, 8), optional
        Root A of the common part of the covariance: the error is A z, with one z for all rims and frames,
        but for the entries of the third and the last column, which change slowly as the camera comes to other
        ground (`estimators.correlated_errors.REGIONAL`). None when no such part is known.
    fused_white : ndarray, shape (n, 5, 5), optional
        Covariance of the white part in estimators that fuse frames, where it is larger than the rims' own:
        where rims scatter more than they claim, neighbouring ones err alike, which no part of the covariance
        states. None for their own.
    """

    craters: IntArray
    chart: FloatArray
    covariance: FloatArray
    quality: RimQuality | None = None
    correlated: FloatArray | None = None
    of_map: FloatArray | None = None
    shared: FloatArray | None = None
    fused_white: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.craters)

    def take(self, rows: BoolArray | IntArray) -> "RimSet":
        """Select some rims.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), or of int, shape (k,)
            A mask or indices.
        """
        quality = None if self.quality is None else self.quality.take(rows)
        parts = (*self.kept, self.fused_white)
        return RimSet(
            self.craters[rows], self.chart[rows], self.covariance[rows], quality,
            *(None if part is None else part[rows] for part in parts),
        )  # fmt: skip

    def matched_once(self) -> "RimSet":
        """Leave out rims of one crater: of two, nothing tells which is the wrong match."""
        _, first, count = np.unique(self.craters, return_index=True, return_counts=True)
        return self.take(np.sort(first[count == 1]))

    @property
    def kept(self) -> tuple[FloatArray | None, FloatArray | None, FloatArray | None]:
        """Roots (n, 5, m) of what is not white of the error: `correlated`, `of_map` and `shared`."""
        return self.correlated, self.of_map, self.shared

    @property
    def map_columns(self) -> slice:
        """Columns of `of_map` among all, shape (8,): slopes of rims' planes may stand alone."""
        count = 0 if self.of_map is None else self.of_map.shape[2]
        begin = MAP_SIZE if count == TILT_SIZE else 0
        return slice(begin, begin + count)

    @property
    def uncorrelated_covariance(self) -> FloatArray:
        """Covariance (n, 5, 5) of the white part of the error alone."""
        out = self.covariance
        for A in self.kept:
            if A is not None:
                out = out - A @ np.swapaxes(A, 1, 2)
        return out

    @property
    def fused_white_covariance(self) -> FloatArray:
        """Covariance (n, 5, 5) of the white part for estimators that fuse frames."""
        return self.uncorrelated_covariance if self.fused_white is None else self.fused_white

    def expected_at(self, charts: FloatArray) -> "RimSet":
        """Evaluate the covariances at predicted charts instead of the measured ones.

        A fit evaluates its covariance at what it measured. Edge points have the same error in pixels whatever
        the size of the rim, so a rim measured too small gets a larger error of its logarithmic size and less
        weight than one measured too large: a weighted mean is biased towards large rims. Here the error of
        S = L L' is kept fixed in the units of L instead. Rims keep their covariance where the predicted chart
        is not finite or its shape contradicts the measured one (`EXPECTED_SIGMAS`).

        Parameters
        ----------
        charts : ndarray, shape (n, 5)
            Predicted charts, in normalised image coordinates.
        """
        T, covariance = _at_predicted(self.chart, np.ascontiguousarray(self.covariance), charts)
        correlated, of_map, shared = (None if A is None else T @ A for A in self.kept)
        fused = None if self.fused_white is None else T @ self.fused_white @ np.swapaxes(T, 1, 2)
        # `replace` takes as long as the rest, and the online smoother comes here for every frame.
        return RimSet(
            self.craters, self.chart, covariance, self.quality, correlated, of_map, shared, fused
        )  # fmt: skip

    def inflate_correlated(self, factor: float | FloatArray, of_shared: float | None = None) -> "RimSet":
        """Treat the correlated parts of the error as white, with their variance multiplied by a factor.

        An estimator that has no variables for them would average them out over the frames that show a crater;
        with a factor of about the number of such frames it does not. The white part is that for estimators
        that fuse frames. The result has no correlated parts.

        Parameters
        ----------
        factor : float or ndarray, shape (n,)
            Variance inflation of the correlated parts, for all rims or for each.
        of_shared : float, optional
            That of the part which all rims share, if it is another.
        """
        if self.fused_white is None and all(A is None for A in self.kept):
            return self
        own = np.broadcast_to(factor, len(self))[:, None, None]
        out = self.fused_white_covariance
        for A, f in ((self.correlated, own), (self.of_map, own), (self.shared, of_shared or own)):
            if A is not None:
                out = out + f * A @ np.swapaxes(A, 1, 2)
        return RimSet(self.craters, self.chart, out, self.quality)

    def scaled(self, factors: FloatArray) -> "RimSet":
        """Multiply the variances of rims, but for what all rims share.

        Parameters
        ----------
        factors : ndarray, shape (n,)
            Variance factors.
        """
        shared = np.zeros_like(self.covariance)
        if self.shared is not None:
            shared = self.shared @ np.swapaxes(self.shared, 1, 2)
        covariance = shared + factors[:, None, None] * (self.covariance - shared)
        scale = np.sqrt(factors)[:, None, None]
        correlated, of_map = (None if A is None else scale * A for A in (self.correlated, self.of_map))
        fused = None if self.fused_white is None else factors[:, None, None] * self.fused_white
        return replace(
            self, covariance=covariance, correlated=correlated, of_map=of_map, fused_white=fused
        )  # fmt: skip

    def with_changing_place(self, share: float) -> "RimSet":
        """Count a part of the map's errors of place as time-correlated.

        Parameters
        ----------
        share : float
            Share of their variance. Nothing is moved where roots of time-correlated errors are singular.
        """
        if share == 0.0 or self.of_map is None or self.of_map.shape[2] < MAP_SIZE:
            return self
        scale = np.ones(self.of_map.shape[2])
        scale[:2] = np.sqrt(1.0 - share)
        moved = np.sqrt(share) * self.of_map[:, :, :2]
        if self.correlated is None:
            correlated = np.zeros((len(self), 5, CORRELATED_SIZE))
            correlated[:, :, :2] = moved
        else:
            # The triangular root of the sum: its columns belong to the same directions on the ground.
            try:
                Q = np.linalg.solve(self.correlated, moved)
            except np.linalg.LinAlgError:
                return self
            whole = np.eye(CORRELATED_SIZE) + Q @ np.swapaxes(Q, 1, 2)
            correlated = self.correlated @ np.linalg.cholesky(whole)
        return replace(self, correlated=correlated, of_map=scale * self.of_map)

    def with_exact_map(self) -> "RimSet":
        """Take the errors of the map out, but for the slopes of rims' planes."""
        if self.of_map is None or self.of_map.shape[2] == TILT_SIZE:
            return self
        A, tilts = self.of_map[:, :, :MAP_SIZE], self.of_map[:, :, MAP_SIZE:]
        left = self.covariance - A @ np.swapaxes(A, 1, 2)
        return replace(self, covariance=left, of_map=tilts if tilts.shape[2] else None)

    def centres(self) -> "CentreSet":
        """Reduce the rims to the centres of the image ellipses: what centre-based navigation measures."""
        return CentreSet(self.craters, self.chart[:, :2], self.covariance[:, :2, :2])

    @classmethod
    def empty(cls) -> "RimSet":
        """Make the set of a frame without craters."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 5)), np.empty((0, 5, 5)))


@dataclass(frozen=True)
class CentreSet:
    """Centres of the image ellipses of one frame, matched to catalogue craters.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each one's crater in the catalogue.
    points : ndarray, shape (n, 2)
        Normalised image coordinates.
    covariance : ndarray, shape (n, 2, 2)
        Covariance of the points.
    """

    craters: IntArray
    points: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.craters)


@dataclass(frozen=True)
class ArcSet:
    """Edge points of rims of which too little is seen to fit an ellipse: less than about a third.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each arc's crater in the catalogue; none of them is in the frame's `RimSet`.
    points : tuple of n ndarray, shapes (m_i, 2)
        Edge points, normalised image coordinates.
    sigmas : tuple of n ndarray, shapes (m_i,)
        Standard deviations of the points' white errors, normalised, along the rim's normal: independent from
        point to point and from frame to frame.
    correlated_sigmas : ndarray, shape (n,), optional
        Standard deviation of each arc's time-correlated error, normalised: an outward shift that its points
        share and that hardly changes from frame to frame. None when no such part is known.
    shared : ndarray, shape (n, 5, 8), optional
        Roots of the error that all rims of a descent share, of the arcs' rims: what it adds to their charts,
        as in `RimSet`. None when no such part is known.
    images : ndarray of int, shape (n,), optional
        In how many images the time-correlated error is the same, as errors of the map are. None where it
        changes with the image.
    """

    craters: IntArray
    points: tuple[FloatArray, ...]
    sigmas: tuple[FloatArray, ...]
    correlated_sigmas: FloatArray | None = None
    shared: FloatArray | None = None
    images: IntArray | None = None

    def __len__(self) -> int:
        return len(self.craters)

    def take(self, rows: BoolArray | IntArray) -> "ArcSet":
        """Select some arcs.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), or of int, shape (k,)
            A mask or indices.
        """
        chosen = np.arange(len(self))[rows].tolist()
        return ArcSet(
            self.craters[rows],
            tuple(self.points[i] for i in chosen),
            tuple(self.sigmas[i] for i in chosen),
            None if self.correlated_sigmas is None else self.correlated_sigmas[rows],
            None if self.shared is None else self.shared[rows],
            None if self.images is None else self.images[rows],
        )

    @classmethod
    def empty(cls) -> "ArcSet":
        """Make the set of a frame without arcs."""
        return cls(np.empty(0, dtype=np.int64), (), ())

    def inflate_correlated(self, factor: float) -> "ArcSet":
        """Treat the time-correlated error as white, with its variance multiplied by a factor.

        The points' errors are then independent, and so much larger that the variance of their mean is what it
        was with the shared error. `shared` is kept as it is: it is small beside it, and counts only where it
        is a variable.

        Parameters
        ----------
        factor : float
            Variance inflation, see `RimSet.inflate_correlated`; above 1 at least the number of `images`.
        """
        if self.correlated_sigmas is None:
            return self
        factors = np.full(len(self), factor)
        if self.images is not None and factor > 1.0:
            factors = np.maximum(factors, self.images)
        sigmas = tuple(
            np.sqrt(sigma**2 + f * len(sigma) * shared**2)
            for sigma, f, shared in zip(self.sigmas, factors.tolist(), self.correlated_sigmas, strict=True)
        )
        return ArcSet(self.craters, self.points, sigmas, shared=self.shared)


@dataclass(frozen=True)
class KnownAttitude:
    """Attitude of the body from another sensor, such as a star tracker.

    Attributes
    ----------
    gRb : ndarray, shape (3, 3)
        Rotation from b to g.
    sigma_rad : float
        Standard deviation about each axis of b; 0 takes the attitude as exact.
    """

    gRb: FloatArray
    sigma_rad: float = 0.0

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "gRb", validation.rotation("attitude.gRb", self.gRb))
        except FactorError as error:
            raise EstimationError(str(error)) from None
        if not (np.isfinite(self.sigma_rad) and self.sigma_rad >= 0.0):
            raise EstimationError(f"attitude.sigma_rad: expected 0 or more, found {self.sigma_rad}")


@dataclass(frozen=True)
class SunTilt:
    """Direction of the sun along the ground, as an angle in one image.

    Attributes
    ----------
    tilt_rad : float
        Angle of the direction towards the sun along the ground, from the image's x axis to its y axis.
    sigma_rad : float
        Its standard deviation.
    point : ndarray, shape (2,)
        Image point at which the angle was measured, normalised image coordinates.
    direction : ndarray, shape (3,)
        The direction in g whose image the tilt is: the sun's direction s along the locally flat terrain at
        that point, s - (s.n) n with the unit normal n. Not necessarily a unit vector.
    """

    tilt_rad: float
    sigma_rad: float
    point: FloatArray
    direction: FloatArray


@dataclass(frozen=True)
class FrameMeasurement:
    """Everything measured in one image.

    Attributes
    ----------
    stamp_ns : int
        Time of exposure.
    rims : RimSet
        Possibly empty.
    sun : SunTilt or None
        None when the image does not show the direction of the light.
    arcs : ArcSet
        Possibly empty.
    """

    stamp_ns: int
    rims: RimSet
    sun: SunTilt | None
    arcs: ArcSet = field(default_factory=ArcSet.empty)

    def inflate_correlated(self, factor: float) -> "FrameMeasurement":
        """Treat the correlated errors of rims and arcs as white, see `RimSet.inflate_correlated`.

        Parameters
        ----------
        factor : float
            Variance inflation.
        """
        rims, arcs = self.rims.inflate_correlated(factor), self.arcs.inflate_correlated(factor)
        return FrameMeasurement(self.stamp_ns, rims, self.sun, arcs)
