"""Tables `[sensors.NAME]` of a scenario, checked against the sensors' own settings."""

import json
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError

from craternav_fg.config import Positive, Section
from craternav_fg.sensors.protocol import Sensor, SensorSettings
from craternav_fg.sensors.registry import sensors


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
        Of the sensor.
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
        raise ValueError(f"sensors.{name}: expected one of {', '.join(kinds)}")
    kind = kinds[name]
    plain = {key: value for key, value in table.items() if key != "simulation"}
    parts: list[tuple[type[Section], object]] = [
        (kind.Settings, plain),
        (SensorSimulation, table.get("simulation", {})),
    ]
    found: list[Any] = []
    for model, values in parts:
        try:
            found.append(model.model_validate_json(json.dumps(values, default=str)))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(["sensors", name, *(str(key) for key in first["loc"])])
            raise ValueError(f"{where}: {str(first['msg']).replace('Input should be', 'expected')}") from None
    return kind, found[0], found[1]
