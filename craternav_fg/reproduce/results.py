"""What a reproduced figure consists of: rows with a verdict, a paragraph, a drawing, the data."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

# A number of the paper counts as reproduced within this share of it.
_MET = 0.1
_STANDARD_ERRORS = 3.0
_SAME_ORDER = 10.0**0.5
NO_NUMBER = "the paper prints no number"


@dataclass(frozen=True)
class Row:
    """One number of a figure; None where there is none.

    Attributes
    ----------
    figure, quantity, condition, unit : str
    paper : float or None
        As the paper's text prints it; what only its plots show is not known.
    as_printed, corrected : float or None
        By the paper's equations as printed, and put right.
    efficient : float or None
        By the maximum-likelihood solver.
    bound : float or None
        Of an estimator that attains the Cramér-Rao bound, in the same statistic.
    verdict : str
    headline : bool
        Whether the row stands in the printed table; not part of what is written.
    """

    figure: str
    quantity: str
    condition: str
    unit: str
    paper: float | None = None
    as_printed: float | None = None
    corrected: float | None = None
    efficient: float | None = None
    bound: float | None = None
    verdict: str = ""
    headline: bool = True

    def as_dict(self) -> dict[str, str | float | None]:
        """Give the fields by name, as reproduction.json holds them."""
        return {name: getattr(self, name) for name in FIELDS}


FIELDS = (
    "figure", "quantity", "condition", "unit", "paper", "as_printed", "corrected", "efficient", "bound",
    "verdict",
)  # fmt: skip
NUMBERS = ("paper", "as_printed", "corrected", "efficient", "bound")


@dataclass(frozen=True)
class Reproduction:
    """A figure of the paper, reproduced.

    Attributes
    ----------
    name : str
        Of the figure: fig02.
    title : str
        What it shows, one line.
    rows : sequence of Row
    note : str
        A paragraph: what holds of the paper's statements, what cannot be had and why.
    drawing : Figure
    data : pyarrow.Table
        All that the drawing and the rows rest on.
    """

    name: str
    title: str
    rows: Sequence[Row]
    note: str
    drawing: Figure
    data: pa.Table


def verdict(
    paper: float | None,
    corrected: float | None,
    bound: float | None,
    *,
    error: float = 0.0,
    bound_error: float = 0.0,
) -> str:
    """Judge a number of the paper by what its corrected equations give, and by the bound.

    "Reproduced" needs trials enough to tell: a standard error as small as the difference that is allowed.

    Parameters
    ----------
    paper, corrected, bound : float or None
        In one statistic and unit.
    error, bound_error : float
        Standard error of the difference between the paper and what is corrected, and of that between the
        paper and the bound, by the number of trials.
    """
    if paper is None:
        return NO_NUMBER
    parts = []
    if corrected is None:
        parts.append("not reproduced")
    elif max(abs(corrected - paper), error) <= _MET * paper:
        parts.append("reproduced")
    else:
        ratio = corrected / paper
        if abs(corrected - paper) <= _STANDARD_ERRORS * error:
            word = "within the trials' scatter"
        else:
            word = "same order" if 1.0 / _SAME_ORDER <= ratio <= _SAME_ORDER else "not reproduced"
        parts.append(f"{word}: {ratio:.2g} times the paper's")
    if bound is not None and paper < bound - max(_MET * paper, _STANDARD_ERRORS * bound_error):
        parts.append(f"out of reach: the bound is {bound / paper:.2g} times the paper's")
    return "; ".join(parts)


def known(value: float) -> float | None:
    """Give a number as a row holds it: None for NaN."""
    return None if np.isnan(value) else float(value)


def number(value: float | None) -> str:
    """Give a number as the tables show it: three digits, a dash where there is none."""
    if value is None:
        return "-"
    if abs(value) < 1e-6:
        return "0"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.3g}"
