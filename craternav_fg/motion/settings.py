"""The table `[motion]` of dataset.toml and of scenarios."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from craternav_fg.body import Body
from craternav_fg.config import Positive, Section, Vector, or_former
from craternav_fg.motion.coast import ACCELERATION_DENSITY, coast
from craternav_fg.motion.gravity import MAX_DEGREE, GravityField, degree_two, read_gravity
from craternav_fg.motion.model import Motion
from craternav_fg.motion.white_acceleration import white_acceleration
from craternav_fg.motion.white_jerk import ACCELERATION_SIGMA_M_S2, white_jerk

# Former names of keys, by the present ones: files with them are read.
FORMER = {
    "acceleration_density_m_s2_sqrt_hz": "acceleration_density",
    "jerk_density_m_s3_sqrt_hz": "jerk_density",
    "rate_walk_rad_s2_sqrt_hz": "rate_walk",
}


def _or_former(key: str) -> Any:
    """Describe a field that may stand under its former name."""
    return or_former(key, FORMER[key])


class _Rates(Section):
    rate_rad_s: Vector = Motion.rate_rad_s
    """Prior mean of the inertial angular velocity in b; not used with a gyro."""
    rate_sigma_rad_s: Positive = Motion.rate_sigma_rad_s
    """Its standard deviation per axis."""
    rate_walk_rad_s2_sqrt_hz: Annotated[Positive, _or_former("rate_walk_rad_s2_sqrt_hz")] = (
        Motion.rate_walk_rad_s2_sqrt_hz
    )
    """White noise of the angular acceleration, rad/s^2/sqrt(Hz)."""

    def _rates(self) -> dict[str, Any]:
        return self.model_dump(include={"rate_rad_s", "rate_sigma_rad_s", "rate_walk_rad_s2_sqrt_hz"})


class CoastSection(_Rates):
    """Free fall."""

    model: Literal["coast"]
    acceleration_density_m_s2_sqrt_hz: Annotated[
        Positive, _or_former("acceleration_density_m_s2_sqrt_hz")
    ] = ACCELERATION_DENSITY
    """White noise of the acceleration, m/s^2/sqrt(Hz)."""
    j2: float = 0.0
    c22: float = 0.0
    """Unnormalised; the reference radius is the body's."""
    gravity_field: Annotated[str, Field(min_length=1)] | None = None
    """Spherical-harmonics coefficients (SHADR), relative to the file with this table, in place of the two."""
    degree: Annotated[int, Field(ge=0, le=MAX_DEGREE)] = MAX_DEGREE
    """Largest degree of the coefficients that is used."""

    def motion(self, body: Body, folder: Path) -> Motion:
        """Make the model; a gravity field is read from the folder."""
        return coast(
            self.acceleration_density_m_s2_sqrt_hz, gravity=self._gravity(body, folder), **self._rates()
        )

    def _gravity(self, body: Body, folder: Path) -> GravityField:
        if self.gravity_field is None:
            return degree_two(body.radius_m, self.j2, self.c22)
        return read_gravity(folder / self.gravity_field, self.degree)


class WhiteAccelerationSection(_Rates):
    """Constant twist with white acceleration."""

    model: Literal["white_acceleration"]
    acceleration_density_m_s2_sqrt_hz: Annotated[Positive, _or_former("acceleration_density_m_s2_sqrt_hz")]
    """White noise of the acceleration, m/s^2/sqrt(Hz)."""

    def motion(self, body: Body, folder: Path) -> Motion:
        """Make the model."""
        del body, folder
        return white_acceleration(self.acceleration_density_m_s2_sqrt_hz, **self._rates())


class WhiteJerkSection(_Rates):
    """Constant acceleration in the body's frame with white jerk; the angular acceleration is white."""

    model: Literal["white_jerk"]
    jerk_density_m_s3_sqrt_hz: Annotated[Positive, _or_former("jerk_density_m_s3_sqrt_hz")]
    """White noise of the jerk, m/s^3/sqrt(Hz)."""
    acceleration_sigma_m_s2: Positive = ACCELERATION_SIGMA_M_S2
    """Prior standard deviation of the acceleration."""

    def motion(self, body: Body, folder: Path) -> Motion:
        """Make the model."""
        del body, folder
        return white_jerk(
            self.jerk_density_m_s3_sqrt_hz,
            acceleration_sigma_m_s2=self.acceleration_sigma_m_s2,
            **self._rates(),
        )


MotionSection = Annotated[
    CoastSection | WhiteAccelerationSection | WhiteJerkSection, Field(discriminator="model")
]


def motion_table(motion: Motion, gravity_field: str) -> dict[str, Any]:
    """Return the table that describes a motion model.

    Parameters
    ----------
    motion : Motion
    gravity_field : str
        Name of the file with its gravity field, where that is more than a point mass.

    Returns
    -------
    dict
    """
    table: dict[str, Any] = {"model": motion.name}
    if motion.name == "white_jerk":
        table["jerk_density_m_s3_sqrt_hz"] = float(motion.jerk_density_m_s3_sqrt_hz)
        table["acceleration_sigma_m_s2"] = float(motion.acceleration_sigma_m_s2)
    else:
        table["acceleration_density_m_s2_sqrt_hz"] = float(motion.acceleration_density_m_s2_sqrt_hz)
    if len(motion.gravity.C) > 1:
        table["gravity_field"] = gravity_field
    table["rate_rad_s"] = [float(rate) for rate in motion.rate_rad_s]
    table["rate_sigma_rad_s"] = float(motion.rate_sigma_rad_s)
    table["rate_walk_rad_s2_sqrt_hz"] = float(motion.rate_walk_rad_s2_sqrt_hz)
    return table
