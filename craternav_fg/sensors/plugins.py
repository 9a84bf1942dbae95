"""What other packages register by entry points: sensors, estimators."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from craternav_fg.errors import CraternavError


@dataclass(frozen=True)
class Plugin:
    """Something that a package registers.

    Attributes
    ----------
    name : str
        Name of the entry point.
    package : str
        Whose it is.
    value : object
        What it names.
    """

    name: str
    package: str
    value: Any

    def refused(self, problem: str) -> CraternavError:
        """Return the error that describes what is wrong with it."""
        return CraternavError(f"{self.name} of the package {self.package}: {problem}")


def plugins(group: str) -> Iterator[Plugin]:
    """Load what packages registered in a group.

    Parameters
    ----------
    group : str
        Group of entry points, such as "craternav_fg.sensors".

    Yields
    ------
    Plugin

    Raises
    ------
    CraternavError
        When one cannot be loaded: names it and its package.
    """
    for entry in _registered(group):
        package = entry.dist.name if entry.dist is not None else entry.value
        try:
            value = entry.load()
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise CraternavError(f"{entry.name} of the package {package}: cannot be loaded: {said}") from None
        yield Plugin(entry.name, package, value)


# Files of all installed packages are read for it, and it is asked for each data set and estimator.
@functools.cache
def _registered(group: str) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))
