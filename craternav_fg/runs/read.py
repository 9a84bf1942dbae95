"""Read a run's folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
from pydantic import Field

from craternav_fg import frames
from craternav_fg.config import ResultSection, load_toml, read_json
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import present_name
from craternav_fg.files import exists
from craternav_fg.runs import store
from craternav_fg.runs.columns import check_names, list_values, with_present_names
from craternav_fg.runs.schemas import COVARIANCES, RESIDUALS, RESIDUALS_OF_IMAGES, STATES
from craternav_fg.tables.parquet import read_parquet, require_finite
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# What version 0.1 called parts of metrics.json, metrics of an estimator, its calibration, and columns of
# residuals.parquet.
_FORMER_PARTS = {"resumed_at_frames": "reinitialised_at_frames"}
_FORMER_METRICS = {"rim_misfit_share": "rim_outlier_share"}
_FORMER_CALIBRATED = {"image_delay_s": "time_offset_s", "image_delay_sigma_s": "time_offset_sigma_s"}
_FORMER_COLUMNS = {"taken_for": "reassociated_with", "gain": "slope_contrast"}
# Columns of states.parquet that are no numbers of a state.
_KEYS = ("estimator", "stamp_ns")
# Length below which a quaternion has no direction.
_MIN_QUATERNION = 1e-6


class _Description(ResultSection):
    """What is read of run.toml."""

    dataset: str


class _EstimatorMetrics(ResultSection):
    position_rms_m: float | None
    position_final_m: float | None
    velocity_rms_m_s: float | None
    attitude_rms_deg: float | None
    attitude_final_deg: float | None
    anees: float | None
    calibrated: dict[str, Any] | None = None
    calibrated_segments: list[dict[str, Any]] | None = None


class _Nis(ResultSection):
    mean: float
    low: float
    high: float
    dimension: int


class _Innovations(ResultSection):
    filter: str
    # Runs of former versions do not say; rims from images have the wider limits.
    images: bool = True
    nis: dict[str, _Nis]


class _Metrics(ResultSection):
    """What is read of metrics.json."""

    wall_s: float
    times_s: dict[str, float]
    craters_per_frame: Annotated[tuple[int, ...], Field(min_length=1)]
    failures: dict[str, str]
    warnings: tuple[str, ...] = ()
    innovations: _Innovations | None = None
    estimators: dict[str, _EstimatorMetrics]


@dataclass(frozen=True)
class Run:
    """A run read back.

    Attributes
    ----------
    path : Path
        Its folder.
    metrics : dict
        Contents of metrics.json.
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory or None
        Ground truth, if the data set has it.
    dataset : Path
        Folder of the data set that was reconstructed.
    """

    path: Path
    metrics: dict[str, Any]
    trajectories: Mapping[str, Trajectory]
    truth: Trajectory | None
    dataset: Path


def read_run(folder: Path | str) -> Run:
    """Read a run.

    Parameters
    ----------
    folder : Path or str

    Returns
    -------
    Run

    Raises
    ------
    InputError
        When the folder is no run's, or a file of it is missing or damaged.
    """
    path = Path(folder)
    if not exists(path):
        raise InputError(path, "folder is missing")
    if not exists(path / store.MARKER):
        raise InputError(path, f"expected a run's folder, found no {store.MARKER} in it")
    for name in (store.METRICS, store.STATES):
        if not exists(path / name):
            raise InputError(path / name, "is missing from the run")
    description = load_toml(path / store.MARKER, _Description)
    metrics = read_json(path / store.METRICS, _Metrics)
    trajectories = _trajectories(path / store.STATES)
    _rename(metrics, _FORMER_PARTS)
    for part in ("estimators", "times_s", "failures"):
        metrics[part] = {present_name(name): each for name, each in metrics[part].items()}
    for values in metrics["estimators"].values():
        _rename(values, _FORMER_METRICS)
        _rename(values.get("calibrated") or {}, _FORMER_CALIBRATED)
    truth = trajectories.pop(store.TRUTH, None)
    _check_agreement(path, metrics, trajectories)
    return Run(path, metrics, trajectories, truth, path / description.dataset)


def _check_agreement(path: Path, metrics: Mapping[str, Any], trajectories: Mapping[str, Trajectory]) -> None:
    """Refuse a run whose files are not of the same estimators and frames."""
    check_names(path / store.METRICS, [*metrics["estimators"], *metrics["times_s"]])
    if set(metrics["estimators"]) != set(trajectories) or not trajectories:
        here, there = sorted(metrics["estimators"]), sorted(trajectories)
        problem = f"expected the estimators of {store.METRICS}, {here}, found {there}"
        raise InputError(path / store.STATES, problem, column="estimator")
    frames_there = len(next(iter(trajectories.values())))
    if len(metrics["craters_per_frame"]) != frames_there:
        problem = f"expected one number for each of {frames_there} frames, found"
        raise InputError(
            path / store.METRICS,
            f"{problem} {len(metrics['craters_per_frame'])}",
            column="craters_per_frame",
        )


def read_map_errors(run: Run) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the errors of the map that an estimator of a run has found.

    Parameters
    ----------
    run : Run

    Returns
    -------
    dict of str to (ndarray, ndarray), shape (6,) each
        By the crater's identifier, see `trajectory.Calibrated.map_errors`.

    Raises
    ------
    InputError
        When no estimator has estimated them, or numbers are wrong.
    """
    path = run.path / store.METRICS
    every = [_map_errors(values) for values in run.metrics["estimators"].values()]
    found = next((parts for parts in every if parts), None)
    if found is None:
        problem = "expected errors of the map, found none: reconstruct with -e map_refining_smoother"
        raise InputError(path, problem)
    errors: dict[str, tuple[FloatArray, FloatArray]] = {}
    try:
        for name, one in (item for part in found for item in part.items()):
            error, sigma = (np.array(one[key], dtype=np.float64) for key in ("error", "sigma"))
            # Segments know nothing of each other: a crater's errors are those of the one that saw it best.
            if name not in errors or np.sum(sigma**2) < np.sum(errors[name][1] ** 2):
                errors[str(name)] = (error, sigma)
    except (TypeError, ValueError, KeyError, AttributeError):
        raise InputError(
            path, "expected six errors and six sigmas for each crater", column="map_errors"
        ) from None
    for name, (error, sigma) in errors.items():
        right = error.shape == (6,) and sigma.shape == (6,) and np.isfinite([*error, *sigma]).all()
        if not right or not (sigma >= 0.0).all():
            problem = f"crater {name}: expected six finite errors and six sigmas of 0 or more"
            raise InputError(path, problem, column="map_errors")
    return errors


def _map_errors(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Errors of the map that an estimator found in each segment."""
    parts = values.get("calibrated_segments") or [values.get("calibrated") or {}]
    return [part["map_errors"] for part in parts if part.get("map_errors")]


def read_residuals(folder: Path) -> pa.Table:
    """Read the residuals of a run.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    pyarrow.Table
        With the columns that `craternav_fg.runs.residuals` lists.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    """
    path = folder / store.RESIDUALS
    if not exists(path):
        raise InputError(path, "is missing from the run")
    table = read_parquet(
        path, RESIDUALS, optional=RESIDUALS_OF_IMAGES, renamed=_FORMER_COLUMNS, other_columns=True
    )
    return with_present_names(table)


def _rename(values: dict[str, Any], former: Mapping[str, str]) -> None:
    """Rename the keys of earlier versions to those of today."""
    for old, new in former.items():
        if old in values:
            values[new] = values.pop(old)


def describe_frames(metrics: Mapping[str, Any]) -> str:
    """Describe how many frames a run has, and how many rims were measured in each.

    Parameters
    ----------
    metrics : mapping
        Contents of metrics.json.

    Returns
    -------
    str
    """
    counts = metrics["craters_per_frame"]
    least, most = min(counts), max(counts)
    return f"{len(counts)} frames with {least} {'' if least == most else f'to {most} '}rims each"


def _trajectories(path: Path) -> dict[str, Trajectory]:
    """Trajectories by estimator, in the order of the file, the truth among them."""
    states = read_parquet(path, STATES, optional=COVARIANCES, other_columns=True)
    require_finite(path, states, *(name for name in states.column_names if name not in _KEYS))
    names = states["estimator"].to_numpy(zero_copy_only=False)
    check_names(path, dict.fromkeys(names))
    if np.any(np.linalg.norm(_vectors(states, "quaternion_wxyz"), axis=1) < _MIN_QUATERNION):
        raise InputError(path, "expected quaternions, found one of length zero", column="quaternion_wxyz")
    out: dict[str, Trajectory] = {}
    for name in dict.fromkeys(names):
        one = _trajectory(states.take(pa.array(np.flatnonzero(names == name))))
        stamps = next(iter(out.values())).stamps_ns if out else one.stamps_ns
        if np.any(np.diff(one.stamps_ns) <= 0) or not np.array_equal(one.stamps_ns, stamps):
            problem = f"expected the same increasing stamps for all estimators, those of {name} differ"
            raise InputError(path, problem, column="stamp_ns")
        out[present_name(name)] = one
    return out


def _trajectory(states: pa.Table) -> Trajectory:
    k = len(states)

    def matrices(name: str, size: int) -> FloatArray | None:
        values = list_values(states[name]) if name in states.column_names else None
        return None if values is None else values.reshape(k, size, size)

    gTb = np.tile(np.eye(4), (k, 1, 1))
    gTb[:, :3, :3] = frames.from_quaternion_wxyz(_vectors(states, "quaternion_wxyz"))
    gTb[:, :3, 3] = _vectors(states, "position_m")
    return Trajectory(
        states["stamp_ns"].to_numpy(),
        gTb,
        _vectors(states, "velocity_m_s"),
        _vectors(states, "bias"),
        matrices("pose_covariance", 6),
        matrices("velocity_covariance", 3),
        matrices("bias_covariance", 6),
    )


def _vectors(states: pa.Table, name: str) -> FloatArray:
    values = list_values(states[name])
    assert values is not None
    return values
