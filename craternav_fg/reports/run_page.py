"""The page of one run."""

from typing import Any

import numpy as np
import pyarrow.compute as pc

from craternav_fg.config import read_text
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.pipeline.warnings import MAX_SQUARE, MAX_SQUARE_IN_IMAGES, too_large
from craternav_fg.plots.style import colour
from craternav_fg.reports.charts import (
    bounds_chart,
    consistency_chart,
    error_chart,
    residual_chart,
    scene_chart,
    seconds,
    sigma_chart,
    track_chart,
)
from craternav_fg.reports.page import Block, Cell, Choice, Page, Section, Table, Text, number_cell
from craternav_fg.reports.pictures import frame_pictures
from craternav_fg.reports.residuals import crater_table
from craternav_fg.runs.read import Run, describe_frames, read_residuals
from craternav_fg.runs.store import MARKER

# The errors of one run are correlated from frame to frame: an ANEES between these is inconclusive.
INCONCLUSIVE_ANEES = (2.0, 15.0)

# Estimators that are there to be compared with: what they get wrong is no fault of the run.
BASELINES = ("ekf_paper", "centre_smoother", "dead_reckoning")

ERROR_HEADINGS = (
    ("position_rms_m", "position RMS, m"),
    ("position_final_m", "final position, m"),
    ("velocity_rms_m_s", "velocity RMS, m/s"),
    ("attitude_rms_deg", "attitude RMS, deg"),
    ("attitude_final_deg", "final attitude, deg"),
    ("anees", "ANEES (6 expected)"),
)


_ANEES_EXPLAINED = (
    "The ANEES is the mean over the frames of e' S⁻¹ e, where e is the error of the pose and S its "
    "covariance. For consistent covariances, its mean over many descents is 6, the dimension of a pose. A "
    "larger value means that the estimator is overconfident. Errors along one descent are correlated, so "
    "a single run proves little: use a campaign (craternav montecarlo)."
)
_NIS_EXPLAINED = (
    "The NIS is the squared difference between a measurement and its prediction, relative to their "
    "covariances. It is 1 per dimension when the covariances are consistent and the errors independent. "
    "For rims and sun tilts from images, smaller values are expected: most of their error is the same in "
    "every frame that shows a crater, so the covariances contain it but the innovations do not show it. "
    f"A sensor whose NIS is above {MAX_SQUARE:g} ({MAX_SQUARE_IN_IMAGES:g} with images), and larger than "
    "chance explains, contradicts the others; the run warns of it. Check its unit, axes and time offset."
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
    pictures = frame_pictures(run, dataset)
    if pictures is not None:
        sections.append(Section("frames", "Frames", [pictures]))
    sections.append(Section("made", "Options and versions", [Text(read_text(run.path / MARKER))]))
    return Page(
        title=f"Run {run.path.resolve().name}",
        subtitle=f"{len(next(iter(run.trajectories.values())))} frames, data set {run.dataset}",
        sections=sections,
        series=[(name, colour(name)) for name in names],
        times_s=np.round(seconds(next(iter(run.trajectories.values()))), 3).tolist(),
    )


def shows_overconfidence(name: str, anees: float | None) -> bool:
    """Return whether the ANEES of a single run is of concern.

    Parameters
    ----------
    name : str
        Name of the estimator: baselines are known for it.
    anees : float or None

    Returns
    -------
    bool
    """
    return anees is not None and name not in BASELINES and anees > INCONCLUSIVE_ANEES[1]


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
            concern = field == "anees" and shows_overconfidence(name, value)
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
        caption += f" In a single run, ANEES values from {low:g} to {high:g} are inconclusive."
        known = [name for name in run.trajectories if name in BASELINES]
        if known:
            caption += f" Baselines, for comparison only: {', '.join(known)}."
    blocks.append(Table(headings, rows, caption))
    if with_truth:
        blocks.append(Text(_ANEES_EXPLAINED, title="What is the ANEES?"))
    if run.metrics.get("innovations"):
        blocks += nis_blocks(run.metrics["innovations"])
    if missing:
        blocks.append(Text(missing, warning=True))
    return blocks


def nis_blocks(found: dict[str, Any]) -> list[Block]:
    """Show a filter's innovations; those that the run's warnings name are highlighted.

    Parameters
    ----------
    found : dict
        Part `innovations` of metrics.json.

    Returns
    -------
    list of Block
        Table and explanation.
    """
    rows = []
    for sensor, nis in found["nis"].items():
        low, high, mean = nis["low"], nis["high"], nis["mean"]
        contradicts = too_large(mean, nis["dimension"], images=found.get("images", True))
        verdict = "as expected"
        if mean > high:
            verdict = "contradicts the others" if contradicts else "larger than stated"
        elif mean < low:
            verdict = "smaller than stated"
        cells = [
            Cell(sensor, sensor),
            number_cell(mean, concern=contradicts),
            Cell(f"{low:.2f} to {high:.2f}", low),
            number_cell(nis["dimension"]),
            Cell(verdict, verdict, contradicts),
        ]
        rows.append(("", cells))
    caption = (
        f"Normalised innovations squared (NIS) of {found['filter']} per dimension; no truth is needed. The "
        "interval is for errors that are independent from frame to frame. Those of images are not, so their "
        "NIS is smaller."
    )
    headings = ["sensor", "NIS per dimension", "95 % interval", "dimensions", "innovations"]
    return [Table(headings, rows, caption), Text(_NIS_EXPLAINED, title="What is the NIS?")]


def _errors(run: Run) -> list[Block]:
    assert run.truth is not None
    return [error_chart(run.trajectories, run.truth, run.metrics["craters_per_frame"])]


def _sigmas(run: Run) -> list[Block]:
    return [sigma_chart(run.trajectories, run.metrics["craters_per_frame"])]


def _bounds(run: Run) -> list[Block]:
    truth = run.truth
    assert truth is not None
    charts = [
        (name, bounds_chart(name, trajectory, truth))
        for name, trajectory in run.trajectories.items()
        if trajectory.pose_covariance is not None
    ]
    return [
        Text(
            "Position in east, north, up; attitude in body axes. With consistent covariances an error leaves "
            "the 3-sigma band in 1 of 370 frames."
        ),
        Choice(charts),
    ]


def _consistency(run: Run) -> list[Block]:
    assert run.truth is not None
    return [consistency_chart(run.trajectories, run.truth)]


def _map(run: Run, dataset: Dataset) -> list[Block]:
    given = (run.trajectories, run.truth, dataset.catalog, dataset.body)
    return [track_chart(*given), scene_chart(*given)]


def _residuals(run: Run) -> list[Block]:
    table = read_residuals(run.path)
    name = next(iter(run.trajectories))
    own = table.filter(pc.equal(table["estimator"], name))
    if len(own) == 0:
        return [Text("No rim was measured.")]
    t0 = int(next(iter(run.trajectories.values())).stamps_ns[0])
    return [residual_chart(own, t0, name), crater_table(own)]
