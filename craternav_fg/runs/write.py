"""Write a run's folder, all but its figures."""

import importlib.metadata
import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

import craternav_fg
from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.base import Descent
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.evaluation.truth_check import doubted_truth
from craternav_fg.pipeline.result import FILTER, Reconstruction
from craternav_fg.resection.shifted_group import ShiftedGroup
from craternav_fg.runs import store
from craternav_fg.runs.columns import list_column
from craternav_fg.runs.residuals import residuals_table
from craternav_fg.trajectory import Calibrated, Trajectory

# Software whose version the results depend on.
_PACKAGES = ("gtsam", "numpy", "numba")


def write_run(
    folder: Path,
    result: Reconstruction,
    *,
    dataset: str,
    truth: Trajectory | None,
    times_s: Mapping[str, float],
    wall_s: float,
) -> dict[str, Any]:
    """Write a run into an existing folder, all but its figures.

    Parameters
    ----------
    folder : Path
    result : Reconstruction
    dataset : str
        Path of the data set, absolute or relative to the run's folder.
    truth : Trajectory or None
        Ground truth, for the errors.
    times_s : mapping of str to float
        Wall time of each step.
    wall_s : float
        Wall time of the whole command so far.

    Returns
    -------
    dict
        Contents of metrics.json.
    """
    estimators: dict[str, dict[str, Any]] = {
        name: dict(metrics(t, truth).as_dict()) for name, t in result.trajectories.items()
    }
    descent = result.problems[0]
    for name, trajectory in result.trajectories.items():
        estimators[name]["rim_outlier_share"] = result.outlier_shares[name]
        if trajectory.calibrated is not None:
            each = [_calibrated(part.calibrated or Calibrated(), descent) for part in trajectory.segments()]
            estimators[name]["calibrated"] = each[-1]
            if len(each) > 1:
                estimators[name]["calibrated_segments"] = each
    summary = {
        "wall_s": wall_s,
        "times_s": dict(times_s),
        "craters_per_frame": [len(frame.rims) for frame in result.frames],
        "craters_expected_per_frame": result.expected_rims,
        "initial_state": result.origin,
        "initial_position": result.initial_position,
        "assumed_map_errors": None if result.map_errors is None else asdict(result.map_errors),
        "shifted_craters": _shifted(result.shifted_group, descent.catalog),
        "reinitialised_at_frames": list(result.reinitialised_at),
        "failures": dict(result.failures),
        "warnings": [*result.warnings, *_doubted_truth(result, truth)],
        "index": result.index_note,
        "innovations": _innovations(result),
        "estimators": estimators,
    }
    summary = _finite_or_none(summary)
    text = json.dumps(summary, indent=2, allow_nan=False)
    (folder / store.METRICS).write_text(f"{text}\n", encoding="utf-8")
    trajectories = dict(result.trajectories) if truth is None else {store.TRUTH: truth, **result.trajectories}
    for name, trajectory in trajectories.items():
        write_tum(folder / f"{name}.tum", trajectory)
    pq.write_table(_states(trajectories), folder / store.STATES)
    pq.write_table(residuals_table(result), folder / store.RESIDUALS)
    (folder / store.MARKER).write_bytes(_description(dataset, result).encode())
    return summary


def _shifted(group: ShiftedGroup | None, catalog: Catalog) -> dict[str, Any] | None:
    """Craters that were displaced alike, and by how much."""
    if group is None:
        return None
    names = [catalog.identifiers[row] for row in group.rows.tolist()]
    return {"east_m": group.east_m, "north_m": group.north_m, "craters": names}


def _finite_or_none(values: Any) -> Any:
    """Replace numbers that JSON does not have by None, in nested dicts and lists."""
    if isinstance(values, dict):
        return {key: _finite_or_none(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_finite_or_none(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def _doubted_truth(result: Reconstruction, truth: Trajectory | None) -> list[str]:
    """Warnings of a truth that the first trajectory contradicts by a mistake that is known."""
    if truth is None:
        return []
    first = next(iter(result.trajectories.values()))
    return doubted_truth(first, truth, result.problems[0].body.spin_rad_s)


def _description(dataset: str, result: Reconstruction) -> str:
    """Text of run.toml."""
    values = {
        "craternav_fg": craternav_fg.__version__,
        # A name on disk that is no UTF-8 cannot stand in TOML: its odd bytes are escaped, the run is kept.
        "dataset": dataset.encode("utf-8", "backslashreplace").decode(),
        "estimators": list(result.trajectories),
        "versions": {name: importlib.metadata.version(name) for name in _PACKAGES},
        "options": _without_none(result.options),
    }
    return "# What was run, on what, and how.\n" + tomli_w.dumps(values)


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out options that are None, which TOML cannot write."""
    return {
        key: _without_none(value) if isinstance(value, Mapping) else value
        for key, value in values.items()
        if value is not None
    }


def _innovations(result: Reconstruction) -> dict[str, Any] | None:
    """NIS of the filter's innovations by sensor, which need no truth; None without that filter."""
    found = result.innovations
    if found is None:
        return None
    return {"filter": FILTER, "images": result.predicted is not None, "nis": found.as_dict()}


def _calibrated(found: Calibrated, descent: Descent) -> dict[str, Any]:
    """Return the estimated calibration as plain data, craters by their identifiers."""
    identifiers = descent.catalog.identifiers
    out: dict[str, Any] = {}
    if found.mounting_rad is not None:
        out["mounting_deg"], out["mounting_sigma_deg"] = (
            np.degrees(part).tolist() for part in found.mounting_rad
        )
    if found.time_offset_s is not None:
        out["time_offset_s"], out["time_offset_sigma_s"] = found.time_offset_s
    if found.map_errors is not None:
        out["map_errors"] = {
            identifiers[row]: {"error": error.tolist(), "sigma": sigma.tolist()}
            for row, (error, sigma) in found.map_errors.items()
        }
    if found.intrinsics is not None:
        out["intrinsics"], out["intrinsics_sigma"] = (part.tolist() for part in found.intrinsics)
    if found.sensor_biases is not None:
        out["sensor_biases"] = {
            name: {"bias": bias.tolist(), "sigma": sigma.tolist(), "unit": _unit(descent, name, len(bias))}
            for name, (bias, sigma) in found.sensor_biases.items()
        }
    return out


def _unit(descent: Descent, name: str, size: int) -> str | None:
    """Return the unit of a sensor's biases where each is that of a column, else None."""
    sensor = next(one for one in descent.sensors if one.name == name)
    units = [column.unit for column in sensor.columns(sensor.settings)]
    return units[0] if len(units) == size and len(set(units)) == 1 else None


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory in evo's TUM format: time in s, position in m, quaternion x y z w.

    Parameters
    ----------
    path : Path
    trajectory : Trajectory
    """
    q = np.roll(frames.to_quaternion_wxyz(trajectory.gRb), -1, axis=1)
    rows = []
    for stamp, P, quaternion in zip(trajectory.stamps_ns, trajectory.gP, q, strict=True):
        seconds, rest = divmod(int(stamp), 1_000_000_000)
        numbers = " ".join(repr(float(x)) for x in (*P, *quaternion))
        rows.append(f"{seconds}.{rest:09d} {numbers}\n")
    path.write_text("".join(rows), encoding="ascii")


def _states(trajectories: Mapping[str, Trajectory]) -> pa.Table:
    """States and covariances of all trajectories, one row per estimator and frame."""
    parts = []
    for name, t in trajectories.items():
        k = len(t)
        columns = {
            "estimator": pa.array([name] * k),
            "stamp_ns": pa.array(t.stamps_ns),
            "position_m": list_column(t.gP),
            "quaternion_wxyz": list_column(frames.to_quaternion_wxyz(t.gRb)),
            "velocity_m_s": list_column(t.gV),
            "bias": list_column(t.bias),
        }
        for field, size in (("pose_covariance", 6), ("velocity_covariance", 3), ("bias_covariance", 6)):
            covariance = getattr(t, field)
            missing = pa.nulls(k, pa.list_(pa.float64(), size**2))
            columns[field] = missing if covariance is None else list_column(covariance.reshape(k, size**2))
        parts.append(pa.table(columns))
    return pa.concat_tables(parts)
