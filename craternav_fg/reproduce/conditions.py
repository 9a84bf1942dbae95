"""The trials of one altitude, their statistics, and the rows that they make."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.reproduce import static_pose as runs
from craternav_fg.reproduce.rows import Row, verdict

FloatArray = npt.NDArray[np.float64]

MEAN, STD, RMS = "mean", "standard deviation", "rms"
_PAPER_TRIALS = 100


@dataclass(frozen=True)
class Equation:
    """A method of the paper: its name, and the columns of its errors as printed and corrected."""

    name: str
    as_printed: str | None
    corrected: str | None


CENTRES = Equation("(10)", runs.CENTRES, None)
EDGES = Equation("(13)", None, runs.EDGES)
TWO = Equation("(23)", None, runs.TWO)
SHAPES = Equation("(19), unweighted", runs.SHAPES, None)


class Condition:
    """The trials of one altitude and noise, and their statistics."""

    def __init__(self, data: pa.Table, altitude_m: float, noise_px: float, unit: str) -> None:
        keep = (data["altitude_m"].to_numpy() == altitude_m) & (data["noise_px"].to_numpy() == noise_px)
        self.columns = {name: data[name].to_numpy()[keep] for name in data.column_names}
        self.unit = unit

    def values(self, method: str) -> FloatArray:
        """Errors (trials,) of a method that found a pose."""
        column = self.columns[f"{method}_{self.unit}"]
        return np.asarray(column[np.isfinite(column)])

    def statistic(self, method: str | None, kind: str) -> float | None:
        """Mean, standard deviation or root mean square of a method's errors; None where there is none."""
        if method is None or not len(self.values(method)):
            return None
        values = self.values(method)
        if kind == MEAN:
            return float(values.mean())
        return float(values.std()) if kind == STD else float(np.sqrt(np.mean(values**2)))

    def bound(self, kind: str) -> float:
        """Give the same statistic of errors that are Gaussian with the bound as their covariance."""
        square = float(np.mean(self.columns[f"bound_rms_{self.unit}"] ** 2))
        mean = float(np.mean(self.columns[f"bound_mean_{self.unit}"]))
        if kind == MEAN:
            return mean
        return float(np.sqrt(square - mean**2)) if kind == STD else float(np.sqrt(square))

    def row(
        self, figure: str, quantity: str, equation: Equation, kind: str, where: str, paper: float | None,
        headline: bool,
    ) -> Row:  # fmt: skip
        """Row of a method's statistic beside the bound's."""
        corrected = self.statistic(equation.corrected or equation.as_printed, kind)
        trials = np.sqrt(len(self.columns["trial"]))
        # Of a mean; of a standard deviation about as much. The paper's own deviation is about its mean.
        own = 0.0 if paper is None else paper / np.sqrt(_PAPER_TRIALS)
        error = float(np.hypot((self.statistic(equation.corrected, STD) or 0.0) / trials, own))
        views = float(np.std(self.columns[f"bound_mean_{self.unit}"]))
        return Row(
            figure,
            f"{quantity} error of {equation.name}, {kind}",
            where,
            self.unit,
            paper,
            self.statistic(equation.as_printed, kind),
            self.statistic(equation.corrected, kind),
            self.statistic(runs.EFFICIENT, kind),
            self.bound(kind),
            verdict(
                paper,
                corrected,
                self.bound(kind),
                error=error,
                bound_error=float(np.hypot(views / trials, own)),
            ),
            headline,
        )
