"""Modules of a package, and names that they define, as its attributes, imported when they are first used."""

import importlib
import sys
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any


def submodules(package: str) -> Callable[[str], ModuleType]:
    """Make the `__getattr__` of a package that imports its modules on demand (PEP 562).

    Parameters
    ----------
    package : str
        Its name.

    Returns
    -------
    callable
    """

    def module(name: str) -> ModuleType:
        full = f"{package}.{name}"
        try:
            return importlib.import_module(full)
        except ModuleNotFoundError as error:
            if error.name != full:
                raise
            raise AttributeError(f"module {package!r} has no attribute {name!r}") from None

    return module


def names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the `__getattr__` of a package that offers names of its modules, and the modules, on demand.

    Parameters
    ----------
    package : str
        Its name.
    homes : mapping of str to str
        Module of each name, in the package.

    Returns
    -------
    callable
    """
    module = submodules(package)

    def attribute(name: str) -> Any:
        if name not in homes:
            return module(name)
        value = getattr(module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute
