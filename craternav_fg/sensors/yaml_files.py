"""The files sensor.yaml of EuRoC: parsing, poses of sensors, and writing."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from craternav_fg.config import line_of
from craternav_fg.errors import InputError
from factors.arrays import FloatArray

# Largest deviation of R R' from the identity, from numbers of seven digits.
_RIGID_TOLERANCE = 1e-6
# Length of a file, its values with aliases written out, and depth of its tables: a few lines with aliases
# could otherwise stand for billions.
_MAX_CHARACTERS = 100_000
_MAX_VALUES = 10_000
_MAX_DEPTH = 20


def parse_yaml(path: Path, text: str) -> dict[str, Any]:
    """Parse a YAML file of keys and values.

    Parameters
    ----------
    path : Path
        For messages.
    text : str

    Returns
    -------
    dict

    Raises
    ------
    InputError
        When the text is not YAML, not a table, or too large.
    """
    # Some files begin with OpenCV's directive, which is not YAML.
    if text.startswith("%YAML:"):
        text = "#" + text
    if len(text) > _MAX_CHARACTERS:
        raise InputError(path, f"expected at most {_MAX_CHARACTERS} characters, found {len(text)}")
    problem = "expected YAML"
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            raise InputError(path, "expected keys and values, found nothing")
        if _expanded(node, {}, 1) > _MAX_VALUES:
            raise InputError(path, f"expected at most {_MAX_VALUES} values, with aliases written out")
        data = loader.construct_document(node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        what = getattr(error, "problem", None) or error
        raise InputError(path, f"{problem}: {what}", line=mark and mark.line + 1) from None
    except RecursionError:
        raise InputError(path, f"{problem}, found brackets nested too deeply") from None
    except (ValueError, LookupError, AttributeError, ArithmeticError, TypeError) as error:
        # What PyYAML raises for `!!bool maybe`, 2024-13-45, and integers of thousands of digits.
        raise InputError(path, f"{problem}, found a value that is none of its type: {error}") from None
    if not isinstance(data, dict):
        raise InputError(path, "expected keys and values")
    return {str(key): _numbers(value) for key, value in data.items()}


def _expanded(node: yaml.Node, sizes: dict[int, int], depth: int) -> int:
    """Count the values of a document, those behind an alias once for each alias."""
    if depth > _MAX_DEPTH:
        raise RecursionError
    if id(node) in sizes:
        return sizes[id(node)]
    # Until it is counted, a value counts as too large: it may contain itself.
    sizes[id(node)] = _MAX_VALUES + 1
    parts: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        parts = [part for pair in node.value for part in pair]
    elif isinstance(node, yaml.SequenceNode):
        parts = node.value
    total = 1
    for part in parts:
        total += _expanded(part, sizes, depth + 1)
        if total > _MAX_VALUES:
            break
    sizes[id(node)] = total
    return total


def _numbers(value: Any) -> Any:
    """Convert texts such as 1e-05 to numbers: YAML 1.1 wants a decimal point in a number."""
    if isinstance(value, dict):
        return {str(key): _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    if isinstance(value, str) and value[:1] in set("+-.0123456789"):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def mounting(path: Path, text: str, data: tuple[float, ...], keys: tuple[str, ...] = ("T_BS",)) -> FloatArray:
    """Read a pose from sixteen numbers, as those of T_BS.

    Parameters
    ----------
    path : Path
        For messages.
    text : str
        Text of the file, to find the line.
    data : tuple of float
        Row by row.
    keys : tuple of str
        Where they stand in the file.

    Returns
    -------
    ndarray, shape (4, 4)
        Pose of the sensor in b, for T_BS; translation in m.

    Raises
    ------
    InputError
        When it is not a rotation and a translation.
    """
    T = np.array(data).reshape(4, 4)
    R = T[:3, :3]
    rigid = np.allclose(R @ R.T, np.eye(3), atol=_RIGID_TOLERANCE) and np.linalg.det(R) > 0.0
    if not rigid or not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(
            path,
            "expected a rotation and a translation, last row 0 0 0 1",
            line=line_of(text, list(keys)),
            column=".".join(keys),
        )
    return T


def matrix(T: FloatArray) -> dict[str, Any]:
    """Write a pose as T_BS.

    Parameters
    ----------
    T : ndarray, shape (4, 4)
        Pose of the sensor in b, m.

    Returns
    -------
    dict
    """
    return {"cols": 4, "rows": 4, "data": [float(v) for v in T.ravel()]}


def dump_yaml(data: dict[str, Any]) -> str:
    """Compose the text of a YAML file."""
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=200)
