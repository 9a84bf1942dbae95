"""Labels of ISIS cubes and their binary tables."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, read_bytes
from factors.arrays import FloatArray

# Bytes in which a label must end; ISIS reserves 64 kB, history and tables come behind the pixels.
_MAX_LABEL_BYTES = 16_000_000
_END = re.compile(rb"(?:^|\n)End\s*(?:\r?\n|\0|$)")
_ORDERS = {"Lsb": "<", "Msb": ">"}


@dataclass(frozen=True)
class CubeLabel:
    """The label of a cube.

    Attributes
    ----------
    path : Path
    data : bytes
        The whole file.
    label : dict
        Groups, objects and keywords as `pvl` reads them.
    """

    path: Path
    data: bytes
    label: Any

    def group(self, *names: str) -> Any:
        """Return a group or object inside others.

        Parameters
        ----------
        *names : str
            From the outermost.

        Returns
        -------
        dict

        Raises
        ------
        InputError
            When it is missing.
        """
        found = self.label
        for name in names:
            if not hasattr(found, "keys") or name not in found:
                raise InputError(self.path, f"expected {'/'.join(names)} in the label, found none")
            found = found[name]
        if not hasattr(found, "keys"):
            raise InputError(self.path, f"expected a group {'/'.join(names)} in the label, found {found}")
        return found

    def number(self, group: Any, name: str) -> float:
        """Read a keyword that is a number.

        Parameters
        ----------
        group : dict
            Where it stands.
        name : str

        Returns
        -------
        float

        Raises
        ------
        InputError
            When it is missing or no finite number.
        """
        value = group.get(name)
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            found = "none" if value is None else f"{value!r}"
            raise InputError(self.path, f"expected a number in the label, found {found}", column=name)
        return number

    def table(self, name: str, least: int) -> tuple[Any, FloatArray]:
        """Read a table of numbers.

        Parameters
        ----------
        name : str
        least : int
            Fewest columns it must have.

        Returns
        -------
        keywords : dict
            Keywords of the table.
        rows : ndarray, shape (n, m)
            In the units of the table.

        Raises
        ------
        InputError
            When the table is missing, cut, or not of numbers.
        """
        tables = self.label.getall("Table") if "Table" in self.label else []
        found = next((one for one in tables if one.get("Name") == name), None)
        if found is None:
            has = ", ".join(str(one.get("Name")) for one in tables) or "no table"
            problem = f"expected a table {name} of SPICE data (ISIS: spiceinit), found {has}"
            raise InputError(self.path, problem)
        fields = found.getall("Field") if "Field" in found else []
        if any(field.get("Type") != "Double" for field in fields):
            raise InputError(self.path, "expected fields of type Double", column=name)
        columns = sum(int(self.number(field, "Size")) for field in fields)
        begin, count = int(self.number(found, "StartByte")) - 1, int(self.number(found, "Bytes"))
        if columns < least or count != 8 * columns * int(self.number(found, "Records")):
            problem = f"expected {least} or more columns of 8 bytes, found {columns} in {count} bytes"
            raise InputError(self.path, problem, column=name)
        if begin + count > len(self.data):
            problem = f"is truncated: expected {begin + count} bytes, found {len(self.data)}"
            raise InputError(self.path, problem, column=name)
        kind = _ORDERS.get(str(found.get("ByteOrder", "Lsb")), "<") + "f8"
        values = np.frombuffer(self.data, kind, count // 8, begin).astype(np.float64)
        if not len(values) or not np.isfinite(values).all():
            raise InputError(self.path, "expected finite numbers", column=name)
        return found, values.reshape(-1, columns)


def read_label(path: Path) -> CubeLabel:
    """Read the label of an ISIS cube.

    Parameters
    ----------
    path : Path
        With the label attached.

    Returns
    -------
    CubeLabel

    Raises
    ------
    CraternavError
        When pvl is not installed.
    InputError
        When the file is missing, or no cube with a label of its own.
    """
    try:
        import pvl
    except ImportError:
        raise CraternavError("ISIS cubes need pvl, rasterio: pip install 'craternav_fg[isis]'") from None
    data = read_bytes(path, SizeLimit.RASTER)
    head = data[:_MAX_LABEL_BYTES]
    end = _END.search(head)
    if b"IsisCube" not in head[:200_000] or end is None:
        raise InputError(path, "expected an ISIS cube with an attached label")
    try:
        label = pvl.loads(head[: end.end()].decode("latin-1"), parser=_parser())
    except Exception as error:  # pvl raises errors of many classes, ValueError and its own among them
        raise InputError(path, f"expected an ISIS label: {' '.join(str(error).split())}") from None
    if "IsisCube" not in label or "Core" not in label["IsisCube"]:
        raise InputError(path, "expected an ISIS cube with an attached label")
    core = label["IsisCube"]["Core"]
    if "^Core" in core:
        problem = f"expected the pixels in this file, found a detached label of {core['^Core']}"
        raise InputError(path, problem)
    return CubeLabel(path, data, label)


def _parser() -> Any:
    """Make a parser of `pvl` that gives up where it does not move on: `a = b = c` would keep it for ever."""
    from pvl.parser import OmniParser

    class Parser(OmniParser):  # type: ignore[misc]
        """Notices a token at which it has stopped before."""

        stopped_at = -1

        def parse_module_post_hook(self, module: Any, tokens: Any) -> Any:
            token = next(tokens, None)
            if token is not None:
                tokens.send(token)
                if token.pos <= self.stopped_at:
                    raise ValueError(f"expected a keyword, found {token}")
                self.stopped_at = token.pos
            return super().parse_module_post_hook(module, tokens)

    return Parser()
