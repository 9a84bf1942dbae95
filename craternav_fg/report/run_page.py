"""The page of one run."""

from typing import Any

import pyarrow.compute as pc
from matplotlib.figure import Figure

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
from craternav_fg.report.page import Block, Cell, Choice, Drawing, Page, Section, Table, Text, number_cell
from craternav_fg.report.pictures import frame_pictures
from craternav_fg.report.residuals import crater_table, draw_residuals
from craternav_fg.report.svg import WIDTH_IN, inline_svg, mark
from craternav_fg.runs.read import Run, read_residuals
from craternav_fg.runs.store import MARKER

# Errors along one descent hang together: only an ANEES beyond these says something of a single run.
DOUBTFUL_ANEES = (2.0, 15.0)

ERROR_HEADINGS = (
    ("position_rms_m", "position RMS, m"),
    ("position_final_m", "at the end, m"),
    ("velocity_rms_m_s", "velocity RMS, m/s"),
    ("attitude_rms_deg", "attitude RMS, deg"),
    ("attitude_final_deg", "at the end, deg"),
    ("anees", "ANEES (honest: 6)"),
)


def run_page(run: Run) -> Page:
    """Put together the page of a run.

    Parameters
    ----------
    run : Run
        Its data set is read for the map, when it is still where it was.

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
        sections.append(Section("sigmas", "What each believes", _sigmas(run)))
    if dataset is not None:
        sections.append(Section("map", "Trajectory and craters", _map(run, dataset)))
    sections.append(Section("residuals", "Residuals", _residuals(run)))
    pictures = frame_pictures(run.path)
    if pictures is not None:
        sections.append(Section("frames", "Frames", [pictures]))
    sections.append(Section("made", "How it was made", [Text((run.path / MARKER).read_text("utf-8"))]))
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
            doubtful = (
                field == "anees" and value is not None
                and not DOUBTFUL_ANEES[0] < value < DOUBTFUL_ANEES[1]
            )  # fmt: skip
            cells.append(number_cell(value, concern=doubtful))
        rows.append((name, [*cells, number_cell(seconds.get(name))]))
    headings = ["estimator", *(h for _, h in ERROR_HEADINGS if with_truth), "time, s"]
    counts = run.metrics["craters_per_frame"]
    blocks: list[Block] = [Text(message, warning=True) for message in run.metrics["failures"].values()]
    if not with_truth:
        blocks.append(Text("Without ground truth: errors are not known."))
    caption = (
        f"{len(counts)} frames with {min(counts)} to {max(counts)} rims each. "
        + "The ANEES of one run scatters: between 2 and 15 it is no verdict." * with_truth
    )
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
        f"Normalised innovations squared of {found['filter']}: how far each sensor lies from what was "
        "predicted, by the claimed covariances. No truth is needed. Above the interval covariances are too "
        "small; below it they are too large, or hold errors that are the same in every frame."
    )
    return Table(["sensor", "NIS per dimension", "honest, 95 %", "dimensions"], rows, caption)


def _errors(run: Run) -> list[Block]:
    assert run.truth is not None
    figure = draw_errors(run.trajectories, run.truth, run.metrics["craters_per_frame"])
    return [_drawing(figure, "errors", run, 8.0, "Norms of the errors, and the rims measured in each frame.")]


def _sigmas(run: Run) -> list[Block]:
    figure = draw_sigmas(run.trajectories, run.metrics["craters_per_frame"])
    return [_drawing(figure, "sigmas", run, 8.0, "What each estimator believes its errors to be, 1 sigma.")]


def _bounds(run: Run) -> list[Block]:
    assert run.truth is not None
    drawings = []
    for name, trajectory in run.trajectories.items():
        if trajectory.pose_covariance is None:
            continue
        figure = draw_bounds(name, trajectory, run.truth)
        for axes in figure.axes:
            # What it is of, tab and axes say already.
            axes.set_title("")
        drawings.append((name, _drawing(figure, f"bounds-{name}", run, 6.5, "")))
    return [
        Text("Position in east, north, up. With an honest covariance the line leaves the band once in 370."),
        Choice(drawings),
    ]  # fmt: skip


def _consistency(run: Run) -> list[Block]:
    assert run.truth is not None
    figure = draw_consistency(run.trajectories, run.truth)
    legend = figure.axes[0].get_legend()
    if legend is not None:
        legend.remove()
    caption = "e' S⁻¹ e of the pose at each frame; grey: where 95 % of an honest estimator's lie."
    return [_drawing(figure, "consistency", run, 4.0, caption)]


def _map(run: Run, dataset: Dataset) -> list[Block]:
    first = next(iter(run.trajectories.values()))
    figure = draw_descent(first, run.truth, dataset.catalog, dataset.body)
    caption = (
        f"Altitude, and the ground track of {next(iter(run.trajectories))} over the catalogue's craters."
    )
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
        f"χ² of each rim against the pose of {name}, per degree of freedom: near 1 where its covariance is "
        "honest (below, where the pose follows the rims). Crosses: rejected as wrong matches."
    )
    return [_drawing(figure, "residuals", run, 3.6, caption), crater_table(own)]


def _drawing(figure: Figure, name: str, run: Run, height_in: float, caption: str) -> Drawing:
    # The page's buttons are the legend of its series.
    figure.legends.clear()
    figure.set_size_inches(WIDTH_IN, height_in)
    mark(figure.axes, run.trajectories)
    return Drawing(inline_svg(figure, name), caption)
