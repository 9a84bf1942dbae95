"""A run on disk: what `reconstruct` writes and `compare`, notebooks and other tools read.

metrics.json        of every estimator: errors, share of rims that do not fit, what it calibrated; wall times
truth.tum, NAME.tum trajectories as evo reads them (s, m, quaternion x y z w, in g)
states.parquet      every estimator's states with covariances, one row per frame
residuals.parquet   every rim against every estimator's pose, one row per rim and estimator: as measured
                    (`chart`), and what is left of it (`whitened`, `chi2`); `weight` is the one its match had,
                    0 if rejected as wrong, null where the estimator does not choose; `taken_for` the crater
                    it was used for instead, if any; with `RimQuality` of rims measured in images
figures/            PNG; of images, contact_sheet.png shows frames with their rims
overlays/           PNG per frame, on request
run.toml            what was run on what, with versions
"""

import importlib.metadata
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

import craternav_fg
from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.evaluation.innovations import Innovations, innovations
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.measurements import FrameMeasurement, RimQuality, RimSet
from craternav_fg.pipeline.reconstruct import Reconstruction
from craternav_fg.trajectory import Calibrated, Trajectory
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MARKER = "run.toml"
# All that a run's folder may hold: the demo's has its data set, too.
CONTENTS = ("*.toml", "*.tum", "*.json", "*.parquet", "*.html", "figures", "overlays", "dataset")
METRICS = "metrics.json"
# The estimator whose innovations are looked at.
FILTER = "ekf"
STATES = "states.parquet"
RESIDUALS = "residuals.parquet"
# What columns of residuals.parquet were called in runs of version 0.1.
_FORMER_COLUMNS = {"gain": "slope_contrast"}
TRUTH = "truth"
# Squared whitened residual of a rim, of 5 components, beyond which no noise explains it: 7 sigma.
MISFIT = 50.0


@dataclass(frozen=True)
class Run:
    """A run read back.

    Attributes
    ----------
    path : Path
        Its folder.
    metrics : dict
        What metrics.json holds.
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory or None
    dataset : Path
        Folder of the data set it was made from.
    """

    path: Path
    metrics: dict[str, Any]
    trajectories: Mapping[str, Trajectory]
    truth: Trajectory | None
    dataset: Path


def write_run(
    folder: Path,
    result: Reconstruction,
    *,
    dataset: str,
    camera: Camera,
    catalog: Catalog,
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
        Where the data set is, as run.toml tells it.
    camera : Camera
    catalog : Catalog
    truth : Trajectory or None
        For the errors.
    times_s : mapping of str to float
        Wall times of the parts.
    wall_s : float
        Wall time of the whole command so far.

    Returns
    -------
    dict
        What metrics.json holds.
    """
    estimators: dict[str, dict[str, Any]] = {
        name: dict(metrics(t, truth).as_dict()) for name, t in result.trajectories.items()
    }
    residuals = _residuals(result.trajectories, result.frames, camera, catalog)
    for name, trajectory in result.trajectories.items():
        estimators[name]["rim_misfit_share"] = _misfit_share(residuals, name)
        if trajectory.calibrated is not None:
            estimators[name]["calibrated"] = _calibrated(trajectory.calibrated, catalog)
    summary = {
        "wall_s": wall_s,
        "times_s": dict(times_s),
        "craters_per_frame": [len(frame.rims) for frame in result.frames],
        "craters_expected_per_frame": result.expected_rims,
        "initial_state": result.origin,
        "resumed_at_frames": list(result.resumed),
        "failures": dict(result.failures),
        "index": result.index_said,
        "innovations": _innovations(result),
        "estimators": estimators,
    }
    (folder / METRICS).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    every = dict(result.trajectories) if truth is None else {TRUTH: truth, **result.trajectories}
    for name, trajectory in every.items():
        write_tum(folder / f"{name}.tum", trajectory)
    pq.write_table(_states(every), folder / STATES)
    pq.write_table(residuals, folder / RESIDUALS)
    versions = {name: importlib.metadata.version(name) for name in ("gtsam", "numpy", "numba")}
    lines = [
        "# What was run, on what, and how.",
        f"craternav_fg = {json.dumps(craternav_fg.__version__)}",
        f"dataset = {json.dumps(dataset)}",
        f"estimators = {json.dumps(list(result.trajectories))}",
        "",
        "[versions]",
        *(f"{name} = {json.dumps(version)}" for name, version in versions.items()),
        *_tables("options", result.options),
    ]
    (folder / MARKER).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return summary


def _innovations(result: Reconstruction) -> dict[str, Any] | None:
    """Whether the filter's predictions are as wrong as they claim, which no truth is needed for."""
    if FILTER not in result.trajectories:
        return None
    found = Innovations.joined(innovations(problem, ekf().states(problem)) for problem in result.problems)
    return {"filter": FILTER, "nis": found.as_dict()} if found.sensor else None


def _tables(name: str, values: Mapping[str, Any]) -> list[str]:
    """Lines of a TOML table and of those within it; JSON writes numbers, strings and lists as TOML does."""
    plain = {k: v for k, v in values.items() if v is not None and not isinstance(v, Mapping)}
    lines = ["", f"[{name}]", *(f"{k} = {json.dumps(v)}" for k, v in plain.items())] if plain else []
    for k, v in values.items():
        if isinstance(v, Mapping):
            lines += _tables(f"{name}.{k}", v)
    return lines


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as evo's TUM format: time in s, position in m, quaternion x y z w."""
    q = np.roll(frames.to_quaternion_wxyz(trajectory.gRb), -1, axis=1)
    rows = []
    for stamp, P, quaternion in zip(trajectory.stamps_ns, trajectory.gP, q, strict=True):
        seconds, rest = divmod(int(stamp), 1_000_000_000)
        numbers = " ".join(repr(float(x)) for x in (*P, *quaternion))
        rows.append(f"{seconds}.{rest:09d} {numbers}\n")
    path.write_text("".join(rows), encoding="ascii")


def _calibrated(found: Calibrated, catalog: Catalog) -> dict[str, Any]:
    """Give what was estimated along as plain data, craters by their names."""
    out: dict[str, Any] = {}
    if found.mounting_rad is not None:
        out["mounting_deg"], out["mounting_sigma_deg"] = (
            np.degrees(part).tolist() for part in found.mounting_rad
        )
    if found.image_delay_s is not None:
        out["image_delay_s"], out["image_delay_sigma_s"] = found.image_delay_s
    if found.map_errors is not None:
        out["map_errors"] = {
            catalog.identifiers[row]: {"error": error.tolist(), "sigma": sigma.tolist()}
            for row, (error, sigma) in found.map_errors.items()
        }
    return out


def read_run(folder: Path | str) -> Run:
    """Read a run.

    Raises
    ------
    InputError
        When the folder is none, or a file of it is missing or damaged.
    """
    path = Path(folder)
    if not (path / MARKER).is_file():
        raise InputError(path, f"expected a run's folder, found no {MARKER} in it")
    try:
        summary = json.loads((path / METRICS).read_text(encoding="utf-8"))
        table = pq.read_table(path / STATES)
        told = tomllib.loads((path / MARKER).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(Path(str(error.filename)), "is missing from the run") from None
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, pa.ArrowInvalid, OSError) as error:
        raise InputError(path, f"is damaged: {error}") from None
    names = table["estimator"].to_pylist()
    trajectories = {}
    for name in dict.fromkeys(names):
        rows = np.flatnonzero([other == name for other in names])
        trajectories[name] = _trajectory(table.take(pa.array(rows)))
    truth = trajectories.pop(TRUTH, None)
    return Run(path, summary, trajectories, truth, path / told["dataset"])


def read_residuals(folder: Path) -> pa.Table:
    """Read a run's residuals, see the module.

    Raises
    ------
    InputError
        When the file is missing or damaged.
    """
    path = folder / RESIDUALS
    if not path.is_file():
        raise InputError(path, "is missing from the run")
    try:
        table = pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(path, f"is damaged: {error}") from None
    return table.rename_columns([_FORMER_COLUMNS.get(name, name) for name in table.column_names])


def _states(trajectories: Mapping[str, Trajectory]) -> pa.Table:
    columns: dict[str, list[pa.Array]] = {}

    def add(name: str, array: pa.Array) -> None:
        columns.setdefault(name, []).append(array)

    for name, t in trajectories.items():
        k = len(t)
        add("estimator", pa.array([name] * k))
        add("stamp_ns", pa.array(t.stamps_ns))
        add("position_m", _vectors(t.gP))
        add("quaternion_wxyz", _vectors(frames.to_quaternion_wxyz(t.gRb)))
        add("velocity_m_s", _vectors(t.gV))
        add("bias", _vectors(t.bias))
        for field, size in (("pose_covariance", 36), ("velocity_covariance", 9), ("bias_covariance", 36)):
            value = getattr(t, field)
            missing = pa.nulls(k, pa.list_(pa.float64(), size))
            add(field, missing if value is None else _vectors(value.reshape(k, size)))
    return pa.table({name: pa.chunked_array(parts) for name, parts in columns.items()})


def _vectors(rows: FloatArray) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(rows).ravel(), pa.float64())
    return pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])


def _trajectory(table: pa.Table) -> Trajectory:
    k = len(table)

    def numbers(name: str, *shape: int) -> FloatArray | None:
        column = table[name].combine_chunks()
        if column.null_count:
            return None
        return np.array(column.flatten().to_numpy(zero_copy_only=False)).reshape(k, *shape)

    gTb = np.tile(np.eye(4), (k, 1, 1))
    gTb[:, :3, :3] = frames.from_quaternion_wxyz(_required(numbers("quaternion_wxyz", 4)))
    gTb[:, :3, 3] = _required(numbers("position_m", 3))
    return Trajectory(
        table["stamp_ns"].to_numpy(),
        gTb,
        _required(numbers("velocity_m_s", 3)),
        _required(numbers("bias", 6)),
        numbers("pose_covariance", 6, 6),
        numbers("velocity_covariance", 3, 3),
        numbers("bias_covariance", 6, 6),
    )


def _required(array: FloatArray | None) -> FloatArray:
    assert array is not None
    return array


def _misfit_share(residuals: pa.Table, name: str) -> float | None:
    """Share of all rims that an estimator's poses do not explain, None without rims."""
    squares = residuals.filter(pc.equal(residuals["estimator"], name))["chi2"].to_numpy()
    # What is not finite fits least.
    return float(np.mean(~(squares <= MISFIT))) if len(squares) else None


def _quality(rims: RimSet, name: str) -> FloatArray:
    """One figure of all rims of a frame; NaN where they were not measured in an image."""
    return np.full(len(rims), np.nan) if rims.quality is None else np.asarray(getattr(rims.quality, name))


def _others(trajectory: Trajectory, craters: IntArray, catalog: Catalog) -> list[str | None]:
    """Names of the craters that rims were taken for, where those are not the matched ones (n,)."""
    if trajectory.rim_craters is None:
        return [None] * len(craters)
    taken = np.concatenate(trajectory.rim_craters).tolist()
    return [
        None if row in (-1, matched) else catalog.identifiers[row]
        for row, matched in zip(taken, craters.tolist(), strict=True)
    ]


def _exposures(trajectory: Trajectory) -> FloatArray:
    """Poses (k, 4, 4) whose camera, mounted as believed, took the images at the stamps."""
    gTb, found = trajectory.gTb.copy(), trajectory.calibrated
    if found is None:
        return gTb
    if found.image_delay_s is not None and len(trajectory) > 1:
        delay_s = found.image_delay_s[0]
        seconds = np.diff(trajectory.stamps_ns)[:, None] * 1e-9
        steps = np.swapaxes(gTb[:-1, :3, :3], 1, 2) @ gTb[1:, :3, :3]
        rates = np.array([frames.rotation_log(step) for step in steps]) / seconds
        # A delay is milliseconds: the mean rate of turn from frame to frame will do.
        rates = 0.5 * (np.concatenate([rates[:1], rates]) + np.concatenate([rates, rates[-1:]]))
        gTb[:, :3, :3] = gTb[:, :3, :3] @ np.array([frames.rotation_exp(delay_s * rate) for rate in rates])
        gTb[:, :3, 3] += delay_s * trajectory.gV
    if found.mounting_rad is not None:
        gTb[:, :3, :3] = gTb[:, :3, :3] @ frames.rotation_exp(found.mounting_rad[0])
    return gTb


def _residuals(
    trajectories: Mapping[str, Trajectory],
    measured: tuple[FrameMeasurement, ...],
    camera: Camera,
    catalog: Catalog,
) -> pa.Table:
    """Whitened chart residuals (measured minus predicted) of every rim at every estimator's pose."""
    stamps = np.concatenate([np.full(len(f.rims), f.stamp_ns) for f in measured])
    craters = np.concatenate([f.rims.craters for f in measured])
    charts = np.concatenate([f.rims.chart for f in measured])
    quality = {
        name: pa.array(np.concatenate([_quality(f.rims, name) for f in measured]), from_pandas=True)
        for name in (field.name for field in fields(RimQuality))
    }
    parts = []
    for name, trajectory in trajectories.items():
        whitened = [np.empty((0, 5))]
        for frame, gTb in zip(measured, _exposures(trajectory), strict=True):
            rims = frame.rims
            predicted, _ = conic.project_rims(
                gTb, camera.bTc, catalog.centres[rims.craters], catalog.axes[rims.craters]
            )
            L = np.linalg.cholesky(rims.covariance)
            whitened.append(np.linalg.solve(L, (rims.chart - predicted)[..., None])[..., 0])
        e = np.concatenate(whitened)
        weights = trajectory.rim_weights
        parts.append(
            pa.table(
                {
                    "estimator": pa.array([name] * len(e)),
                    "stamp_ns": pa.array(stamps.astype(np.int64)),
                    "crater_id": pa.array([catalog.identifiers[row] for row in craters]),
                    "chart": _vectors(charts),
                    "whitened": _vectors(e),
                    "chi2": pa.array(np.sum(e**2, axis=1)),
                    "weight": pa.nulls(len(e), pa.float64())
                    if weights is None
                    else pa.array(np.concatenate(weights)),
                    "taken_for": pa.array(_others(trajectory, craters, catalog), pa.string()),
                    **quality,
                }
            )
        )
    return pa.concat_tables(parts)
