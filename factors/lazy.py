"""Modules of a package as its attributes, imported when they are first used."""

import importlib
from collections.abc import Callable
from types import ModuleType


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
