"""A-priori states of the lander, such as an ephemeris: for comparison, not as truth."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from craternav_fg.config import Positive, Section, read_text, validate
from craternav_fg.sensors.yaml_files import parse_yaml
from craternav_fg.trajectory import Trajectory


@dataclass(frozen=True)
class AprioriStates:
    """A-priori states at the frames.

    Attributes
    ----------
    states : Trajectory
        Trajectory of the body frame b.
    position_sigma_m, attitude_sigma_rad : float
        Their stated standard deviations per axis.
    """

    states: Trajectory
    position_sigma_m: float
    attitude_sigma_rad: float


class _Sigmas(Section):
    sensor_type: str = "apriori"
    position_sigma_m: Positive
    attitude_sigma_rad: Positive


def read_sigmas(path: Path) -> tuple[float, float]:
    """Read the standard deviations of a-priori states.

    Parameters
    ----------
    path : Path

    Returns
    -------
    position_sigma_m : float
    attitude_sigma_rad : float

    Raises
    ------
    InputError
        When the file is missing or wrong.
    """
    text = read_text(path)
    found = validate(path, parse_yaml(path, text), _Sigmas, text=text)
    return found.position_sigma_m, found.attitude_sigma_rad


def sigmas_yaml(states: AprioriStates) -> str:
    """Compose the text of sensor.yaml.

    Parameters
    ----------
    states : AprioriStates

    Returns
    -------
    str
    """
    return yaml.safe_dump(
        {
            "sensor_type": "apriori",
            "position_sigma_m": float(states.position_sigma_m),
            "attitude_sigma_rad": float(states.attitude_sigma_rad),
        },
        sort_keys=False,
    )
