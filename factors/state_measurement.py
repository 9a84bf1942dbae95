"""Factor of any measurement of the lander's state: pose, velocity, IMU bias, and the sensor's own bias."""

from collections.abc import Callable

import gtsam
import numpy as np

from factors.arrays import FloatArray
from factors.custom import Loss, state_factor

# Error state of the derivatives: that of `kernels.strapdown`.
ATTITUDE, POSITION, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
GYRO_BIAS, ACCELEROMETER_BIAS = slice(12, 15), slice(15, 18)

# measure(gTb, gV, rate, bias): e (m,), its derivatives in the error state (m, 18) and in the bias (m, b).
Measure = Callable[
    [FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]
]


def state_measurement_factor(
    keys: tuple[int, int, int],
    gyro: FloatArray,
    rows: int,
    measure: Measure,
    bias_key: int | None = None,
    loss: Loss = Loss(),
) -> gtsam.CustomFactor:
    """Build a factor of pose, velocity and IMU bias from a measurement function; zero when it is.

    Parameters
    ----------
    keys : tuple of int
        Keys of the pose `gTb`, the velocity in g and the IMU's bias (`gtsam.imuBias.ConstantBias`).
    gyro : ndarray, shape (3,)
        Measured angular velocity in b, rad/s; less the gyro's bias it is the state's.
    rows : int
        Length m of the residual, at least 1.
    measure : callable
        measure(gTb, gV, rate, bias) gives the whitened residual (m,), its derivative (m, 18) in the error
        state (attitude in b, position and velocity in g, angular velocity in b, gyro and accelerometer bias)
        and that (m, b) in the sensor's bias.
    bias_key : int, optional
        Key of the sensor's bias (a vector); without one it has none.
    loss : Loss
        On the norm of the residual.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when the residual or a derivative is not finite or of another shape.

    Raises
    ------
    FactorError
        When `rows` is not positive.
    """

    def evaluate(
        gTb: FloatArray, gV: FloatArray, imu_bias: FloatArray, bias: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        e, J, J_bias = measure(gTb, gV, gyro - imu_bias[3:], bias)
        # GTSAM turns the shift of a pose into the body's axes, and has the accelerometer's bias first.
        of_pose = np.hstack([J[:, ATTITUDE], J[:, POSITION] @ gTb[:3, :3]])
        of_bias = np.hstack([J[:, ACCELEROMETER_BIAS], J[:, GYRO_BIAS] - J[:, RATE]])
        return e, [of_pose, J[:, VELOCITY], of_bias, J_bias]

    return state_factor(keys, rows, evaluate, bias_key, loss)
