"""The files sensor.yaml of EuRoC: parsing, poses of sensors, and writing."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from craternav_fg.config import line_of
from craternav_fg.errors import InputError

FloatArray = npt.NDArray[np.float64]

# Largest deviation of R R' from the identity, from numbers of seven digits.
_RIGID_TOLERANCE = 1e-6


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
        When the text is not YAML, or not a table.
    """
    # Some files begin with OpenCV's directive, which is not YAML.
    if text.startswith("%YAML:"):
        text = "#" + text
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        raise InputError(
            path, f"expected YAML: {getattr(error, 'problem', None) or error}", line=mark and mark.line + 1
        ) from None
    if not isinstance(data, dict):
        raise InputError(path, "expected keys and values")
    try:
        return {str(key): _numbers(value) for key, value in data.items()}
    except RecursionError:
        raise InputError(path, "expected values that do not contain themselves") from None


def _numbers(value: Any) -> Any:
    """Turn texts such as 1e-05 into numbers: YAML 1.1 wants a decimal point in a number."""
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


def mounting(path: Path, text: str, data: tuple[float, ...]) -> FloatArray:
    """Read the pose of a sensor from the sixteen numbers of T_BS.

    Parameters
    ----------
    path : Path
        For messages.
    text : str
        Of the file, to find the line.
    data : tuple of float
        Row by row.

    Returns
    -------
    ndarray, shape (4, 4)
        Pose of the sensor in b, m.

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
            line=line_of(text, ["T_BS"]),
            column="T_BS",
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
