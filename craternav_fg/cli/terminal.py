"""What the command line shows: tables of results, warnings, progress."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from craternav_fg.pipeline.reconstruct import Progress as Report
from craternav_fg.runs.read import Run
from craternav_fg.runs.store import METRICS

err = Console(stderr=True)
out = Console()

LEGEND = "errors of position (m), velocity (m/s), attitude (deg); ANEES of the pose, honest: 6"


def say(text: str) -> None:
    """Print a line as it is: to be copied, not wrapped or coloured."""
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def number(value: float | None) -> str:
    """Write a number with three digits, a dash for none."""
    if value is None:
        return "-"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.3g}"


def table_of_estimators() -> Table:
    """Give an empty table with a column for each figure of `row`."""
    # With padding that neighbours share, the longest name and every column fit into 80 characters.
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, collapse_padding=True)
    table.add_column("estimator", no_wrap=True)
    for heading in ("RMS m", "end m", "RMS m/s", "RMS deg", "end deg", "ANEES"):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def row_of_estimator(name: str, values: dict[str, Any]) -> list[str]:
    """Give the cells of an estimator's metrics."""
    fields = (
        "position_rms_m",
        "position_final_m",
        "velocity_rms_m_s",
        "attitude_rms_deg",
        "attitude_final_deg",
        "anees",
    )
    return [name, *(number(values[field]) for field in fields)]


def from_smoother(run: Run, name: str) -> float | None:
    """Give an estimator's RMS distance from the smoother's positions: there without ground truth, too."""
    if "smoother" not in run.trajectories:
        return None
    step = run.trajectories[name].gP - run.trajectories["smoother"].gP
    return float(np.sqrt(np.mean(np.sum(step**2, axis=1))))


def show_run(folder: Path, summary: dict[str, Any], as_json: bool) -> None:
    """Print a run's warnings, and its figures or the JSON of its summary."""
    if summary["index"]:
        err.print(f"craternav: index: {summary['index']}", highlight=False, markup=False, soft_wrap=True)
    for warning in summary["warnings"]:
        err.print(f"craternav: warning: {warning}", style="yellow", highlight=False, soft_wrap=True)
    if as_json:
        out.print_json(json.dumps(summary))
        return
    if any(values["position_rms_m"] is not None for values in summary["estimators"].values()):
        table = table_of_estimators()
        for name, values in summary["estimators"].items():
            table.add_row(*row_of_estimator(name, values))
        out.print(table)
        say(LEGEND)
    else:
        say("no ground truth: figures/sigmas.png shows what each estimator believes of its errors,")
        say(f"craternav compare {folder} how far they lie apart")
    if summary["innovations"]:
        say(innovations_line(summary["innovations"]))
    for name, values in summary["estimators"].items():
        if "calibrated" in values:
            say(f"{name} found {calibrated_line(values['calibrated'])}")
    counts = summary["craters_per_frame"]
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["times_s"].items())
    say(f"{len(counts)} frames with {min(counts)} to {max(counts)} rims each")
    say(f"{summary['wall_s']:.0f} s of computing ({seconds})")
    for path in sorted(folder.glob("*")):
        what = sorted(p.name for p in path.iterdir()) if path.name == "figures" else []
        say(f"  {path}{'/: ' + ', '.join(what) if what else ''}")


def innovations_line(found: dict[str, Any]) -> str:
    """Write the NIS of each sensor with the interval in which it lies if the filter is consistent."""
    parts = (
        f"{sensor} {number(nis['mean'])} ({nis['low']:.2f}-{nis['high']:.2f})"
        for sensor, nis in found["nis"].items()
    )
    return f"NIS per dimension of {found['filter']}, honest: 1: {', '.join(parts)}"


def calibrated_line(found: dict[str, Any]) -> str:
    """Write what an estimator found beside the trajectory, with standard deviations."""
    parts = []
    if "mounting_deg" in found:
        axes = zip(found["mounting_deg"], found["mounting_sigma_deg"], strict=True)
        turns = ", ".join(f"{value:.3f} ± {sigma:.3f}" for value, sigma in axes)
        parts.append(f"the camera's mounting turned by {turns} deg")
    if "image_delay_s" in found:
        delay_ms, sigma_ms = 1e3 * found["image_delay_s"], 1e3 * found["image_delay_sigma_s"]
        parts.append(f"images {delay_ms:.1f} ± {sigma_ms:.1f} ms later than stamped")
    if "map_errors" in found:
        parts.append(f"map errors of {len(found['map_errors'])} craters, in {METRICS}")
    return "; ".join(parts)


def show_poses(values: dict[str, Any]) -> None:
    """Print the poses of one image and what was left out, as `static.files.as_plain_data` gives them."""
    if values["wrong"]:
        say(f"left out as wrong matches: {', '.join(values['wrong'])}")
    if values["status"] not in ("solved", "ambiguous"):
        return
    for found in values["poses"]:
        gP, attitude, sigma_m, sigma_deg = (
            ", ".join(f"{number:{form}}" for number in found[name])
            for name, form in (
                ("position_m", ".2f"),
                ("attitude_wxyz", ".8f"),
                ("position_sigma_m", ".3g"),
                ("attitude_sigma_deg", ".3g"),
            )
        )
        say(
            f"probability {found['probability']:.3f}: latitude {found['latitude_deg']:.5f}, longitude "
            f"{found['longitude_deg']:.5f} deg, altitude {found['altitude_m']:.1f} m"
        )
        say(f"  position in g {gP} m; sigma {sigma_m} m")
        say(f"  attitude gRb (w, x, y, z) {attitude}; sigma in b {sigma_deg} deg")


class _Rate(ProgressColumn):
    """Steps per minute."""

    def render(self, task: Task) -> Text:
        """Write the rate of late, nothing before it is known."""
        return Text("" if task.speed is None else f"{60.0 * task.speed:.3g}/min")


@contextmanager
def bar() -> Iterator[Report]:
    """Give a progress report that draws bars on stderr, and nothing where that is no terminal."""
    columns = (
        TextColumn("{task.description:24}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, disable=not err.is_terminal) as progress:
        tasks: dict[str, TaskID] = {}

        def report(what: str, done: int, total: int) -> None:
            # One bar for all estimators: their name changes, their number does not.
            kind = what.split()[0]
            if kind not in tasks:
                # What was done before does not count for the rate.
                tasks[kind] = progress.add_task(what, total=total, completed=done)
            progress.update(tasks[kind], description=what, completed=done, total=total)

        yield report
