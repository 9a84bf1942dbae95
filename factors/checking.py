"""Central differences for any factor: the one harness that all derivative tests use."""

import gtsam
import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray


def numerical_jacobian(
    factor: gtsam.NoiseModelFactor, values: gtsam.Values, key: int, steps: npt.ArrayLike
) -> FloatArray:
    """Jacobian of a factor's whitened residual by central differences, extrapolated once (Richardson).

    Parameters
    ----------
    factor : gtsam.NoiseModelFactor
        Without a robust loss (its error and its linearisation are scaled differently).
    values : gtsam.Values
        Linearisation point.
    key : int
        The variable to differentiate in.
    steps : array_like, shape (d,)
        Step of each tangent coordinate, in its own unit.

    Returns
    -------
    ndarray, shape (rows, d)
        Comparable with the block of `key` in `factor.linearize(values).jacobian()[0]`.
    """
    sizes = np.asarray(steps, dtype=np.float64)

    def central(i: int, h: float) -> FloatArray:
        ends = []
        for sign in (1.0, -1.0):
            tangent = gtsam.VectorValues()
            tangent.insert(key, sign * h * np.eye(len(sizes))[i])
            ends.append(factor.whitenedError(values.retract(tangent)))
        return (ends[0] - ends[1]) / (2.0 * h)

    columns = [(4.0 * central(i, 0.5 * h) - central(i, h)) / 3.0 for i, h in enumerate(sizes)]
    return np.stack(columns, axis=-1)
