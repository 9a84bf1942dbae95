"""The page of one run."""

from typing import Any

import pyarrow.compute as pc
from matplotlib.figure import Figure

from craternav_fg.config import read_text
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.plots.style import colour
from craternav_fg.plots.trajectories import (
    draw_bounds,
    draw_consistency,
    draw_descent,
    draw_errors,
    draw_sigmas,
)
from craternav_fg.reports.page import Block, Cell, Choice, Drawing, Page, Section, Table, Text, number_cell
from craternav_fg.reports.pictures import frame_pictures
from craternav_fg.reports.residuals import crater_table, draw_residuals
from craternav_fg.reports.svg import WIDTH_IN, identifier, inline_svg, mark
from craternav_fg.runs.read import Run, describe_frames, read_residuals
from craternav_fg.runs.store import MARKER

# The errors of one run are correlated from frame to frame: an ANEES between these is inconclusive.
INCONCLUSIVE_ANEES = (2.0, 15.0)

ERROR_HEADINGS = (
    ("position_rms_m", "position RMS, m"),
    ("position_final_m", "final position, m"),
    ("velocity_rms_m_s", "velocity RMS, m/s"),
    ("attitude_rms_deg", "attitude RMS, deg"),
    ("attitude_final_deg", "final attitude, deg"),
    ("anees", "ANEES (6 expected)"),
)


def run_page(run: Run) -> Page:
    """Put together the page of a run.

    Parameters
    ----------
    run : Run
        Its data set is read for the map, if it is still there.

    Returns
    -------
    Page

    Raises
    ------
    InputError
        When a file of the run is missing or damaged.
    """
    dataset, missing = _dataset(run)
    names = tuple(run.trajectories)
    sections = [Section("summary", "Summary", _summary(run, missing))]
    if run.truth is not None:
        sections.append(Section("errors", "Errors", _errors(run)))
        sections.append(Section("bounds", "Errors and 3 sigma", _bounds(run)))
        sections.append(Section("consistency", "Consistency", _consistency(run)))
    else:
        sections.append(Section("sigmas", "Standard deviations", _sigmas(run)))
    if dataset is not None:
        sections.append(Section("map", "Trajectory and craters", _map(run, dataset)))
    sections.append(Section("residuals", "Residuals", _residuals(run)))
    pictures = frame_pictures(run.path)
    if pictures is not None:
        sections.append(Section("frames", "Frames", [pictures]))
    sections.append(Section("made", "Options and versions", [Text(read_text(run.path / MARKER))]))
    return Page(
        title=f"Run {run.path.resolve().name}",
        subtitle=f"{len(next(iter(run.trajectories.values())))} frames, data set {run.dataset}",
        sections=sections,
        series=[(name, colour(name)) for name in names],
    )


def _dataset(run: Run) -> tuple[Dataset | None, str]:
    try:
        return Dataset.open(run.dataset), ""
    except InputError as error:
        return None, f"no map: {error}"


def _summary(run: Run, missing: str) -> list[Block]:
    rows = []
    seconds = run.metrics["times_s"]
    with_truth = run.truth is not None
    for name in run.trajectories:
        values: dict[str, Any] = run.metrics["estimators"][name]
        cells = [Cell(name, name)]
        for field, _ in ERROR_HEADINGS if with_truth else ():
            value = values[field]
            concern = field == "anees" and value is not None
            concern = concern and not INCONCLUSIVE_ANEES[0] < value < INCONCLUSIVE_ANEES[1]
            cells.append(number_cell(value, concern=concern))
        rows.append((name, [*cells, number_cell(seconds.get(name))]))
    headings = ["estimator", *(h for _, h in ERROR_HEADINGS if with_truth), "time, s"]
    # Runs of version 0.1 hold their failures only.
    warnings = run.metrics.get("warnings", run.metrics["failures"].values())
    blocks: list[Block] = [Text(warning, warning=True) for warning in warnings]
    if not with_truth:
        blocks.append(Text("No ground truth: the errors are unknown."))
    caption = f"{describe_frames(run.metrics)}."
    if with_truth:
        low, high = INCONCLUSIVE_ANEES
        caption += f" The ANEES of a single run scatters: values from {low:g} to {high:g} are inconclusive."
    blocks.append(Table(headings, rows, caption))
    if run.metrics.get("innovations"):
        blocks.append(_nis(run.metrics["innovations"]))
    if missing:
        blocks.append(Text(missing, warning=True))
    return blocks


def _nis(found: dict[str, Any]) -> Table:
    rows = []
    for sensor, nis in found["nis"].items():
        low, high = nis["low"], nis["high"]
        cells = [
            Cell(sensor, sensor),
            number_cell(nis["mean"], concern=not low <= nis["mean"] <= high),
            Cell(f"{low:.2f} to {high:.2f}", low),
            number_cell(nis["dimension"]),
        ]
        rows.append(("", cells))
    caption = (
        f"Normalised innovations squared (NIS) of {found['filter']}, 1 expected per dimension: the squared "
        "difference between measurement and prediction, relative to their covariances. It needs no ground "
        "truth. Above the interval the covariances are too small; below it they are too large, or they "
        "contain errors that all frames have in common."
    )
    return Table(["sensor", "NIS per dimension", "95 % interval", "dimensions"], rows, caption)


def _errors(run: Run) -> list[Block]:
    assert run.truth is not None
    figure = draw_errors(run.trajectories, run.truth, run.metrics["craters_per_frame"])
    return [
        _drawing(figure, "errors", run, 8.0, "Norms of the errors, and the number of rims in each frame.")
    ]


def _sigmas(run: Run) -> list[Block]:
    figure = draw_sigmas(run.trajectories, run.metrics["craters_per_frame"])
    return [_drawing(figure, "sigmas", run, 8.0, "Standard deviations that each estimator claims.")]


def _bounds(run: Run) -> list[Block]:
    assert run.truth is not None
    drawings = []
    for name, trajectory in run.trajectories.items():
        if trajectory.pose_covariance is None:
            continue
        figure = draw_bounds({name: trajectory}, run.truth)
        for axes in figure.axes:
            # The tab and the axes say it.
            axes.set_title("")
        drawings.append((name, _drawing(figure, f"bounds-{identifier(name)}", run, 6.5, "")))
    return [
        Text(
            "Position in east, north, up; attitude in body axes. With consistent covariances an error leaves "
            "the 3-sigma band in 1 of 370 frames."
        ),
        Choice(drawings),
    ]


def _consistency(run: Run) -> list[Block]:
    assert run.truth is not None
    figure = draw_consistency(run.trajectories, run.truth)
    legend = figure.axes[0].get_legend()
    if legend is not None:
        legend.remove()
    caption = "NEES of the pose, e' S⁻¹ e, at each frame; grey: 95 % interval of a consistent estimator."
    return [_drawing(figure, "consistency", run, 4.0, caption)]


def _map(run: Run, dataset: Dataset) -> list[Block]:
    first = next(iter(run.trajectories.values()))
    figure = draw_descent(first, run.truth, dataset.catalog, dataset.body)
    caption = f"Altitude and ground track of {next(iter(run.trajectories))} over the catalogue's craters."
    return [_drawing(figure, "map", run, 5.0, caption)]


def _residuals(run: Run) -> list[Block]:
    table = read_residuals(run.path)
    name = next(iter(run.trajectories))
    own = table.filter(pc.equal(table["estimator"], name))
    if len(own) == 0:
        return [Text("No rim was measured.")]
    t0 = int(next(iter(run.trajectories.values())).stamps_ns[0])
    figure = draw_residuals(own, t0)
    caption = (
        f"χ² per degree of freedom of each rim at the poses of {name}: 1 on average if the covariances are "
        "consistent, less where few rims determine the pose. Crosses: matches rejected as outliers."
    )
    return [_drawing(figure, "residuals", run, 3.6, caption), crater_table(own)]


def _drawing(figure: Figure, name: str, run: Run, height_in: float, caption: str) -> Drawing:
    # The buttons of the page are the legend.
    figure.legends.clear()
    figure.set_size_inches(WIDTH_IN, height_in)
    mark(figure.axes, run.trajectories)
    return Drawing(inline_svg(figure, name), caption)
