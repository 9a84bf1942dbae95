"""Resection problem and result, the same for every solver."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import EstimationError
from craternav_fg.frames import rotate_position_block
from craternav_fg.measurements import KnownAttitude, RimSet, SunTilt
from factors import validation
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.errors import FactorError
from factors.kernels import packed
from factors.kernels.robust import NONE

_NO_WEIGHT = np.empty((0, 0))
_NO_SUN = np.empty(0)


class ResectionError(EstimationError):
    """A resection problem with an invalid value; the text names the field."""


@contextmanager
def _as_resection_error() -> Iterator[None]:
    """Convert a factor's error about a field to one of this package's."""
    try:
        yield
    except FactorError as error:
        raise ResectionError(str(error)) from None


@dataclass(frozen=True)
class MatchedRims:
    """Image ellipses, each matched to a crater.

    Attributes
    ----------
    identifiers : tuple of str, length n
        Names of the craters, unique.
    centres : ndarray, shape (n, 3)
        Rim centres gL in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in g, m; l1 x l2 is outward.
    chart : ndarray, shape (n, 5)
        Measured ellipse charts in normalised image coordinates (see `RimSet`).
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the charts.
    whitening : ndarray, shape (n, 5, 5)
        Lower triangular W with W S W' = 1, S the covariance; computed here.

    Raises
    ------
    ResectionError
        When a crater is matched twice or an array is invalid.
    """

    identifiers: tuple[str, ...]
    centres: FloatArray
    axes: FloatArray
    chart: FloatArray
    covariance: FloatArray
    whitening: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.identifiers)
        repeated = [name for k, name in enumerate(self.identifiers) if name in self.identifiers[:k]]
        if repeated:
            raise ResectionError(f"crater {repeated[0]!r} is matched to more than one rim")
        shapes = {"centres": (n, 3), "chart": (n, 5), "covariance": (n, 5, 5)}
        with _as_resection_error():
            for name, shape in shapes.items():
                object.__setattr__(self, name, validation.array(name, getattr(self, name), shape))
            object.__setattr__(self, "axes", validation.rim_axes("axes", self.axes, n))
            object.__setattr__(self, "whitening", validation.whitening("covariance", self.covariance, n, 5))

    def __len__(self) -> int:
        return len(self.identifiers)

    @classmethod
    def of(cls, rims: RimSet, catalog: Catalog) -> "MatchedRims":
        """Combine the measured rims of a frame with their craters from the catalogue.

        Parameters
        ----------
        rims : RimSet
        catalog : Catalog

        Returns
        -------
        MatchedRims
        """
        rows = rims.craters
        return cls(
            tuple(catalog.identifiers[row] for row in rows),
            catalog.centres[rows],
            catalog.axes[rows],
            rims.chart,
            rims.covariance,
        )

    def take(self, rows: BoolArray | IntArray | Sequence[int]) -> "MatchedRims":
        """Select some rims.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), or of int, shape (k,)
            A mask or indices.

        Returns
        -------
        MatchedRims
        """
        index = np.arange(len(self))[rows if len(rows) else slice(0)]
        return MatchedRims(
            tuple(self.identifiers[k] for k in index),
            self.centres[index],
            self.axes[index],
            self.chart[index],
            self.covariance[index],
        )

    @property
    def normals(self) -> FloatArray:
        """Outward unit normals of the rims' planes in g, shape (n, 3)."""
        n = np.cross(self.axes[:, 0], self.axes[:, 1])
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    def packed(self, bTc: FloatArray) -> FloatArray:
        """Pack the rims for the kernels.

        Parameters
        ----------
        bTc : ndarray, shape (4, 4)
            Mounting of the camera.

        Returns
        -------
        ndarray, shape (packed,)
            Numbers as `factors.kernels.packed.pack` arranges them.
        """
        return packed.pack(bTc, self.centres, self.axes, self.chart, self.whitening, NONE, 1.0)

    def residuals(self, gTb: FloatArray, bTc: FloatArray) -> FloatArray:
        """Compute whitened chart residuals at a pose.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
        bTc : ndarray, shape (4, 4)
            Mounting of the camera.

        Returns
        -------
        ndarray, shape (n, 5)
            Predicted minus measured, whitened; very large where a rim is not visible.
        """
        out = np.empty((7, 5 * len(self)))
        packed.shape_residuals(np.ascontiguousarray(gTb), self.packed(bTc), False, out)
        return np.ascontiguousarray(out[6].reshape(-1, 5))


@dataclass(frozen=True)
class PosePrior:
    """Prior knowledge of the pose.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Expected pose of the body.
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b.

    Raises
    ------
    ResectionError
        When an array is invalid.
    """

    gTb: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        with _as_resection_error():
            object.__setattr__(self, "gTb", validation.pose("prior.gTb", self.gTb))
            covariance = validation.array("prior.covariance", self.covariance, (6, 6))
            validation.whitening("prior.covariance", covariance[None], 1, 6)
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True)
class ResectionProblem:
    """The matched rims of one image, and what else is known about the pose.

    Attributes
    ----------
    rims : MatchedRims
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    prior : PosePrior or None
    attitude : KnownAttitude or None
        Not together with a prior.
    sun : SunTilt or None

    Raises
    ------
    ResectionError
        When a value is invalid, or a prior and a known attitude are given together.
    """

    rims: MatchedRims
    bTc: FloatArray = field(default_factory=lambda: np.eye(4))
    prior: PosePrior | None = None
    attitude: KnownAttitude | None = None
    sun: SunTilt | None = None

    def __post_init__(self) -> None:
        with _as_resection_error():
            object.__setattr__(self, "bTc", validation.pose("bTc", self.bTc))
        if self.prior is not None and self.attitude is not None:
            raise ResectionError("expected a prior or a known attitude, found both")
        if self.sun is not None and not (
            self.sun.sigma_rad > 0.0
            and np.isfinite(
                [self.sun.tilt_rad, self.sun.sigma_rad, *self.sun.point, *self.sun.direction]
            ).all()
            and np.linalg.norm(self.sun.direction) > 0.0
        ):
            raise ResectionError("sun: expected finite numbers, a positive sigma and a direction")

    @property
    def first_free(self) -> int:
        """First of the six coordinates of the twist that is estimated: 3 with an exact attitude, else 0."""
        return 3 if self.attitude is not None and self.attitude.sigma_rad == 0.0 else 0

    def prior_arrays(self) -> tuple[FloatArray, FloatArray]:
        """Return prior or inexact attitude as the kernels take them.

        Returns
        -------
        gTb : ndarray, shape (4, 4)
        weight : ndarray, shape (6, 6) or (0, 0)
            Inverse covariance of the errors of attitude (rotation vector in b, rad) and position (in g, m);
            empty without a prior.
        """
        if self.prior is not None:
            covariance = rotate_position_block(self.prior.covariance, self.prior.gTb[:3, :3])
            return self.prior.gTb, np.asarray(np.linalg.inv(covariance))
        if self.attitude is not None and self.attitude.sigma_rad > 0.0:
            expected = np.eye(4)
            expected[:3, :3] = self.attitude.gRb
            return expected, np.diag([self.attitude.sigma_rad**-2] * 3 + [0.0] * 3)
        return np.eye(4), _NO_WEIGHT

    def sun_array(self) -> FloatArray:
        """Return the sun's tilt as the kernels take it.

        Returns
        -------
        ndarray, shape (7,) or (0,)
            Direction in g, image point, tilt and its standard deviation in rad; empty without the sun.
        """
        sun = self.sun
        if sun is None:
            return _NO_SUN
        return np.array([*sun.direction, *sun.point, sun.tilt_rad, sun.sigma_rad], dtype=np.float64)

    def inflated(self, factor: float) -> "ResectionProblem":
        """Multiply the standard deviations of the rims by a factor.

        Parameters
        ----------
        factor : float

        Returns
        -------
        ResectionProblem
        """
        return replace(self, rims=replace(self.rims, covariance=factor**2 * self.rims.covariance))

    def range_m(self, gTb: FloatArray) -> float:
        """Compute the distance from the camera to the mean of the craters' centres.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)

        Returns
        -------
        float
        """
        middle = np.add.reduce(self.rims.centres) / len(self.rims)
        return float(math.dist(gTb[:3, :3] @ self.bTc[:3, 3] + gTb[:3, 3], middle))


class Status(Enum):
    """Outcome of a resection; `ResectionResult.reason` gives the details."""

    SOLVED = "solved"
    AMBIGUOUS = "several poses explain the image"
    UNDETERMINED = "the image does not determine the whole pose"
    TOO_FEW_RIMS = "too few rims"
    NO_POSE = "no pose explains the rims"
    NOT_CONVERGED = "the optimiser did not converge"


@dataclass(frozen=True)
class PoseSolution:
    """One pose that explains the image.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b; NaN when the pose is undetermined.
    residuals : ndarray, shape (n, 5)
        Whitened chart residuals of all rims, predicted minus measured.
    cost : float
        Squared norm of all whitened residuals that were minimised, those of prior and sun included.
    probability : float
        Probability of this pose among those found.
    """

    gTb: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    cost: float
    probability: float = 1.0

    @property
    def position_covariance(self) -> FloatArray:
        """Covariance of the position in g, m^2, shape (3, 3)."""
        R = self.gTb[:3, :3]
        return np.asarray(R @ self.covariance[3:, 3:] @ R.T)


@dataclass(frozen=True)
class ResectionResult:
    """Result of a resection.

    Attributes
    ----------
    status : Status
    reason : str
        Details, in one line; empty when the status is `SOLVED`.
    poses : tuple of PoseSolution
        All distinct solutions, the most probable first; samples of a continuum when `UNDETERMINED`; empty
        when there is none.
    wrong : tuple of str
        Identifiers of the craters whose rims were found to be wrongly matched.
    warnings : tuple of str
        One line each: that nothing checks the matches, that most of them are wrong, or that the covariance
        may not describe the errors.
    sigma_scale : float
        Factor by which the standard deviations of the rims were multiplied, because their residuals show that
        they are too small.
    focal_scale, focal_scale_sigma : float
        Focal length that the rims alone show, over the camera's, and its standard deviation; NaN when it was
        not estimated (see `intrinsics.with_unknown_intrinsics`).
    """

    status: Status
    reason: str
    poses: tuple[PoseSolution, ...]
    wrong: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    sigma_scale: float = 1.0
    focal_scale: float = math.nan
    focal_scale_sigma: float = math.nan

    @property
    def solved(self) -> bool:
        """Whether there is exactly one pose; see `warnings` before it is used."""
        return self.status is Status.SOLVED

    @property
    def pose(self) -> PoseSolution:
        """The only solution.

        Raises
        ------
        ResectionError
            When the problem is not solved.
        """
        if not self.solved:
            raise ResectionError(f"no pose: {self.reason}")
        return self.poses[0]
