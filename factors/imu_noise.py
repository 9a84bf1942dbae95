"""Noise of an IMU. Apart from the factor, since importing GTSAM takes long."""

from dataclasses import dataclass, fields

import numpy as np

from factors import validation
from factors.arrays import FloatArray
from factors.errors import FactorError

# The square of a density of less underflows.
LEAST_DENSITY = 1e-150


@dataclass(frozen=True)
class ImuNoise:
    """Noise of one gyro and one accelerometer axis: continuous-time densities, as in EuRoC's sensor.yaml.

    Attributes
    ----------
    gyro_density_rad_s_sqrt_hz : float
        Angular random walk, rad/s/sqrt(Hz).
    accelerometer_density_m_s2_sqrt_hz : float
        Velocity random walk, m/s^2/sqrt(Hz).
    gyro_walk_rad_s2_sqrt_hz : float
        Bias random walk, rad/s^2/sqrt(Hz).
    accelerometer_walk_m_s3_sqrt_hz : float
        Bias random walk, m/s^3/sqrt(Hz).

    Raises
    ------
    FactorError
        When one is not positive: a bias without any walk makes the factor's information infinite.
    """

    gyro_density_rad_s_sqrt_hz: float
    accelerometer_density_m_s2_sqrt_hz: float
    gyro_walk_rad_s2_sqrt_hz: float
    accelerometer_walk_m_s3_sqrt_hz: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = validation.array(field.name, getattr(self, field.name), ())
            if not value > LEAST_DENSITY:
                raise FactorError(f"{field.name}: expected a positive number, found {value}")

    @property
    def densities(self) -> FloatArray:
        """All four (4,), in the order and units of the fields: what `kernels.strapdown` takes."""
        return np.array(
            [
                self.gyro_density_rad_s_sqrt_hz,
                self.accelerometer_density_m_s2_sqrt_hz,
                self.gyro_walk_rad_s2_sqrt_hz,
                self.accelerometer_walk_m_s3_sqrt_hz,
            ]
        )
