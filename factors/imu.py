"""IMU preintegration in the frame g that rotates with the body, with central gravity.

GTSAM's preintegration takes a constant gravity vector and, through `setOmegaCoriolis`, the exact kinematics
of a rotating frame (Coriolis and centrifugal). Central gravity enters as that constant, taken at the
predicted midpoint of an interval of at most a second: second order in the interval's length
(docs/equations.md, "Gravity over a preintegrated interval").
"""

from collections.abc import Sequence
from functools import lru_cache

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.errors import FactorError
from factors.imu_noise import ImuNoise
from factors.kernels import strapdown

# Error of the integration scheme itself, m^2/s: far below a sensor's, but not zero, so that the position
# block of the preintegrated covariance is regular.
INTEGRATION_VARIANCE = 1e-10
_AXES = np.eye(3)


def parameters(
    noise: ImuNoise,
    spin: npt.ArrayLike,
    gravity: npt.ArrayLike,
    integration_variance: float = INTEGRATION_VARIANCE,
) -> gtsam.PreintegrationCombinedParams:
    """Make the parameters of one interval.

    They stay those of the factor that is made with them: what is later written to their `n_gravity` changes
    the factor's gravity, on which the preintegrated measurement does not depend.

    Parameters
    ----------
    noise : ImuNoise
    spin : array_like, shape (3,)
        Angular velocity of g, rad/s, in g.
    gravity : array_like, shape (3,)
        Newtonian gravity in g at the predicted midpoint, m/s^2, without the centrifugal term.
    integration_variance : float
        Of the position that the integration adds, m^2/s.

    Returns
    -------
    gtsam.PreintegrationCombinedParams

    Raises
    ------
    FactorError
        When a field is not finite or mis-shaped.
    """
    params = gtsam.PreintegrationCombinedParams(validation.array("gravity", gravity, (3,)))
    gyro, accelerometer, gyro_walk, accelerometer_walk = _covariances(*noise.densities.tolist())
    params.setGyroscopeCovariance(gyro)
    params.setAccelerometerCovariance(accelerometer)
    params.setBiasOmegaCovariance(gyro_walk)
    params.setBiasAccCovariance(accelerometer_walk)
    params.setIntegrationCovariance(integration_variance * _AXES)
    params.setOmegaCoriolis(validation.array("spin", spin, (3,)))
    return params


@lru_cache
def _covariances(*densities: float) -> FloatArray:
    """Covariances (4, 3, 3) of the noise of gyro, accelerometer and their biases' walks."""
    out: FloatArray = np.multiply.outer(np.square(densities), _AXES)
    out.flags.writeable = False
    return out


def integrate(
    params: gtsam.PreintegrationCombinedParams,
    dt_s: npt.ArrayLike,
    gyro: npt.ArrayLike,
    accelerometer: npt.ArrayLike,
    bias: npt.ArrayLike,
) -> gtsam.PreintegratedCombinedMeasurements:
    """Preintegrate the rows of one interval, eqs. (26), (27).

    Parameters
    ----------
    params : gtsam.PreintegrationCombinedParams
        From `parameters`, and of no other interval: shared ones would change earlier factors.
    dt_s : array_like, shape (m,)
        Positive durations of the rows.
    gyro, accelerometer : array_like, shape (m, 3)
        Mean angular velocity (rad/s) and mean specific force (m/s^2) of each row, in b.
    bias : array_like, shape (6,)
        Gyro (rad/s), then accelerometer (m/s^2), in b: where the preintegration is linearised.

    Returns
    -------
    gtsam.PreintegratedCombinedMeasurements

    Raises
    ------
    FactorError
        When a field is not finite or mis-shaped, or the interval is empty.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (26), (27);
    docs/equations.md.
    """
    m = np.shape(dt_s)[0] if np.ndim(dt_s) else 0
    dt = validation.array("dt_s", dt_s, (m,))
    if m == 0 or not (dt > 0.0).all():
        raise FactorError("dt_s: expected at least one row, all of positive duration")
    w = validation.array("gyro", gyro, (m, 3))
    f = validation.array("accelerometer", accelerometer, (m, 3))
    b = validation.array("bias", bias, (6,))
    pim = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias(b[3:], b[:3]))
    # A row's force is the mean along turning axes; GTSAM takes it along the axes at the row's beginning.
    forces = strapdown.forces_along_first_axes(dt, w, f, b)
    step = pim.integrateMeasurement
    for force, rate, dt_k in zip(forces, w, dt.tolist(), strict=True):
        step(force, rate, dt_k)
    return pim


def imu_factor(keys: Sequence[int], pim: gtsam.PreintegratedCombinedMeasurements) -> gtsam.CombinedImuFactor:
    """IMU factor between two states: zero when the second is the first moved by the preintegration.

    Parameters
    ----------
    keys : sequence of int, length 6
        Pose and velocity at the beginning, pose and velocity at the end, bias at the beginning and end.
    pim : gtsam.PreintegratedCombinedMeasurements
        From `integrate`.

    Returns
    -------
    gtsam.CombinedImuFactor

    Raises
    ------
    FactorError
        When the keys are not six different ones.
    """
    if len(keys) != 6 or len(set(keys)) != 6:
        raise FactorError(f"keys: expected six different keys, found {len(set(keys))} among {len(keys)}")
    xi, vi, xj, vj, bi, bj = keys
    return gtsam.CombinedImuFactor(xi, vi, xj, vj, bi, bj, pim)
