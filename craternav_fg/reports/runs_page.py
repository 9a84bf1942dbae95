"""One page on several runs, of one data set or of several."""

import html
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from craternav_fg.evaluation.metrics import errors
from craternav_fg.plots.style import line_styles
from craternav_fg.reports.charts import DASHES, line, panels, seconds
from craternav_fg.reports.page import Block, Cell, Chart, Page, Section, Table, Text, number_cell
from craternav_fg.reports.run_page import ERROR_HEADINGS, shows_overconfidence
from craternav_fg.runs.read import Run

# Plotly's, one for each run, some on each line.
_SYMBOLS = tuple(
    f"{shape}{end}"
    for end in ("", "-open")
    for shape in (
        "circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "x", "pentagon", "star",
        "hourglass", "bowtie", "hexagram",
    )
)  # fmt: skip
_SHOWN_SYMBOLS = 12


def runs_page(runs: Sequence[Run]) -> Page:
    """Put together a page that compares runs.

    Parameters
    ----------
    runs : sequence of Run

    Returns
    -------
    Page
    """
    labels = _labels(runs)
    styles = line_styles(name for run in runs for name in run.trajectories)
    charts = [_positions(runs, labels, styles)]
    return Page(
        title=f"{len(runs)} runs",
        subtitle="; ".join(
            f"{label}: data set {run.dataset}" for label, run in zip(labels, runs, strict=True)
        ),
        sections=[
            Section("summary", "Summary", _summary(runs, labels)),
            Section("errors", "Errors", charts),
        ],
        series=[(name, style["color"]) for name, style in styles.items()],
    )


def _labels(runs: Sequence[Run]) -> list[str]:
    """Names of the folders, or whole paths where two are the same."""
    names = [run.path.resolve().name for run in runs]
    return names if len(set(names)) == len(names) else [str(run.path) for run in runs]


def _summary(runs: Sequence[Run], labels: Sequence[str]) -> list[Block]:
    blocks: list[Block] = []
    rows = []
    for label, run in zip(labels, runs, strict=True):
        blocks += [Text(f"{label}: {warning}", warning=True) for warning in run.metrics.get("warnings", ())]
        for name in run.trajectories:
            values = run.metrics["estimators"][name]
            cells = [Cell(name, name), Cell(label, label)]
            for field, _ in ERROR_HEADINGS:
                concern = field == "anees" and shows_overconfidence(name, values.get(field))
                cells.append(number_cell(values.get(field), concern=concern))
            rows.append((name, cells))
    if len({run.dataset.resolve() for run in runs}) > 1:
        blocks.append(Text("The runs are of different data sets: their errors are not of the same descent."))
    headings = ["estimator", "run", *(heading for _, heading in ERROR_HEADINGS)]
    return [*blocks, Table(headings, rows, "Click a heading to sort.")]


def _positions(runs: Sequence[Run], labels: Sequence[str], styles: Mapping[str, dict[str, Any]]) -> Block:
    """Draw the position errors of all runs; without truth the standard deviations."""
    traces = []
    symbols = dict(zip(labels, itertools.cycle(_SYMBOLS), strict=False))
    for label, run in zip(labels, runs, strict=True):
        for name, trajectory in run.trajectories.items():
            if run.truth is not None:
                value = np.linalg.norm(errors(trajectory, run.truth).position_m, axis=1)
            elif trajectory.pose_covariance is not None:
                value = np.sqrt(np.trace(trajectory.pose_covariance[:, 3:, 3:], axis1=1, axis2=2))
            else:
                continue
            style = {"color": styles[name]["color"], "dash": DASHES[styles[name]["ls"]], "width": 1.8}
            marker = {"symbol": symbols[label], "size": 8, "maxdisplayed": _SHOWN_SYMBOLS}
            hover = f"{html.escape(label)}, {html.escape(name)}<br>%{{x:.4g}} s: %{{y:.3g}} m<extra></extra>"
            more: dict[str, Any] = {"mode": "lines+markers", "marker": marker, "hovertemplate": hover}
            traces.append(line(seconds(trajectory), value, name, line=style, **more))
    layout = panels(["position error, m"], [1], logarithmic=True)
    listed = ", ".join(f"{label} ({symbol})" for label, symbol in symbols.items())
    caption = f"Position errors, or standard deviations of runs without truth. Symbols: {listed}."
    return Chart("runs-chart", {"data": traces, "layout": layout}, 460, caption)
