"""What a static solver is given, and what it answers: the same for every solver.

Perturbations are GTSAM's: right twist [w, rho] of the body's pose gTb, its local coordinates. Errors of
several degrees belong to its exponential, a screw about the ground ahead, along which weakly determined
poses lie; measured as (R exp(w), t + R rho) they look many standard deviations large.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import CraternavError
from craternav_fg.measurements import KnownAttitude, RimSet, SunTilt
from factors import validation
from factors.errors import FactorError
from factors.kernels import packed
from factors.kernels.robust import NONE

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class ResectionError(CraternavError):
    """A static problem is posed wrongly: a value is not what it must be; the text says which."""


@contextmanager
def _as_static_error() -> Iterator[None]:
    """Turn a factor's complaint about a field into one of this package's."""
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
        Measured ellipse charts, normalised image coordinates (see `RimSet`).
    covariance : ndarray, shape (n, 5, 5)
        Of the charts.
    whitening : ndarray, shape (n, 5, 5)
        Lower triangular W with W S W' = 1; made here.
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
        with _as_static_error():
            for name, shape in shapes.items():
                object.__setattr__(self, name, validation.array(name, getattr(self, name), shape))
            object.__setattr__(self, "axes", validation.rim_axes("axes", self.axes, n))
            object.__setattr__(self, "whitening", validation.whitening("covariance", self.covariance, n, 5))

    def __len__(self) -> int:
        return len(self.identifiers)

    @classmethod
    def of(cls, rims: RimSet, catalog: Catalog) -> "MatchedRims":
        """Take the measured rims of a frame with their craters from the catalogue."""
        rows = rims.craters
        return cls(
            tuple(catalog.identifiers[row] for row in rows),
            catalog.centres[rows],
            catalog.axes[rows],
            rims.chart,
            rims.covariance,
        )

    def take(self, rows: npt.NDArray[np.bool_] | IntArray | Sequence[int]) -> "MatchedRims":
        """Return the rims of some rows (a mask or indices)."""
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
        """Outward unit normals (n, 3) of the rims' planes in g."""
        n = np.cross(self.axes[:, 0], self.axes[:, 1])
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    def packed(self, bTc: FloatArray) -> FloatArray:
        """Return the rims as the kernels take them, for a mounting bTc (4, 4) of the camera."""
        return packed.pack(bTc, self.centres, self.axes, self.chart, self.whitening, NONE, 1.0)

    def residuals(self, gTb: FloatArray, bTc: FloatArray) -> FloatArray:
        """Whitened chart residuals (n, 5), predicted less measured, at a pose; large where unseen."""
        out = np.empty((7, 5 * len(self)))
        packed.shape_residuals(np.ascontiguousarray(gTb), self.packed(bTc), False, out)
        return np.ascontiguousarray(out[6].reshape(-1, 5))


@dataclass(frozen=True)
class PosePrior:
    """What is known of the pose beside the image.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Expected pose of the body.
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in body axes.
    """

    gTb: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        with _as_static_error():
            object.__setattr__(self, "gTb", validation.pose("prior.gTb", self.gTb))
            covariance = validation.array("prior.covariance", self.covariance, (6, 6))
            validation.whitening("prior.covariance", covariance[None], 1, 6)
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True)
class ResectionProblem:
    """One image's rims and what is known beside them.

    Attributes
    ----------
    rims : MatchedRims
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    prior : PosePrior or None
    attitude : KnownAttitude or None
        Not together with a prior.
    sun : SunTilt or None
    """

    rims: MatchedRims
    bTc: FloatArray = field(default_factory=lambda: np.eye(4))
    prior: PosePrior | None = None
    attitude: KnownAttitude | None = None
    sun: SunTilt | None = None

    def __post_init__(self) -> None:
        with _as_static_error():
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


class Status(Enum):
    """How a solution ended; `ResectionResult.reason` says the particulars."""

    SOLVED = "solved"
    AMBIGUOUS = "several poses explain the image"
    UNDETERMINED = "the image leaves a direction of the pose free"
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
        For the right twist [w, rho], rad and m in body axes. NaN when the pose is undetermined.
    residuals : ndarray, shape (n, 5)
        Whitened chart residuals of all rims, predicted less measured.
    cost : float
        Squared norm of all whitened residuals that the pose rests on, prior and sun included.
    probability : float
        Of this pose among those found.
    """

    gTb: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    cost: float
    probability: float = 1.0

    @property
    def position_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the position in g, m^2."""
        R = self.gTb[:3, :3]
        return np.asarray(R @ self.covariance[3:, 3:] @ R.T)


@dataclass(frozen=True)
class ResectionResult:
    """Answer of a static solver.

    Attributes
    ----------
    status : Status
    reason : str
        One line that says why, when the status is not `SOLVED`.
    poses : tuple of PoseSolution
        All distinct ones, the most probable first; of `UNDETERMINED`, samples of a continuum. Empty
        when there is none.
    wrong : tuple of str
        Identifiers of the rims that were found to be wrongly matched.
    warnings : tuple of str
        What to know before a pose is believed, one line each: that nothing checks the matches, that the
        covariance is no description of the errors.
    """

    status: Status
    reason: str
    poses: tuple[PoseSolution, ...]
    wrong: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def solved(self) -> bool:
        """Whether there is one pose; what it is worth, `warnings` say."""
        return self.status is Status.SOLVED

    @property
    def pose(self) -> PoseSolution:
        """The pose.

        Raises
        ------
        ResectionError
            When the problem is not solved.
        """
        if not self.solved:
            raise ResectionError(f"no pose: {self.reason}")
        return self.poses[0]
