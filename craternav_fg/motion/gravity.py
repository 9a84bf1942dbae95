"""Gravity fields in spherical harmonics: a point mass, J2 and C22, or the coefficients of a file."""

from dataclasses import dataclass, field
from math import factorial, sqrt
from pathlib import Path

import numpy as np

from craternav_fg.config import read_text
from craternav_fg.errors import InputError
from factors.arrays import FloatArray

# Beyond it unnormalised coefficients leave the range of numbers, and an orbit of 100 km hardly feels them.
MAX_DEGREE = 80
# Columns of a coefficient row in a SHADR table: degree, order, C, S; their uncertainties may follow.
_COLUMNS = 4
# Values of a SHADR header: radius (km), mu (km^3/s^2), its uncertainty, degree, order, normalisation, ...
_HEADER_COLUMNS = 6


def _point() -> FloatArray:
    return np.ones((1, 1))


@dataclass(frozen=True)
class GravityField:
    """Coefficients of a gravity field in the body-fixed frame.

    Attributes
    ----------
    radius_m : float
        Reference radius of the coefficients.
    C, S : ndarray, shape (n + 1, n + 1)
        Unnormalised coefficients by degree and order, dimensionless; of shape (1, 1) for a point mass.
    """

    radius_m: float = 1.0
    C: FloatArray = field(default_factory=_point)
    S: FloatArray = field(default_factory=lambda: np.zeros((1, 1)))


def degree_two(radius_m: float, j2: float, c22: float) -> GravityField:
    """Make a field of a point mass, J2 and C22.

    Parameters
    ----------
    radius_m : float
        Reference radius.
    j2, c22 : float
        Unnormalised; of the Moon 2.03e-4 and 2.24e-5.

    Returns
    -------
    GravityField
    """
    if j2 == 0.0 and c22 == 0.0:
        return GravityField()
    C = np.zeros((3, 3))
    C[0, 0], C[2, 0], C[2, 2] = 1.0, -j2, c22
    return GravityField(radius_m, C, np.zeros((3, 3)))


def read_gravity(path: Path, degree: int = MAX_DEGREE) -> GravityField:
    """Read fully normalised coefficients from a table as NASA's Planetary Data System has them (SHADR).

    Parameters
    ----------
    path : Path
        Values separated by commas. The first line has the reference radius (km) and mu (km^3/s^2), the
        others degree, order, C and S.
    degree : int
        Largest degree that is used.

    Returns
    -------
    GravityField

    Raises
    ------
    InputError
        When the file is missing or not such a table: names its line.
    """
    lines = read_text(path).splitlines()
    rows = [(k, line.replace(",", " ").split()) for k, line in enumerate(lines, 1) if line.strip()]
    if not rows or len(rows[0][1]) < _HEADER_COLUMNS:
        raise InputError(path, "expected a SHADR header: radius (km), mu (km^3/s^2), ..., degree", line=1)
    radius_km, *_, normalisation = _numbers(path, *rows[0], _HEADER_COLUMNS)
    if not radius_km > 0.0:
        raise InputError(path, f"expected a reference radius in km, found {radius_km:g}", line=rows[0][0])
    if normalisation != 1.0:
        problem = f"expected the normalisation 1, of fully normalised coefficients, found {normalisation:g}"
        raise InputError(path, problem, line=rows[0][0])
    top = min(degree, MAX_DEGREE)
    C, S = np.zeros((top + 1, top + 1)), np.zeros((top + 1, top + 1))
    C[0, 0] = 1.0
    found = 0
    for number, cells in rows[1:]:
        n, m, c, s = _numbers(path, number, cells, _COLUMNS)
        if not (n.is_integer() and m.is_integer() and 0 <= m <= n):
            raise InputError(path, f"expected degree and order, found {cells[0]} and {cells[1]}", line=number)
        if 1 <= n <= top:
            scale = _normalisation(int(n), int(m))
            C[int(n), int(m)], S[int(n), int(m)] = scale * c, scale * s
            found = max(found, int(n))
    kept = slice(found + 1)
    return GravityField(1e3 * radius_km, C[kept, kept].copy(), S[kept, kept].copy())


def gravity_text(gravity: GravityField, mu_m3_s2: float) -> str:
    """Compose the table of a field, as `read_gravity` reads it.

    Parameters
    ----------
    gravity : GravityField
    mu_m3_s2 : float
        For the reader of the file; not read back.

    Returns
    -------
    str
    """
    top = len(gravity.C) - 1
    lines = [f"{1e-3 * gravity.radius_m!r}, {1e-9 * mu_m3_s2!r}, 0.0, {top}, {top}, 1, 0.0, 0.0"]
    for n in range(2, top + 1):
        for m in range(n + 1):
            c, s = (float(part[n, m]) / _normalisation(n, m) for part in (gravity.C, gravity.S))
            lines.append(f"{n}, {m}, {c!r}, {s!r}")
    return "\n".join(lines) + "\n"


def _numbers(path: Path, line: int, cells: list[str], count: int) -> list[float]:
    try:
        values = [float(cell.upper().replace("D", "E")) for cell in cells[:count]]
    except ValueError:
        values = []
    if len(values) < count or not np.isfinite(values).all():
        raise InputError(path, f"expected {count} numbers, found {' '.join(cells[:count])!r}", line=line)
    return values


def _normalisation(n: int, m: int) -> float:
    """Unnormalised over fully normalised coefficient."""
    return sqrt((1 if m == 0 else 2) * (2 * n + 1) * (factorial(n - m) / factorial(n + m)))
