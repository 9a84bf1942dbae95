"""Factor between two states that a motion model connects."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.custom import two_state_factor

# propagate(gTb, gV, bias): those at the end, bias left out, and the transition (15, 15) of the error state.
Propagate = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]

_SIZE = 15
# Columns of the error state (attitude, position, velocity, gyro bias, accelerometer bias) in the order of
# GTSAM's variables, whose bias has the accelerometer first.
_TO_GTSAM = np.array([*range(9), 12, 13, 14, 9, 10, 11])


def motion_factor(keys: Sequence[int], propagate: Propagate, whitening: npt.ArrayLike) -> gtsam.CustomFactor:
    """Build the factor of a motion model: zero when the second state is the first one propagated.

    Parameters
    ----------
    keys : sequence of int, length 6
        Pose, velocity and bias at the beginning, then those at the end.
    propagate : callable
        propagate(gTb, gV, bias) gives gTb (4, 4), gV (3,) and the transition F (15, 15) of the error state:
        attitude (in b), position and velocity (in g), gyro and accelerometer bias (in b). Biases are
        constant but for noise.
    whitening : array_like, shape (15, 15)
        W with W' W the inverse of the noise's covariance, in the units and order of that error state.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when something is not finite.

    Raises
    ------
    FactorError
        When the matrix is not finite or of another shape.
    """
    W = validation.array("whitening", whitening, (_SIZE, _SIZE))

    def evaluate(
        begin: tuple[FloatArray, FloatArray, FloatArray], end: tuple[FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        gTb, gV, F = propagate(*begin)
        r = np.empty(_SIZE)
        r[:3] = gtsam.Rot3.Logmap(gtsam.Rot3(gTb[:3, :3].T @ end[0][:3, :3]))
        r[3:6] = end[0][:3, 3] - gTb[:3, 3]
        r[6:9] = end[1] - gV
        r[9:] = end[2] - begin[2]
        # Of Log(exp(-phi) E): -Jl^-1(r) phi, and Jl^-1(r) = Jr^-1(-r).
        of_begin = -F
        of_begin[:3] = -gtsam.Rot3.LogmapDerivative(-r[:3]) @ F[:3]
        of_begin[:, 3:6] = of_begin[:, 3:6] @ begin[0][:3, :3]
        of_end = np.eye(_SIZE)
        of_end[:3, :3] = gtsam.Rot3.LogmapDerivative(r[:3])
        of_end[3:6, 3:6] = end[0][:3, :3]
        return W @ r, (W @ of_begin)[:, _TO_GTSAM], (W @ of_end)[:, _TO_GTSAM]

    return two_state_factor(keys, _SIZE, evaluate)
