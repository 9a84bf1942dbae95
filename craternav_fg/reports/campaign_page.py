"""The page of a campaign."""

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from craternav_fg.campaign.read import Campaign
from craternav_fg.campaign.store import MARKER, SUMMARY
from craternav_fg.campaign.summary import (
    CONVERGED_DEG,
    CONVERGED_SHARE_OF_ALTITUDE,
    LEAST_SHARE_OF_LARGEST_ALTITUDE,
    of_estimator,
    summarise,
    with_nees,
)
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.config import read_text
from craternav_fg.estimators.registry import is_retrospective
from craternav_fg.evaluation.consistency import anees_by_altitude, mean_interval, rms
from craternav_fg.plots.style import colour, line_style
from craternav_fg.reports.page import Block, Cell, Drawing, Page, Section, Table, Text, number_cell
from craternav_fg.reports.svg import WIDTH_IN, inline_svg, mark
from craternav_fg.reports.trial_charts import altitude_scale, trial_blocks, trial_numbers
from factors.arrays import FloatArray

# Bins of altitude, equal on a logarithmic scale where the altitude is positive.
BINS = 8
# Range of the drawing's axis; it begins lower where an ANEES is smaller.
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
    # Those of the trials that are there: the file is of fewer if the campaign is being extended.
    written, summary = campaign.summary, summarise(campaign)
    names = tuple(campaign.identity["estimators"])
    sections = [Section("summary", "Summary", [*_extended(written, summary), *_summary(campaign, summary)])]
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


def _extended(written: dict[str, Any], summary: dict[str, Any]) -> list[Block]:
    """Warn of a campaign that was extended and interrupted."""
    if written["trials"] == summary["trials"]:
        return []
    problem = (
        f"The campaign is being extended or was interrupted: this page is of the {summary['trials']} trials "
        f"that are there, {SUMMARY} of {written['trials']}."
    )
    return [Text(problem, warning=True)]


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
    smoothed = ", ".join(name for name in summary["estimators"] if is_retrospective(name))
    caption = (
        f"Converged: final errors below {100.0 * CONVERGED_SHARE_OF_ALTITUDE:g} % of the altitude (of "
        f"{100.0 * LEAST_SHARE_OF_LARGEST_ALTITUDE:g} % of the largest altitude at least) and "
        f"{CONVERGED_DEG:g} deg. RMS / PCRB: RMS position error over the posterior Cramér-Rao bound "
        f"(smoothing bound for {smoothed or 'none'}, else filtering bound), averaged over the altitude, or "
        "over the frames where that neither only falls nor only rises. "
        f"An ANEES outside {low:.1f} to {high:.1f} is highlighted."
    )
    if fewer:
        caption += (
            " The statistics of an estimator cover only the trials in which it produced a trajectory. An "
            "estimator that fails on hard trials looks better on the others."
        )
    singular = [
        f"{name} {values['anees_trials']} of {values['trajectories']}"
        for name, values in summary["estimators"].items()
        if 0 < values["anees_trials"] < values["trajectories"]
    ]
    if singular:
        caption += f" The ANEES is over the trials without a singular covariance: {', '.join(singular)}."
    headings = ["estimator", *(["trajectories"] if fewer else []), *(h for _, h in COLUMNS)]
    blocks: list[Block] = [Table(headings, rows, caption)]
    problems = [f"trial {number} failed: {why}" for number, why in campaign.failed.items()]
    problems += [
        f"trial {number}: {why}" for number, each in campaign.failures.items() for why in each.values()
    ]
    return blocks + [Text(problem, warning=True) for problem in problems]


def _errors(campaign: Campaign, names: list[str]) -> Drawing:
    """Draw RMS position and attitude errors against altitude, with the bounds.

    All are over the trials that every estimator has ended. Without any each estimator has its own, and the
    bounds, which are of no such set, are left out.
    """
    own = [set(trial_numbers(campaign, name).tolist()) for name in names]
    common = set.intersection(*own)
    table = campaign.table
    bounds: tuple[tuple[str, str, str], ...] = BOUNDS if common else ()
    if common:
        table = table.filter(pc.is_in(table["trial"], pa.array(sorted(common), table["trial"].type)))
    figure = Figure(figsize=(WIDTH_IN, 6.0), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    parts: list[tuple[Axes, str, slice, float, str]] = [
        (panels[0], "position_error_m", slice(3, 6), 1.0, "position RMS, m"),
        (panels[1], "attitude_error_rad", slice(0, 3), float(np.degrees(1.0)), "attitude RMS, deg"),
    ]
    for axes, column, part, unit, label in parts:
        for name in names:
            values = unit * rms(of_estimator(table, name, column))
            axes.semilogy(_altitude_km(table, name), values, label=name, **line_style(name))
        for label_of_bound, bound, line in bounds:
            sigma = unit * rms(of_estimator(table, bound, "pose_sigma")[..., part])
            axes.semilogy(_altitude_km(table, bound), sigma, line, color="k", lw=1.2, label=label_of_bound)
        axes.set_xscale(altitude_scale(campaign))
        axes.set_ylabel(label)
    panels[1].legend(*_bounds_only(panels[1]), frameon=False, fontsize=9)
    broken = (
        " Broken lines: posterior Cramér-Rao bound (PCRB) from the data up to each frame (filtering) and "
        "from all data (smoothing)."
    )
    trials = _trials(campaign)
    caption = f"RMS over the trials.{broken}"
    if not common:
        caption = (
            "RMS over the trials in which each estimator produced a trajectory; they have none in common, so "
            "no bound is drawn."
        )
    elif len(common) < trials:
        caption = (
            f"RMS over the {len(common)} of {trials} trials in which every estimator produced a trajectory."
            f"{broken}"
        )
    return _drawing(figure, "errors", names, caption)


def _consistency(campaign: Campaign, names: list[str]) -> list[Block]:
    """Draw the ANEES in bins of altitude, and tabulate it."""
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    # Every trial has rows of the bounds.
    altitude_m = of_estimator(campaign.table, FILTERED_BOUND, "altitude_m").mean(axis=0)
    edges = _edges_m(altitude_m)
    headings, rows = ["estimator"], []
    most, least = 0, SHOWN_ANEES[0]
    for name in names:
        nees = of_estimator(campaign.table, name, "nees")
        sound = with_nees(nees)
        if not sound.any():
            continue
        label = name if sound.all() else f"{name} ({sound.sum()} of {len(sound)} trials)"
        nees = nees[sound]
        most = max(most, len(nees))
        bins = anees_by_altitude(nees, altitude_m, edges.tolist())
        middle_km = [1e-3 * _middle(one.highest_m, one.lowest_m) for one in bins]
        means = [one.mean for one in bins]
        least = min(least, *means)
        axes.semilogy(middle_km, means, marker="o", ms=3, label=name, **line_style(name))
        headings[1:] = [f"{1e-3 * one.highest_m:.3g} to {1e-3 * one.lowest_m:.3g} km" for one in bins]
        cells = [number_cell(one.mean, concern=not one.consistent) for one in bins]
        rows.append((name, [Cell(label, label), *cells]))
    if not rows:
        return [Text("No estimator gives covariances.")]
    low, high = mean_interval(6, most)
    axes.axhspan(low, high, color="k", alpha=0.1)
    axes.set_xscale(altitude_scale(campaign))
    # Below the least by a tenth, so that its marker is not cut.
    axes.set_ylim(SHOWN_ANEES[0] if least >= SHOWN_ANEES[0] else 0.9 * least, SHOWN_ANEES[1])
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
    trials, fewer = _trials(campaign), []
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    for name in names:
        final_m = np.linalg.norm(of_estimator(campaign.table, name, "position_error_m")[:, -1], axis=-1)
        share = np.arange(1, len(final_m) + 1) / trials
        label = name
        if len(final_m) < trials:
            label = f"{name} ({len(final_m)} of {trials} trials)"
            fewer.append(f"{name} {len(final_m)} of {trials}")
        axes.step(np.sort(final_m), share, where="post", label=label, **line_style(name))
    axes.set_xscale("log")
    axes.set_xlabel("final position error, m")
    axes.set_ylabel("share of trials below")
    axes.set_ylim(0.0, 1.02)
    axes.grid(alpha=0.3)
    mark(figure.axes, names)
    caption = "Distribution of the final position error."
    if fewer:
        caption += f" Share of all trials; with a trajectory: {', '.join(fewer)} trials."
    return Drawing(inline_svg(figure, "final"), caption)


def _trials(campaign: Campaign) -> int:
    """Count the trials, those without a result among them."""
    return len(campaign.failed) + len(campaign.failures)


def _edges_m(altitude_m: FloatArray) -> FloatArray:
    """Edges (BINS + 1,) of the bins of altitude, falling, with all frames between."""
    high, low = altitude_m.max(), altitude_m.min()
    if low > 0.0:
        return np.geomspace(high * 1.001, low * 0.999, BINS + 1)
    # Low ground is below the mean sphere.
    margin = 1e-3 * max(high - low, -low, 1.0)
    return np.linspace(high + margin, low - margin, BINS + 1)


def _middle(high_m: float, low_m: float) -> float:
    return float(np.sqrt(high_m * low_m)) if low_m > 0.0 else 0.5 * (high_m + low_m)


def _drawing(figure: Figure, name: str, names: list[str], caption: str) -> Drawing:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
    figure.axes[-1].set_xlabel("altitude, km")
    # In the order of a descent, from high to low.
    figure.axes[-1].invert_xaxis()
    if figure.axes[-1].get_xscale() == "log":
        for which in (figure.axes[-1].xaxis.set_major_formatter, figure.axes[-1].xaxis.set_minor_formatter):
            which(FuncFormatter(_plain))
    mark(figure.axes, names)
    return Drawing(inline_svg(figure, name), caption)


def _plain(value: float, _position: int | None = None) -> str:
    """Label a logarithmic axis with plain numbers: 1, 2 and 5 of each power of ten."""
    first = f"{value:e}"[0]
    return f"{value:g}" if first in "125" else ""


def _altitude_km(table: pa.Table, name: str) -> FloatArray:
    return np.asarray(1e-3 * of_estimator(table, name, "altitude_m").mean(axis=0))


def _bounds_only(axes: Axes) -> tuple[list[Any], list[Any]]:
    """Legend of the bounds, for which the page has no buttons."""
    handles, labels = axes.get_legend_handles_labels()
    bounds = {label for label, _, _ in BOUNDS}
    chosen = [(handle, label) for handle, label in zip(handles, labels, strict=True) if label in bounds]
    return [handle for handle, _ in chosen], [label for _, label in chosen]
