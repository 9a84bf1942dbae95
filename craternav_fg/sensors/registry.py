"""The sensors by name: those of this package and those that other packages register.

A package registers a sensor by an entry point in its `pyproject.toml`::

    [project.entry-points."craternav_fg.sensors"]
    my_sensor = "my_package:MySensor"
"""

from craternav_fg.sensors.altimeter import Altimeter
from craternav_fg.sensors.plugins import plugins
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
    for plugin in plugins(GROUP):
        kind = plugin.value
        if not (isinstance(kind, type) and issubclass(kind, Sensor)):
            raise plugin.refused("expected a class derived from Sensor")
        if found.setdefault(kind.name, kind) is not kind:
            raise plugin.refused(f"there is a sensor {kind.name!r} already")
    return found
