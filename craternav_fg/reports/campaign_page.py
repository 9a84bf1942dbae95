"""The page of a campaign."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from craternav_fg.campaign.read import Campaign
from craternav_fg.campaign.store import MARKER
from craternav_fg.campaign.summary import CONVERGED_DEG, CONVERGED_SHARE_OF_ALTITUDE, of_estimator
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.config import read_text
from craternav_fg.estimators.registry import RETROSPECTIVE
from craternav_fg.evaluation.consistency import anees_by_altitude, mean_interval, rms
from craternav_fg.plots.style import colour, line_style
from craternav_fg.reports.page import Block, Cell, Drawing, Page, Section, Table, Text, number_cell
from craternav_fg.reports.svg import WIDTH_IN, inline_svg, mark
from craternav_fg.reports.trial_charts import trial_blocks

FloatArray = npt.NDArray[np.float64]

# Bins of altitude, equal on a logarithmic scale.
BINS = 8
# Range of the drawing's axis.
SHOWN_ANEES = (1.0, 50.0)
# An ANEES outside is highlighted, unless the number of trials explains it. All bins of a campaign without
# model errors stay well inside.
CONSISTENT_ANEES = (4.5, 7.5)
COLUMNS = (
    ("converged", "converged"),
    ("position_final_mean_m", "final position, mean, m"),
    ("position_final_rms_m", "final position, RMS, m"),
    ("attitude_final_mean_deg", "final attitude, mean, deg"),
    ("rms_over_pcrb", "RMS / PCRB"),
    ("anees", "ANEES (6 expected)"),
    ("time_per_trial_s", "time, s"),
)
# Labels, names and dashes of the posterior Cramér-Rao bounds.
BOUNDS = (("filtering PCRB", FILTERED_BOUND, "--"), ("smoothing PCRB", SMOOTHED_BOUND, ":"))


def campaign_page(campaign: Campaign) -> Page:
    """Put together the page of a campaign.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    Page

    Raises
    ------
    InputError
        When the campaign was never completed.
    """
    summary = campaign.summary
    names = tuple(campaign.identity["estimators"])
    sections = [Section("summary", "Summary", _summary(campaign, summary))]
    done = [name for name in names if of_estimator(campaign.table, name, "altitude_m").size]
    if done:
        sections += [
            Section("errors", "Errors", [_errors(campaign, done)]),
            Section("consistency", "Consistency", _consistency(campaign, done)),
            Section("final", "Final errors", [_final(campaign, done)]),
            Section("trials", "Trials", trial_blocks(campaign, done)),
        ]
    sections.append(Section("made", "Scenario and versions", [Text(read_text(campaign.path / MARKER))]))
    return Page(
        title=f"Campaign {campaign.path.resolve().name}",
        subtitle=f"{summary['trials']} trials, {summary['failed']} failed, {summary['wall_s']:.0f} s",
        sections=sections,
        series=[(name, colour(name)) for name in names],
    )


def _summary(campaign: Campaign, summary: dict[str, Any]) -> list[Block]:
    rows = []
    given = {name: len(of_estimator(campaign.table, name, "altitude_m")) for name in summary["estimators"]}
    trials = summary["trials"]
    fewer = any(count != trials for count in given.values())
    # The errors along one trial are correlated: it counts as one sample.
    chance = mean_interval(6, max(summary["trials"] - summary["failed"], 1))
    low, high = min(CONSISTENT_ANEES[0], chance[0]), max(CONSISTENT_ANEES[1], chance[1])
    for name, values in summary["estimators"].items():
        cells = [Cell(name, name)]
        if fewer:
            cells.append(Cell(f"{given[name]} of {trials}", given[name], given[name] != trials))
        for field, _ in COLUMNS:
            value = values[field]
            concern = field == "anees" and value is not None
            concern = concern and not low <= value <= high
            cells.append(number_cell(value, concern=concern))
        rows.append((name, cells))
    smoothed = ", ".join(name for name in summary["estimators"] if name in RETROSPECTIVE)
    caption = (
        f"Converged: final errors below {100.0 * CONVERGED_SHARE_OF_ALTITUDE:g} % of the altitude and "
        f"{CONVERGED_DEG:g} deg. RMS / PCRB: RMS position error over the posterior Cramér-Rao bound, "
        f"averaged over the altitude (smoothing bound for {smoothed or 'none'}, else filtering bound). "
        f"An ANEES outside {low:.1f} to {high:.1f} is highlighted."
    )
    if fewer:
        caption += (
            " The statistics of an estimator cover only the trials in which it produced a trajectory. An "
            "estimator that fails on hard trials looks better on the others."
        )
    headings = ["estimator", *(["trajectories"] if fewer else []), *(h for _, h in COLUMNS)]
    blocks: list[Block] = [Table(headings, rows, caption)]
    problems = [f"trial {number} failed: {why}" for number, why in campaign.failed.items()]
    problems += [
        f"trial {number}: {why}" for number, each in campaign.failures.items() for why in each.values()
    ]
    return blocks + [Text(problem, warning=True) for problem in problems]


def _errors(campaign: Campaign, names: list[str]) -> Drawing:
    """Draw RMS position and attitude errors over the trials against altitude, with the bounds."""
    figure = Figure(figsize=(WIDTH_IN, 6.0), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    parts: list[tuple[Axes, str, slice, float, str]] = [
        (panels[0], "position_error_m", slice(3, 6), 1.0, "position RMS, m"),
        (panels[1], "attitude_error_rad", slice(0, 3), float(np.degrees(1.0)), "attitude RMS, deg"),
    ]
    for axes, column, part, unit, label in parts:
        for name in names:
            values = unit * rms(of_estimator(campaign.table, name, column))
            axes.loglog(_altitude_km(campaign, name), values, label=name, **line_style(name))
        for label_of_bound, bound, line in BOUNDS:
            sigma = unit * rms(of_estimator(campaign.table, bound, "pose_sigma")[..., part])
            axes.loglog(_altitude_km(campaign, bound), sigma, line, color="k", lw=1.2, label=label_of_bound)
        axes.set_ylabel(label)
    panels[1].legend(*_bounds_only(panels[1]), frameon=False, fontsize=9)
    caption = (
        "RMS over the trials. Broken lines: posterior Cramér-Rao bound (PCRB) from the data up to each frame "
        "(filtering) and from all data (smoothing)."
    )
    return _drawing(figure, "errors", names, caption)


def _consistency(campaign: Campaign, names: list[str]) -> list[Block]:
    """Draw the ANEES in bins of altitude, and tabulate it."""
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    # Every trial has rows of the bounds.
    altitude_m = of_estimator(campaign.table, FILTERED_BOUND, "altitude_m").mean(axis=0)
    edges = np.geomspace(altitude_m.max() * 1.001, altitude_m.min() * 0.999, BINS + 1)
    headings, rows = ["estimator"], []
    most = 0
    for name in names:
        nees = of_estimator(campaign.table, name, "nees")
        sound = np.asarray(np.isfinite(nees).all(axis=1))
        if not sound.any():
            continue
        label = name if sound.all() else f"{name} ({sound.sum()} of {len(sound)} trials)"
        nees = nees[sound]
        most = max(most, len(nees))
        bins = anees_by_altitude(nees, altitude_m, edges.tolist())
        middle_km = [1e-3 * np.sqrt(one.highest_m * one.lowest_m) for one in bins]
        axes.loglog(middle_km, [one.mean for one in bins], marker="o", ms=3, label=name, **line_style(name))
        headings[1:] = [f"{1e-3 * one.highest_m:.3g} to {1e-3 * one.lowest_m:.3g} km" for one in bins]
        cells = [number_cell(one.mean, concern=not one.consistent) for one in bins]
        rows.append((name, [Cell(label, label), *cells]))
    if not rows:
        return [Text("No estimator gives covariances.")]
    low, high = mean_interval(6, most)
    axes.axhspan(low, high, color="k", alpha=0.1)
    axes.set_ylim(*SHOWN_ANEES)
    axes.set_ylabel("ANEES of the pose")
    for which in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        which(FuncFormatter(_plain))
    caption = (
        "ANEES of the pose, the mean of e' S⁻¹ e, in bins of altitude: 6 expected; grey: 95 % interval of a "
        f"consistent estimator. Values above {SHOWN_ANEES[1]:g} are not shown."
    )
    table_caption = (
        f"The same in numbers. Values outside {low:.2f} to {high:.2f}, the 95 % interval for {most} trials, "
        "are highlighted. Trials with a singular covariance are left out, and their number is told."
    )
    return [_drawing(figure, "consistency", names, caption), Table(headings, rows, table_caption)]


def _final(campaign: Campaign, names: list[str]) -> Drawing:
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    for name in names:
        final_m = np.linalg.norm(of_estimator(campaign.table, name, "position_error_m")[:, -1], axis=-1)
        share = np.arange(1, len(final_m) + 1) / len(final_m)
        axes.step(np.sort(final_m), share, where="post", label=name, **line_style(name))
    axes.set_xscale("log")
    axes.set_xlabel("final position error, m")
    axes.set_ylabel("share of trials below")
    axes.grid(alpha=0.3)
    mark(figure.axes, names)
    return Drawing(inline_svg(figure, "final"), "Distribution of the final position error.")


def _drawing(figure: Figure, name: str, names: list[str], caption: str) -> Drawing:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
    figure.axes[-1].set_xlabel("altitude, km")
    # In the order of a descent, from high to low.
    figure.axes[-1].invert_xaxis()
    for which in (figure.axes[-1].xaxis.set_major_formatter, figure.axes[-1].xaxis.set_minor_formatter):
        which(FuncFormatter(_plain))
    mark(figure.axes, names)
    return Drawing(inline_svg(figure, name), caption)


def _plain(value: float, _position: int | None = None) -> str:
    """Label a logarithmic axis with plain numbers: 1, 2 and 5 of each power of ten."""
    first = f"{value:e}"[0]
    return f"{value:g}" if first in "125" else ""


def _altitude_km(campaign: Campaign, name: str) -> FloatArray:
    return np.asarray(1e-3 * of_estimator(campaign.table, name, "altitude_m").mean(axis=0))


def _bounds_only(axes: Axes) -> tuple[list[Any], list[Any]]:
    """Legend of the bounds, for which the page has no buttons."""
    handles, labels = axes.get_legend_handles_labels()
    bounds = {label for label, _, _ in BOUNDS}
    chosen = [(handle, label) for handle, label in zip(handles, labels, strict=True) if label in bounds]
    return [handle for handle, _ in chosen], [label for _, label in chosen]
