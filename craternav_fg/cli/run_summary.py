"""What the commands on descents print of a run."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.table import Table

from craternav_fg.cli.terminal import note, out, say, table_of_numbers, tell, three_digits, warn
from craternav_fg.runs.compare import from_reference_m
from craternav_fg.runs.read import Run, describe_frames
from craternav_fg.runs.store import FIGURES, METRICS

# Metrics of an estimator and their headings.
_COLUMNS = {
    "position_rms_m": "pos.\nRMS\nm",
    "position_final_m": "pos.\nfinal\nm",
    "velocity_rms_m_s": "vel.\nRMS\nm/s",
    "attitude_rms_deg": "att.\nRMS\ndeg",
    "attitude_final_deg": "att.\nfinal\ndeg",
    "anees": "ANEES",
}
_LEGEND = "pos., vel., att.: errors of position, velocity and attitude; ANEES of the pose: 6 expected"


def show_run(folder: Path, summary: dict[str, Any], as_json: bool) -> None:
    """Print the warnings of a run, and its metrics or the JSON of its summary.

    Parameters
    ----------
    folder : Path
    summary : dict
        Contents of metrics.json.
    as_json : bool
    """
    if summary["index"]:
        note(f"index: {summary['index']}")
    for warning in summary["warnings"]:
        warn(warning)
    if as_json:
        out.print_json(json.dumps(summary))
        return
    if any(values["position_rms_m"] is not None for values in summary["estimators"].values()):
        table = table_of_numbers("estimator", _COLUMNS.values())
        for name, values in summary["estimators"].items():
            table.add_row(name, *_metrics(values))
        out.print(table)
        tell(_LEGEND)
    else:
        say("no ground truth, so no errors: figures/sigmas.png shows the stated standard deviations,")
        say(f"craternav compare {folder} shows how far the estimates differ")
    if summary["innovations"]:
        tell(_innovations(summary["innovations"]))
    for name, values in summary["estimators"].items():
        for line in calibration_lines(values, summary["reinitialised_at_frames"]):
            tell(f"{name} estimated {line}")
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["times_s"].items())
    tell(describe_frames(summary))
    tell(f"wall time {summary['wall_s']:.0f} s ({seconds})")
    for path in sorted(folder.glob("*")):
        files = sorted(p.name for p in path.iterdir()) if path.name == FIGURES else []
        say(f"  {path}{'/: ' + ', '.join(files) if files else ''}")


def comparison(run: Run) -> dict[str, dict[str, Any]]:
    """Return the metrics of a run's estimators, and their distance from the smoother.

    Parameters
    ----------
    run : Run

    Returns
    -------
    dict of str to dict
        By estimator: its entry in metrics.json, and `from_smoother_rms_m`, RMS distance of the positions from
        those of the smoother, None without it. This distance needs no ground truth.
    """
    return {
        name: {**run.metrics["estimators"][name], "from_smoother_rms_m": from_reference_m(run, name)}
        for name in run.trajectories
    }


def show_comparison(compared: Iterable[tuple[str, dict[str, dict[str, Any]]]]) -> None:
    """Print a table of estimators for each run.

    Parameters
    ----------
    compared : iterable of (str, dict)
        Folders of runs, and what `comparison` gives of each.
    """
    for folder, estimators in compared:
        say(folder)
        out.print(_comparison_table(estimators))
    tell(_LEGEND)
    tell("diff: RMS distance between the positions and those of the smoother")


def calibration_lines(values: dict[str, Any], reinitialised_at: Iterable[int]) -> list[str]:
    """Write what an estimator has calibrated, for each segment if there are several.

    Parameters
    ----------
    values : dict
        Entry of the estimator in metrics.json.
    reinitialised_at : iterable of int
        First frames of the segments after the first.

    Returns
    -------
    list of str
        Empty when it has calibrated nothing.
    """
    if not values.get("calibrated_segments"):
        return [calibration_line(values["calibrated"])] if values.get("calibrated") else []
    parts = zip([0, *reinitialised_at], values["calibrated_segments"], strict=True)
    return [f"from frame {first} on {calibration_line(found)}" for first, found in parts]


def calibration_line(found: dict[str, Any]) -> str:
    """Write an estimated calibration with its standard deviations.

    Parameters
    ----------
    found : dict
        Entry `calibrated` of an estimator in metrics.json.

    Returns
    -------
    str
    """
    parts = []
    if "mounting_deg" in found:
        axes = zip(found["mounting_deg"], found["mounting_sigma_deg"], strict=True)
        turns = ", ".join(f"{value:.3f} ± {sigma:.3f}" for value, sigma in axes)
        parts.append(f"a correction of the camera-IMU rotation by {turns} deg about the axes of b")
    if "time_offset_s" in found:
        offset_ms, sigma_ms = 1e3 * found["time_offset_s"], 1e3 * found["time_offset_sigma_s"]
        parts.append(f"a camera-IMU time offset of {offset_ms:.1f} ± {sigma_ms:.1f} ms")
    if "intrinsics" in found:
        (share, x, y, k1), (s_share, s_x, s_y, s_k1) = found["intrinsics"], found["intrinsics_sigma"]
        parts.append(
            f"a focal length {100.0 * share:.3f} ± {100.0 * s_share:.3f} % longer, the principal point "
            f"{x:.2f} ± {s_x:.2f}, {y:.2f} ± {s_y:.2f} px aside, k1 {k1:.5f} ± {s_k1:.5f}"
        )
    if "map_errors" in found:
        parts.append(f"the map errors of {len(found['map_errors'])} craters (in {METRICS})")
    for name, one in found.get("sensor_biases", {}).items():
        pairs = zip(one["bias"], one["sigma"], strict=True)
        values = ", ".join(f"{bias:.3g} ± {sigma:.2g}" for bias, sigma in pairs)
        unit = one.get("unit")
        parts.append(f"a bias of {name} of {values}{f' {unit}' if unit else ''}")
    return "; ".join(parts)


def _metrics(values: dict[str, Any]) -> list[str]:
    return [three_digits(values[field]) for field in _COLUMNS]


def _comparison_table(estimators: dict[str, dict[str, Any]]) -> Table:
    table = table_of_numbers("estimator", [*_COLUMNS.values(), "diff\nm"])
    for name, values in estimators.items():
        diff_m = values["from_smoother_rms_m"]
        # Rounded first: less than a millimetre is rounding of the estimators.
        table.add_row(name, *_metrics(values), three_digits(None if diff_m is None else round(diff_m, 3)))
    return table


def _innovations(found: dict[str, Any]) -> str:
    """Write the NIS of each sensor with its 95 % interval for a consistent filter."""
    parts = (
        f"{sensor} {three_digits(nis['mean'])} ({nis['low']:.2f} to {nis['high']:.2f})"
        for sensor, nis in found["nis"].items()
    )
    return (
        f"NIS per dimension of {found['filter']} (95 % interval): {', '.join(parts)}; 1 expected, less where "
        "errors are correlated between frames, as in images"
    )
