"""What one image says: rims in the ellipse chart, arcs of rims as edge points, and the sun's tilt."""

from dataclasses import dataclass, field, fields, replace

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# In sigmas of what was measured: a shape expected further away is a worse guess than the measured one.
EXPECTED_SIGMAS = 5.0
# Components of the error that all rims of a descent share.
SHARED_SIZE = 8


def image_change(before: FloatArray, after: FloatArray) -> FloatArray:
    """By how much the shapes of ellipses differ: the largest logarithm of a stretch, of any direction.

    An image that is larger by 10 % has changed by 0.1, whatever its shape; one seen at another slant by the
    logarithm of its foreshortening. Neither its place in the image nor the image's axes matter.

    Parameters
    ----------
    before, after : ndarray, shape (..., 5)
        Charts.
    """
    # S = L L', L lower triangular: singular values of inv(L1) L2.
    a = np.exp(after[..., 2] - before[..., 2])
    d = np.exp(after[..., 4] - before[..., 4])
    b = (after[..., 3] - before[..., 3]) * np.exp(after[..., 2] - before[..., 4])
    half = 0.5 * np.log(a * d)
    # Half the sum of squares over the product is cosh of the difference of the logarithms.
    spread = 0.5 * np.arccosh(np.maximum(0.5 * (a * a + b * b + d * d) / (a * d), 1.0))
    return np.asarray(np.abs(half) + spread)


@dataclass(frozen=True)
class RimQuality:
    """How well the rims of one frame could be seen, one value per rim.

    Attributes
    ----------
    gain : ndarray, shape (n,)
        Shading gain: share by which a slope of 1 towards the light brightens the ground there.
    found_share : ndarray, shape (n,)
        Edge points that the fit kept, as a share of the places searched with enough gain.
    arc_share : ndarray, shape (n,)
        Part of the rim that the edge points cover.
    rms_px : ndarray, shape (n,)
        Of the edge points' distances to the ellipse.
    outline_share : ndarray, shape (n,)
        Root mean square of the rim's deviation from an ellipse, in radii; 0 where it is taken for one.
    """

    gain: FloatArray
    found_share: FloatArray
    arc_share: FloatArray
    rms_px: FloatArray
    outline_share: FloatArray

    def take(self, rows: npt.NDArray[np.bool_] | IntArray) -> "RimQuality":
        """Return that of some rims (a mask or indices)."""
        return RimQuality(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class RimSet:
    """The measured rims of one frame, matched to catalogue craters.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each rim's crater in the catalogue.
    chart : ndarray, shape (n, 5)
        Ellipse chart y = [m_x, m_y, ln(S_xx)/2, S_xy/S_xx, ln(S_yy - S_xy^2/S_xx)/2] in normalised
        image coordinates (EQUATIONS: "the chart to optimise in"); m is the image ellipse's centre.
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the chart, from each rim's own fit and the systematic floor: of all its error.
    quality : RimQuality or None
        None when the rims were not measured in an image.
    correlated : ndarray, shape (n, 5, 5), optional
        Root A of the part A A' of the covariance that a rim keeps from frame to frame: its error is A z with
        z nearly the same in the next frame, so the columns belong to directions that are fixed to the
        ground. None where no part is known to be kept.
    shared : ndarray, shape (n, 5, 8), optional
        Root of the part that all rims of a descent share: its error is A z with one z for all.
    """

    craters: IntArray
    chart: FloatArray
    covariance: FloatArray
    quality: RimQuality | None = None
    correlated: FloatArray | None = None
    shared: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.craters)

    def take(self, rows: npt.NDArray[np.bool_] | IntArray) -> "RimSet":
        """Return the rims of some rows (a mask or indices)."""
        quality = None if self.quality is None else self.quality.take(rows)
        correlated, shared = (None if A is None else A[rows] for A in (self.correlated, self.shared))
        return RimSet(
            self.craters[rows], self.chart[rows], self.covariance[rows], quality, correlated, shared
        )

    @property
    def uncorrelated_covariance(self) -> FloatArray:
        """Covariance (n, 5, 5) without its lasting parts."""
        out = self.covariance
        for A in (self.correlated, self.shared):
            if A is not None:
                out = out - A @ np.swapaxes(A, 1, 2)
        return out

    def expected_at(self, charts: FloatArray) -> "RimSet":
        """Return the same rims with the covariances that they had if these charts (n, 5) were the true ones.

        A fit takes its covariance at what it measured. Errors of edge points are in the image, so a rim
        measured too small is given a larger error of its logarithm and less weight: on average all seem too
        large. Here errors of S = L L' are kept in the units of L, not in those of its logarithm. Rims whose
        chart is not finite, or of a shape that the measured one contradicts, stay as they are.
        """
        off = self.chart[:, 2:] - charts[:, 2:]
        white = np.linalg.solve(self.covariance[:, 2:, 2:], off[..., None])[..., 0]
        near = np.sum(off * white, axis=1) < EXPECTED_SIGMAS**2
        T = np.zeros((len(self), 5, 5))
        T[:] = np.eye(5)
        first = np.exp(off[near, 0])
        T[near, 2, 2] = T[near, 3, 3] = first
        T[near, 3, 2] = first * off[near, 1]
        T[near, 4, 4] = np.exp(off[near, 2])
        covariance = T @ self.covariance @ np.swapaxes(T, 1, 2)
        correlated, shared = (None if A is None else T @ A for A in (self.correlated, self.shared))
        return replace(self, covariance=covariance, correlated=correlated, shared=shared)

    def inflate_correlated(self, frames: float) -> "RimSet":
        """Return the rims for those who take what lasts as new in each frame: it counts `frames` times."""
        out = self.covariance
        for A in (self.correlated, self.shared):
            if A is not None:
                out = out + (frames - 1.0) * A @ np.swapaxes(A, 1, 2)
        return RimSet(self.craters, self.chart, out, self.quality)

    def centres(self) -> "CentreSet":
        """Return the image ellipses' centres alone: what centre-based navigation measures."""
        return CentreSet(self.craters, self.chart[:, :2], self.covariance[:, :2, :2])

    @classmethod
    def empty(cls) -> "RimSet":
        """Return a frame without craters."""
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
    """

    craters: IntArray
    points: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.craters)


@dataclass(frozen=True)
class ArcSet:
    """Edge points of rims of which too little is seen for an ellipse: below about a third.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each arc's crater in the catalogue; none of them is in the frame's `RimSet`.
    points : tuple of n ndarray, shapes (m_i, 2)
        Edge points, normalised image coordinates.
    sigmas : tuple of n ndarray, shapes (m_i,)
        Standard deviations along the rim's normal, normalised, of what is independent from point to point
        and from frame to frame.
    lasting : ndarray, shape (n,), optional
        Standard deviation of an error that the points of an arc share and keep from frame to frame, outward,
        normalised. None where no part is known to be kept.
    """

    craters: IntArray
    points: tuple[FloatArray, ...]
    sigmas: tuple[FloatArray, ...]
    lasting: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.craters)

    def take(self, rows: npt.NDArray[np.bool_] | IntArray) -> "ArcSet":
        """Return the arcs of some rows (a mask or indices)."""
        chosen = np.arange(len(self))[rows].tolist()
        return ArcSet(
            self.craters[rows],
            tuple(self.points[i] for i in chosen),
            tuple(self.sigmas[i] for i in chosen),
            None if self.lasting is None else self.lasting[rows],
        )

    @classmethod
    def empty(cls) -> "ArcSet":
        """Return a frame without arcs."""
        return cls(np.empty(0, dtype=np.int64), (), ())

    def inflate_correlated(self, frames: float) -> "ArcSet":
        """Return the arcs for those who take what lasts as new in each frame: it counts `frames` times.

        The points' errors are then independent, and so large that their mean is as uncertain as it is.
        """
        if self.lasting is None:
            return self
        sigmas = tuple(
            np.sqrt(sigma**2 + frames * len(sigma) * shared**2)
            for sigma, shared in zip(self.sigmas, self.lasting, strict=True)
        )
        return ArcSet(self.craters, self.points, sigmas)


@dataclass(frozen=True)
class SunTilt:
    """Tilt of the ground's illumination in one image.

    Attributes
    ----------
    tilt_rad : float
        Angle of the direction towards the sun along the ground, from the image's x axis to its y axis.
    sigma_rad : float
        Its standard deviation.
    point : ndarray, shape (2,)
        Image point, normalised, at which it holds.
    direction : ndarray, shape (3,)
        The direction in g whose image it is: the sun's along the level ground at that point,
        s - (s.n) n, not necessarily a unit vector.
    """

    tilt_rad: float
    sigma_rad: float
    point: FloatArray
    direction: FloatArray


@dataclass(frozen=True)
class FrameMeasurement:
    """All that one image says.

    Attributes
    ----------
    stamp_ns : int
        Time of exposure.
    rims : RimSet
        Possibly empty.
    sun : SunTilt or None
        None when the image does not tell.
    arcs : ArcSet
        Possibly empty.
    """

    stamp_ns: int
    rims: RimSet
    sun: SunTilt | None
    arcs: ArcSet = field(default_factory=ArcSet.empty)

    def inflate_correlated(self, frames: float) -> "FrameMeasurement":
        """Return the measurement for those who take what lasts as new in each frame: see `RimSet`."""
        return replace(
            self, rims=self.rims.inflate_correlated(frames), arcs=self.arcs.inflate_correlated(frames)
        )
