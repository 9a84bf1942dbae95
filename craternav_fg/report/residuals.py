"""Residuals of a run's rims: over time, and crater by crater."""

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from craternav_fg.plots.style import colour
from craternav_fg.report.page import Cell, Table

DOF = 5
# A crater whose rims deviate by more than this, per degree of freedom, deserves a look at its map entry.
SUSPECT_CHI2_PER_DOF = 3.0


def draw_residuals(residuals: pa.Table, first_stamp_ns: int) -> Figure:
    """Draw the chi-square per degree of freedom of an estimator's rims over time.

    Parameters
    ----------
    residuals : pyarrow.Table
        Rows of residuals.parquet of one estimator, one or more.
    first_stamp_ns : int
        Where time begins.

    Returns
    -------
    Figure
    """
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    seconds = (residuals["stamp_ns"].to_numpy() - first_stamp_ns) * 1e-9
    chi2_per_dof = np.maximum(residuals["chi2"].to_numpy() / DOF, 1e-3)
    rejected = _rejected(residuals)
    axes.semilogy(seconds[~rejected], chi2_per_dof[~rejected], ".", ms=3, color=colour("smoother"))
    axes.semilogy(seconds[rejected], chi2_per_dof[rejected], "x", ms=4, color=colour("centre_smoother"))
    axes.axhline(1.0, color="0.4", lw=0.8)
    axes.set_xlabel("time, s")
    axes.set_ylabel("χ² / 5 of a rim")
    axes.grid(alpha=0.3)
    axes.margins(x=0.01)
    return figure


def crater_table(residuals: pa.Table) -> Table:
    """Sum up an estimator's residuals crater by crater, the worst first.

    Rims whose match was rejected are counted, and are in no mean: they are another crater's.

    Parameters
    ----------
    residuals : pyarrow.Table
        As for `draw_residuals`.

    Returns
    -------
    Table
    """
    identifiers = np.array(residuals["crater_id"].to_pylist())
    whitened = (
        residuals["whitened"].combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, DOF)
    )
    chi2 = residuals["chi2"].to_numpy()
    rejected = _rejected(residuals)
    rows = []
    for crater in np.unique(identifiers):
        own = identifiers == crater
        kept = own & ~rejected
        cells = [
            Cell(str(crater), str(crater)),
            Cell(str(int(own.sum())), int(own.sum())),
            Cell(str(int((own & rejected).sum())), int((own & rejected).sum())),
        ]
        if kept.any():
            mean = float(chi2[kept].mean()) / DOF
            cells.append(Cell(f"{mean:.3g}", mean, concern=mean > SUSPECT_CHI2_PER_DOF))
            bias = whitened[kept].mean(axis=0)
            cells += [Cell(f"{value:+.2f}", float(abs(value))) for value in bias]
        else:
            cells += [Cell("–", -1.0)] * (1 + DOF)
        rows.append(("", cells))
    rows.sort(key=lambda row: -float(row[1][3].key))
    headings = (
        "crater",
        "rims",
        "rejected",
        "mean χ² / 5",
        "centre x",
        "centre y",
        "width",
        "skew",
        "height",
    )
    caption = (
        "By crater, in sigmas, measured minus predicted, mean over its frames: what stays off in all of them "
        "is the crater's own (its map entry, its outline), or the light's. A heading sorts."
    )
    return Table(headings, rows, caption)


def _rejected(residuals: pa.Table) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    weights = residuals["weight"].to_pylist()
    return np.array([weight is not None and weight < 0.5 for weight in weights], dtype=bool)
