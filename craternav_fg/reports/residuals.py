"""Residuals of the rims of a run by crater."""

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.reports.page import Cell, Table
from craternav_fg.runs.columns import list_values

# Components of a rim's chart, and their names.
COMPONENTS = ("centre x", "centre y", "size x", "shear", "size y")
DOF = len(COMPONENTS)
# A crater whose mean is larger is highlighted: its map entry should be checked. With 10 frames noise exceeds
# 2 in 1 of 30,000 craters; 3 leaves room for time-correlated errors.
SUSPECT_CHI2_PER_DOF = 3.0
# Smallest value of the logarithmic axis.
MIN_CHI2_PER_DOF = 1e-3


def crater_table(residuals: pa.Table) -> Table:
    """Summarise the residuals of an estimator by crater, the largest first.

    Rims whose match was rejected are counted but not averaged, as they belong to another crater.

    Parameters
    ----------
    residuals : pyarrow.Table
        Rows of one estimator in residuals.parquet, at least one.

    Returns
    -------
    Table
    """
    identifiers = np.array(residuals["crater_id"].to_pylist())
    whitened = list_values(residuals["whitened"])
    assert whitened is not None
    chi2 = residuals["chi2"].to_numpy()
    out = rejected(residuals)
    rows = []
    for crater in np.unique(identifiers):
        own = identifiers == crater
        kept = own & ~out
        cells = [
            Cell(str(crater), str(crater)),
            Cell(str(int(own.sum())), int(own.sum())),
            Cell(str(int((own & out).sum())), int((own & out).sum())),
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
    headings = ("crater", "rims", "rejected", f"mean χ² / {DOF}", *COMPONENTS)
    caption = (
        "Mean whitened residual of each crater, measured minus predicted, in sigmas. If many frames agree on "
        "a mean, the cause is the crater's map entry, its outline or the illumination. Click a heading to "
        "sort."
    )
    return Table(headings, rows, caption)


def rejected(residuals: pa.Table) -> npt.NDArray[np.bool_]:
    """Determine which matches were rejected.

    Parameters
    ----------
    residuals : pyarrow.Table
        Rows of residuals.parquet.

    Returns
    -------
    ndarray of bool, shape (n,)
        For each rim.
    """
    weights = residuals["weight"].to_pylist()
    return np.array([weight is not None and weight < 0.5 for weight in weights], dtype=bool)
