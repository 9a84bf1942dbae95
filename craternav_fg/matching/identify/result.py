"""Result of identification."""

import math
import time
from dataclasses import dataclass
from enum import Enum

import numpy as np

from factors.arrays import FloatArray, IntArray


class Status(Enum):
    """Outcome of an identification; `Identification.reason` gives the details."""

    IDENTIFIED = "identified"
    AMBIGUOUS = "several poses explain the rims"
    NO_ANSWER = "no pose explains the rims better than chance"
    TOO_FEW_RIMS = "too few rims"


@dataclass(frozen=True)
class Identification:
    """Craters of an image's rims, and the pose.

    Attributes
    ----------
    status : Status
    reason : str
        Why there is no answer, in one line; empty when the status is `IDENTIFIED`.
    craters : tuple of str or None, length n
        Identifier of each rim's crater; None for a rim without one.
    rows : ndarray of int, shape (n,)
        Row of each rim's crater in the catalogue; -1 for a rim without one.
    gTc, gTb : ndarray, shape (4, 4)
        Pose of the camera and of the body in g; NaN without an answer.
    covariance : ndarray, shape (6, 6)
        Covariance of the body's pose, for its right twist [w, rho] in b, rad and m, with the common shift
        that the catalogue states and the error that the camera states of its lever arm; NaN without an
        answer. The noise of the rims is that of their residuals, which holds the errors of single craters.
    log_chance : float
        Natural logarithm of an upper bound on the probability that chance explains the rims as well, over
        all poses that were searched. Without an answer, that of the best pose found.
    sigma_px : float
        Standard deviation of the centres, estimated from the matched rims; NaN without an answer.
    seconds : float
        Elapsed time.
    focal_scale, focal_scale_sigma : float
        Focal length that the rims alone show, over the camera's, and its standard deviation; NaN without an
        answer or when the focal length is exact.
    warnings : tuple of str
        One line each: that the rims contradict the camera's intrinsics, or cannot check its focal length.
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
    focal_scale: float = math.nan
    focal_scale_sigma: float = math.nan
    warnings: tuple[str, ...] = ()

    @property
    def identified(self) -> bool:
        """Whether there is an answer."""
        return self.status is Status.IDENTIFIED


def no_answer(n: int, status: Status, reason: str, log_chance: float, began: float) -> Identification:
    """Make a result without matches and pose.

    Parameters
    ----------
    n : int
        Number of rims.
    status : Status
    reason : str
    log_chance : float
        See `Identification`.
    began : float
        Time at which identification began, by `time.perf_counter`.
    """
    empty = np.full((4, 4), np.nan)
    return Identification(
        status, reason, (None,) * n, np.full(n, -1), empty, empty, np.full((6, 6), np.nan), log_chance,
        np.nan, time.perf_counter() - began,
    )  # fmt: skip
