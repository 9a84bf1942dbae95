"""Statistics of the trials of figs. 11 to 14 at one altitude, and their rows."""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from craternav_fg.reproduce import fig11_14_trials as trials
from craternav_fg.reproduce.results import Row, verdict
from factors.arrays import FloatArray

MEAN, STD, RMS = "mean", "standard deviation", "rms"
# Trials at each altitude in the paper.
_PAPER_TRIALS = 100


@dataclass(frozen=True)
class Equation:
    """A method of the paper: its name, and the columns of its errors as printed and corrected."""

    name: str
    as_printed: str
    corrected: str


# Eqs. (10) and (19) need no correction: both columns are the same.
CENTRES = Equation("(10)", trials.CENTRES, trials.CENTRES)
EDGES = Equation("(13)", trials.EDGES_PRINTED, trials.EDGES)
TWO = Equation("(23)", trials.TWO_PRINTED, trials.TWO)
SHAPES = Equation("(19), unweighted", trials.SHAPES, trials.SHAPES)


class Condition:
    """The trials of one altitude and noise, and their statistics.

    Every method and the bound are averaged over the same trials: those in which all rims have ellipses and
    the efficient solver gives a pose. With the printed sign only the first few of them were run.

    Parameters
    ----------
    data : pyarrow.Table
        See `fig11_14_trials.simulate`.
    altitude_m, noise_px : float
    unit : {"m", "deg"}
        Position or attitude.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (trials,)
        All trials, also those that do not count.
    counted : ndarray of bool, shape (trials,)
        Trials that count.
    unit : str
    """

    def __init__(self, data: pa.Table, altitude_m: float, noise_px: float, unit: str) -> None:
        keep = (data["altitude_m"].to_numpy() == altitude_m) & (data["noise_px"].to_numpy() == noise_px)
        self.columns = {name: data[name].to_numpy()[keep] for name in data.column_names}
        self.unit = unit
        self.counted = self.columns["solutions"] > 0.0

    def values(self, method: str) -> FloatArray:
        """Errors of a method in the counted trials.

        Parameters
        ----------
        method : str

        Returns
        -------
        ndarray, shape (n,)
            In `unit`, without the trials in which the method finds no pose.
        """
        column = self.columns[f"{method}_{self.unit}"][self.counted]
        return np.asarray(column[np.isfinite(column)])

    def bounds(self) -> FloatArray:
        """RMS of the bound in each counted trial.

        Returns
        -------
        ndarray, shape (n,)
            In `unit`.
        """
        return np.asarray(self.columns[f"bound_rms_{self.unit}"][self.counted])

    def statistic(self, method: str, kind: str) -> float | None:
        """Mean, standard deviation or root mean square of a method's errors; None where there is none."""
        values = self.values(method)
        if not len(values):
            return None
        if kind == MEAN:
            return float(values.mean())
        return float(values.std()) if kind == STD else float(np.sqrt(np.mean(values**2)))

    def bound(self, kind: str) -> float | None:
        """Return the same statistic of errors that are Gaussian with the bound as their covariance."""
        if not self.counted.any():
            return None
        square = float(np.mean(self.bounds() ** 2))
        mean = float(np.mean(self.columns[f"bound_mean_{self.unit}"][self.counted]))
        if kind == MEAN:
            return mean
        return float(np.sqrt(square - mean**2)) if kind == STD else float(np.sqrt(square))

    def standard_error(self, method: str, kind: str) -> float:
        """Return the standard error of a method's mean or standard deviation."""
        values = self.values(method)
        std = float(values.std()) if len(values) else 0.0
        if std == 0.0 or kind == MEAN:
            return std / np.sqrt(max(len(values), 1))
        fourth = float(np.mean((values - values.mean()) ** 4))
        return float(np.sqrt((fourth - std**4) / len(values)) / (2.0 * std))

    def row(
        self, figure: str, quantity: str, equation: Equation, kind: str, where: str,
        printed: tuple[float, float] | None, headline: bool,
    ) -> Row:  # fmt: skip
        """Make the row of a method's statistic beside the bound's and the paper's.

        Parameters
        ----------
        figure, quantity : str
        equation : Equation
        kind : {MEAN, STD, RMS}
        where : str
            The condition.
        printed : tuple of float, optional
            The paper's mean and standard deviation.
        headline : bool

        Returns
        -------
        Row
        """
        corrected, bound = self.statistic(equation.corrected, kind), self.bound(kind)
        paper = None if printed is None or kind == RMS else printed[(MEAN, STD).index(kind)]
        judged = verdict(None, corrected, None)
        if printed is not None and paper is not None:
            # Standard error of the paper's mean; that of its standard deviation is of the same size.
            own = printed[1] / np.sqrt(_PAPER_TRIALS)
            views = float(np.std(self.columns[f"bound_mean_{self.unit}"][self.counted])) if bound else 0.0
            judged = verdict(
                paper,
                corrected,
                # The bound limits the mean of an error's length, not its standard deviation.
                bound if kind == MEAN else None,
                error=float(np.hypot(self.standard_error(equation.corrected, kind), own)),
                bound_error=float(np.hypot(views / np.sqrt(max(self.counted.sum(), 1)), own)),
            )
        return Row(
            figure,
            f"{quantity} error of {equation.name}, {kind}",
            where,
            self.unit,
            paper,
            self.statistic(equation.as_printed, kind),
            corrected,
            self.statistic(trials.EFFICIENT, kind),
            bound,
            judged,
            headline,
        )
