"""Read a run's folder."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from craternav_fg import frames
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import present_name
from craternav_fg.runs import store
from craternav_fg.runs.columns import list_values, with_present_names
from craternav_fg.trajectory import Trajectory

FloatArray = npt.NDArray[np.float64]

# What version 0.1 called parts of metrics.json, metrics of an estimator, its calibration, and columns of
# residuals.parquet.
_FORMER_PARTS = {"resumed_at_frames": "reinitialised_at_frames"}
_FORMER_METRICS = {"rim_misfit_share": "rim_outlier_share"}
_FORMER_CALIBRATED = {"image_delay_s": "time_offset_s", "image_delay_sigma_s": "time_offset_sigma_s"}
_FORMER_COLUMNS = {"taken_for": "reassociated_with", "gain": "slope_contrast"}


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
    if not (path / store.MARKER).is_file():
        raise InputError(path, f"expected a run's folder, found no {store.MARKER} in it")
    for name in (store.METRICS, store.STATES):
        if not (path / name).is_file():
            raise InputError(path / name, "is missing from the run")
    try:
        metrics = json.loads((path / store.METRICS).read_text(encoding="utf-8"))
        states = pq.read_table(path / store.STATES)
        description = tomllib.loads((path / store.MARKER).read_text(encoding="utf-8"))
        trajectories = _trajectories(states)
        dataset = path / description["dataset"]
        _rename(metrics, _FORMER_PARTS)
        for part in ("estimators", "times_s", "failures"):
            metrics[part] = {present_name(name): each for name, each in metrics[part].items()}
        for values in metrics["estimators"].values():
            _rename(values, _FORMER_METRICS)
            _rename(values.get("calibrated", {}), _FORMER_CALIBRATED)
    except KeyError as error:
        raise InputError(path, f"is damaged: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, pa.ArrowException, OSError) as error:
        raise InputError(path, f"is damaged: {error}") from None
    truth = trajectories.pop(store.TRUTH, None)
    return Run(path, metrics, trajectories, truth, dataset)


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
    if not path.is_file():
        raise InputError(path, "is missing from the run")
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(path, f"is damaged: {error}") from None
    table = table.rename_columns([_FORMER_COLUMNS.get(name, name) for name in table.column_names])
    return with_present_names(table)


def _rename(values: dict[str, Any], former: Mapping[str, str]) -> None:
    """Give values of earlier versions the keys of today."""
    for old, new in former.items():
        if old in values:
            values[new] = values.pop(old)


def describe_frames(metrics: Mapping[str, Any]) -> str:
    """Say how many frames a run has, and how many rims were measured in each.

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


def _trajectories(states: pa.Table) -> dict[str, Trajectory]:
    """Trajectories by estimator, in the order of the file, the truth among them."""
    names = states["estimator"].to_pylist()
    out = {}
    for name in dict.fromkeys(names):
        rows = np.flatnonzero([other == name for other in names])
        out[present_name(name)] = _trajectory(states.take(pa.array(rows)))
    return out


def _trajectory(states: pa.Table) -> Trajectory:
    k = len(states)

    def matrices(name: str, size: int) -> FloatArray | None:
        values = list_values(states[name])
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
    if values is None:
        raise ValueError(f"{name} lacks values")
    return values
