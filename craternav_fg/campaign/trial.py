"""One trial: simulate, reconstruct with every estimator, and compare the errors with the lower bound."""

import errno
import importlib.metadata
import json
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

import craternav_fg
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.sensor_bank import SensorBank
from craternav_fg.evaluation.bounds import posterior_bound
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.pipeline.map_shift import common_covariance
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.runs.columns import list_column
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario
from factors.arrays import FloatArray

# Rows of these names hold the posterior Cramér-Rao bound, filtering and smoothing, in place of an estimator.
FILTERED_BOUND, SMOOTHED_BOUND = "pcrb_filtered", "pcrb_smoothed"
# Software whose version the results depend on.
PACKAGES = ("gtsam", "numpy", "numba", "scipy", "opencv-python-headless")
# Key of our metadata in a Parquet file.
METADATA = b"craternav"
# What a machine without disk space, memory or file handles reports.
_OUT_OF_RESOURCES = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EMFILE, errno.ENFILE)

SCHEMA = pa.schema(
    [
        ("trial", pa.int64()),
        ("estimator", pa.string()),
        ("stamp_ns", pa.int64()),
        ("altitude_m", pa.float64()),
        ("rims", pa.int64()),
        ("attitude_error_rad", pa.list_(pa.float64(), 3)),
        ("position_error_m", pa.list_(pa.float64(), 3)),
        ("velocity_error_m_s", pa.list_(pa.float64(), 3)),
        ("pose_sigma", pa.list_(pa.float64(), 6)),
        ("nees", pa.float64()),
    ]
)
"""Columns of a trial, one row per estimator and frame.

Errors are truth minus estimate. `pose_sigma` holds the standard deviations that the estimator claims:
attitude (rotation vector in b, rad), then position (in g, m); `nees` is that of the pose. The rows of
`FILTERED_BOUND` and `SMOOTHED_BOUND` have the standard deviations of the bound and no errors.
"""


@dataclass(frozen=True)
class TrialTask:
    """What a worker needs to run a trial.

    Attributes
    ----------
    scenario : Scenario
    number : int
        Number of the trial; with the scenario's seed it determines all randomness.
    estimators : tuple of str
        Names.
    versions : mapping of str to str
        Versions of the software that the campaign began with.
    """

    scenario: Scenario
    number: int
    estimators: tuple[str, ...]
    versions: Mapping[str, str]


@dataclass(frozen=True)
class TrialResult:
    """What comes back from a worker.

    Attributes
    ----------
    number : int
    parquet : bytes
        Table of `SCHEMA` as a Parquet file, with failures in its metadata. It does not depend on where or
        when the trial is run.
    times_s : mapping of str to float
        Wall time of the simulation, the front end and each estimator.
    error : str or None
        Why there is no result.
    """

    number: int
    parquet: bytes
    times_s: Mapping[str, float]
    error: str | None


def software() -> dict[str, str]:
    """Return the versions of this package and of those that its numbers depend on."""
    return {
        "craternav_fg": craternav_fg.__version__,
        **{name: importlib.metadata.version(name) for name in PACKAGES},
    }


def run_trial(task: TrialTask) -> TrialResult:
    """Run a trial; an error in it is a result that says why.

    Parameters
    ----------
    task : TrialTask

    Returns
    -------
    TrialResult

    Raises
    ------
    CraternavError
        When the software differs from that of the campaign, or disk space or memory runs out. These are no
        faults of the trial.
    """
    here = software()
    for name, version in task.versions.items():
        if here.get(name) != version:
            raise CraternavError(f"a worker has {name} {here.get(name)}, the campaign {version}")
    with tempfile.TemporaryDirectory(prefix="craternav-") as folder:
        try:
            return _run(task, Path(folder))
        except Exception as error:
            # The name of the temporary folder would make the result differ from run to run.
            problem = " ".join(str(error).replace(folder, "trial").split())
            known = isinstance(error, CraternavError)
            if _out_of_resources(error):
                raise CraternavError(f"trial {task.number}: {problem}") from error
            return failed(task.number, problem if known else f"{type(error).__name__}: {problem}")


def _out_of_resources(error: BaseException | None) -> bool:
    """Whether a full disk, memory or file table has caused an error."""
    while error is not None:
        if isinstance(error, MemoryError) or (
            isinstance(error, OSError) and error.errno in _OUT_OF_RESOURCES
        ):
            return True
        error = error.__cause__ or error.__context__
    return False


def failed(number: int, error: str) -> TrialResult:
    """Make the result of a trial that failed."""
    return TrialResult(number, _parquet(SCHEMA.empty_table(), number, error, {}), {}, error)


def _run(task: TrialTask, folder: Path) -> TrialResult:
    began = time.perf_counter()
    dataset = Dataset.open(simulate(task.scenario, folder / "dataset", trial=task.number))
    simulation_s = time.perf_counter() - began
    result = reconstruct(dataset, task.estimators)
    truth = dataset.truth
    assert truth is not None
    epochs = SensorBank(dataset.sensors).epochs(result.frames)
    stamps = np.array([epoch.stamp_ns for epoch in epochs], dtype=np.int64)
    motion = dataset.truth_at(stamps)
    assert motion is not None
    bound = posterior_bound(Descent.of(dataset), epochs, motion).take(
        np.flatnonzero(np.isin(stamps, truth.stamps_ns))
    )
    common = {
        "stamp_ns": truth.stamps_ns,
        "altitude_m": dataset.body.altitude_m(truth.gP),
        "rims": np.array([len(frame.rims) for frame in result.frames]),
    }

    def parts() -> Iterator[pa.Table]:
        for name, estimate in result.trajectories.items():
            e = errors(estimate, truth)
            own = {
                "attitude_error_rad": e.attitude_rad,
                "position_error_m": e.position_m,
                "velocity_error_m_s": e.velocity_m_s,
            }
            if estimate.pose_covariance is not None:
                own["pose_sigma"] = _sigmas(estimate.pose_covariance)
                own["nees"] = nees(e.pose, estimate.pose_covariance)
            yield _rows(task.number, name, {**common, **own})
        of_map = common_covariance(truth, dataset.catalog, result.frames)
        for name, covariance in ((FILTERED_BOUND, bound.filtered), (SMOOTHED_BOUND, bound.smoothed)):
            yield _rows(task.number, name, {**common, "pose_sigma": _sigmas(covariance + of_map)})

    parquet = _parquet(pa.concat_tables(parts()), task.number, None, result.failures)
    return TrialResult(task.number, parquet, {"simulation": simulation_s, **result.times_s}, None)


def _sigmas(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("kii->ki", covariance)))


def _rows(number: int, name: str, values: Mapping[str, npt.NDArray[Any]]) -> pa.Table:
    n = len(values["stamp_ns"])
    columns = []
    for field in SCHEMA:
        if field.name == "trial":
            column = pa.array(np.full(n, number), pa.int64())
        elif field.name == "estimator":
            column = pa.array([name] * n, pa.string())
        elif field.name not in values:
            column = pa.nulls(n, field.type)
        elif pa.types.is_fixed_size_list(field.type):
            column = list_column(values[field.name])
        else:
            column = pa.array(values[field.name], field.type)
        columns.append(column)
    return pa.Table.from_arrays(columns, schema=SCHEMA)


def _parquet(table: pa.Table, number: int, error: str | None, failures: Mapping[str, str]) -> bytes:
    metadata = {"trial": number, "error": error, "failures": dict(failures)}
    sink = pa.BufferOutputStream()
    # Without checksums most damage to a page would be read as other numbers.
    pq.write_table(
        table.replace_schema_metadata({METADATA: json.dumps(metadata)}),
        sink,
        compression="zstd",
        write_page_checksum=True,
    )
    return bytes(sink.getvalue())
