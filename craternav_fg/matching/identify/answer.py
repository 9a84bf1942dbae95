"""What identification with no prior is told, and what it answers."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Status(Enum):
    """How an identification ended; `Identification.reason` says the particulars."""

    IDENTIFIED = "identified"
    AMBIGUOUS = "several poses explain the rims"
    NO_ANSWER = "no pose explains the rims better than chance"
    TOO_FEW_RIMS = "too few rims"


@dataclass(frozen=True)
class KnownAttitude:
    """Attitude of the body, from a star tracker.

    Attributes
    ----------
    gRb : ndarray, shape (3, 3)
        Rotation from b to g.
    sigma_rad : float
        Standard deviation about each axis.
    """

    gRb: FloatArray
    sigma_rad: float = float(np.radians(1.5))


@dataclass(frozen=True)
class IdentifyOptions:
    """How long is searched, and what is believed.

    Attributes
    ----------
    altitudes_m : tuple of float
        Least and largest altitude above the reference sphere.
    noise_levels_px : tuple of float
        Noise of the rims' centres to search with, one after the other.
    candidates : tuple of int
        Triples of craters to judge for each triple of rims, per level.
    triples : int
        Triples of rims to look up at most, per level and guess of the vertical; fewer around the best guess.
    tried : int
        With the attitude known, craters to try for single rims at most: it bounds the time that a large
        catalogue takes.
    log_chance : float
        Logarithm of the probability of chance that an answer may have.
    log_chance_attitude : float
        The same with the attitude known.
    log_ambiguity : float
        A second pose this much less probable is none.
    """

    altitudes_m: tuple[float, float] = (1e3, 2e6)
    noise_levels_px: tuple[float, ...] = (1.0, 3.0, 6.0)
    candidates: tuple[int, ...] = (16, 48, 160)
    triples: int = 96
    tried: int = 3_000_000
    log_chance: float = float(np.log(1e-6))
    log_chance_attitude: float = float(np.log(1e-4))
    log_ambiguity: float = float(np.log(1e-3))


@dataclass(frozen=True)
class Identification:
    """Answer.

    Attributes
    ----------
    status : Status
    reason : str
        One line that says why, when the status is not `IDENTIFIED`.
    craters : tuple of str or None
        Identifier of each rim's crater; None where it has none.
    rows : ndarray of int, shape (n,)
        The same as rows of the catalogue, -1 where it has none.
    gTc, gTb : ndarray, shape (4, 4)
        Pose of the camera and of the body; NaN without an answer.
    covariance : ndarray, shape (6, 6)
        Of the body's pose, for its right twist [w, rho], rad and m in body axes.
    log_chance : float
        Logarithm of a bound of the probability that rims by chance look as much like the catalogue, over all
        places that were searched. Also without an answer: of the best that was found.
    sigma_px : float
        Noise of the centres, estimated from the rims that agree.
    seconds : float
        Time taken.
    """

    status: Status
    reason: str
    craters: tuple[str | None, ...]
    rows: IntArray
    gTc: FloatArray
    gTb: FloatArray
    covariance: FloatArray
    log_chance: float
    sigma_px: float
    seconds: float

    @property
    def identified(self) -> bool:
        """Whether there is an answer."""
        return self.status is Status.IDENTIFIED
