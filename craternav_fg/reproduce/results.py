"""A reproduced figure: its rows with a verdict each, a paragraph, a drawing and the data."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

# A number of the paper counts as reproduced within this share of it.
_REPRODUCED_WITHIN = 0.1
_STANDARD_ERRORS = 3.0
# Numbers within this factor of each other are of the same order.
_SAME_ORDER_FACTOR = 10.0**0.5
# Magnitudes below this are rounding.
_ROUNDING = 1e-6
NO_NUMBER = "the paper prints no number"


@dataclass(frozen=True)
class Row:
    """One quantity of a figure under one condition; a number is None where there is none.

    Attributes
    ----------
    figure, quantity, condition, unit : str
    paper : float or None
        As printed in the paper's text; what only its plots show is not known.
    as_printed, corrected : float or None
        By the paper's equations as printed, and corrected.
    efficient : float or None
        By the maximum-likelihood solver.
    bound : float or None
        The same statistic of an estimator that attains the Cramér-Rao bound.
    verdict : str
    headline : bool
        Whether the row is in the printed table; not part of what is written.
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
        """Return the fields by name, as reproduction.json holds them."""
        return {name: getattr(self, name) for name in FIELDS}


FIELDS = (
    "figure", "quantity", "condition", "unit", "paper", "as_printed", "corrected", "efficient", "bound",
    "verdict",
)  # fmt: skip
NUMBERS = ("paper", "as_printed", "corrected", "efficient", "bound")


@dataclass(frozen=True, repr=False)
class Reproduction:
    """A figure of the paper, reproduced.

    Attributes
    ----------
    name : str
        Name of the figure, such as fig02.
    title : str
        One line.
    rows : sequence of Row
    note : str
        A paragraph: set-up, and the paper's statements beside the numbers found here.
    drawing : Figure
    data : pyarrow.Table
        The trials behind the drawing and the rows.
    """

    name: str
    title: str
    rows: Sequence[Row]
    note: str
    drawing: Figure
    data: pa.Table

    def __repr__(self) -> str:
        return f"{self.name}: {self.title}"

    def _repr_markdown_(self) -> str:
        """Show title and note in a notebook."""
        return f"**{self.title}.** {self.note}"


def verdict(
    paper: float | None,
    corrected: float | None,
    bound: float | None,
    *,
    error: float = 0.0,
    bound_error: float = 0.0,
) -> str:
    """Judge a number of the paper by that of its corrected equations, and by the bound.

    "Reproduced" needs enough trials: a standard error no larger than the difference that is allowed.

    Parameters
    ----------
    paper, corrected, bound : float or None
        In one statistic and unit.
    error, bound_error : float
        Standard errors of the differences between `paper` and `corrected`, and between `paper` and `bound`.

    Returns
    -------
    str
    """
    if paper is None:
        return NO_NUMBER
    parts = []
    if corrected is None:
        parts.append("not reproduced")
    elif max(abs(corrected - paper), error) <= _REPRODUCED_WITHIN * paper:
        parts.append("reproduced")
    else:
        ratio = corrected / paper
        if abs(corrected - paper) <= _STANDARD_ERRORS * error:
            word = "within the trials' scatter"
        elif 1.0 / _SAME_ORDER_FACTOR <= ratio <= _SAME_ORDER_FACTOR:
            word = "same order"
        else:
            word = "not reproduced"
        parts.append(f"{word}: {ratio:.2g} times the paper's")
    if bound is not None:
        tolerance = max(_REPRODUCED_WITHIN * paper, _STANDARD_ERRORS * bound_error)
        if paper < bound - tolerance:
            parts.append(f"out of reach: the bound is {bound / paper:.2g} times the paper's")
    return "; ".join(parts)


def known(value: float) -> float | None:
    """Return a number as a row holds it: None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def number(value: float | None) -> str:
    """Format a number as the tables show it: three digits, a dash where there is none."""
    if value is None:
        return "-"
    if abs(value) < _ROUNDING:
        return "0"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.3g}"
