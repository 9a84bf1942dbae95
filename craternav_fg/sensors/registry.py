"""The sensors by name: those of this package and those that other packages register.

A package registers a sensor by an entry point in its `pyproject.toml`::

    [project.entry-points."craternav_fg.sensors"]
    my_sensor = "my_package:MySensor"
"""

import importlib.metadata

from craternav_fg.errors import CraternavError
from craternav_fg.sensors.altimeter import Altimeter
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.sensors.ranging import Ranging
from craternav_fg.sensors.star_tracker import StarTracker
from craternav_fg.sensors.velocimeter import Velocimeter

GROUP = "craternav_fg.sensors"
SHIPPED: tuple[type[Sensor], ...] = (Altimeter, StarTracker, Velocimeter, Ranging)


def sensors() -> dict[str, type[Sensor]]:
    """Classes of all sensors by their names, the shipped ones first.

    Raises
    ------
    CraternavError
        When an entry point cannot be loaded, is no sensor, or takes a name that is taken.
    """
    found: dict[str, type[Sensor]] = {kind.name: kind for kind in SHIPPED}
    for entry in importlib.metadata.entry_points(group=GROUP):
        try:
            kind = entry.load()
        except Exception as error:
            raise CraternavError(
                f"sensor {entry.name} of {_package(entry)}: cannot be loaded: {error}"
            ) from None
        if not (isinstance(kind, type) and issubclass(kind, Sensor)):
            raise CraternavError(f"sensor {entry.name} of {_package(entry)}: expected a class of Sensor")
        if found.setdefault(kind.name, kind) is not kind:
            raise CraternavError(f"sensor {entry.name} of {_package(entry)}: the name {kind.name!r} is taken")
    return found


def _package(entry: importlib.metadata.EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.value
