"""Tables `[sensors.NAME]` of a scenario, checked against the sensors' own settings."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import Field, ValidationError

from craternav_fg.config import Positive, Section
from craternav_fg.sensors.point_features import NAME as FEATURES
from craternav_fg.sensors.point_features import FeatureSettings, FeatureSimulation
from craternav_fg.sensors.protocol import Sensor, SensorSettings
from craternav_fg.sensors.registry import sensors

S = TypeVar("S", bound=Section)
P = TypeVar("P", bound=Section)


class SensorSimulation(Section):
    """When a sensor works, and how often it fails: the table `simulation` in a sensor's."""

    below_m: Positive | None = None
    """Altitude above which it is off."""
    above_m: Annotated[float, Field(ge=0.0)] = 0.0
    """Altitude below which it is off."""
    outlier_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of its samples that are outliers."""


def sensor_plan(name: str, table: Mapping[str, Any]) -> tuple[type[Sensor], SensorSettings, SensorSimulation]:
    """Check a table `[sensors.NAME]` of a scenario: the keys of `sensor.yaml`, and a table `simulation`.

    Parameters
    ----------
    name : str
        Name of the sensor.
    table : mapping
        As read.

    Returns
    -------
    kind : type
    settings : SensorSettings
    simulation : SensorSimulation

    Raises
    ------
    ValueError
        When there is no such sensor, or a key is wrong.
    """
    kinds = sensors()
    if name not in kinds:
        raise ValueError(f"sensors.{name}: expected one of {', '.join([*kinds, FEATURES])}")
    kind = kinds[name]
    return kind, *_checked(name, table, kind.Settings, SensorSimulation)


def feature_plan(table: Mapping[str, Any]) -> tuple[FeatureSettings, FeatureSimulation]:
    """Check the table `[sensors.features]` of a scenario.

    Parameters
    ----------
    table : mapping
        As read.

    Returns
    -------
    settings : FeatureSettings
    simulation : FeatureSimulation

    Raises
    ------
    ValueError
        When a key is wrong.
    """
    return _checked(FEATURES, table, FeatureSettings, FeatureSimulation)


def check_sensor(name: str, table: Mapping[str, Any]) -> None:
    """Refuse a table of a scenario that is wrong.

    Raises
    ------
    ValueError
        As `sensor_plan` and `feature_plan` do.
    """
    if name == FEATURES:
        feature_plan(table)
    else:
        sensor_plan(name, table)


def _checked(name: str, table: Mapping[str, Any], settings: type[S], simulation: type[P]) -> tuple[S, P]:
    """Validate a sensor's table as settings and, in its own table, simulation."""
    plain = {key: value for key, value in table.items() if key != "simulation"}
    return _valid(settings, plain, ["sensors", name]), _valid(
        simulation, table.get("simulation", {}), ["sensors", name, "simulation"]
    )


def _valid(model: type[S], values: object, where: list[str]) -> S:
    try:
        return model.model_validate_json(json.dumps(values, default=str))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join([*where, *(str(part) for part in first["loc"])])
        raise ValueError(f"{key}: {str(first['msg']).replace('Input should be', 'expected')}") from None
