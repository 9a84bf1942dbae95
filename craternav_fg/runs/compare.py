"""Comparison of runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from craternav_fg.runs.read import Run, read_run

REFERENCE = "smoother"


def compare(*runs: Run | Path | str) -> pa.Table:
    """Return a table of the estimators of runs, for pandas or any other tool that reads Arrow.

    Parameters
    ----------
    *runs : Run, Path or str
        Runs, or their folders.

    Returns
    -------
    pyarrow.Table
        A row per run and estimator: `run`, `estimator`, the figures of metrics.json (errors are null without
        a truth) and `from_smoother_rms_m`, the RMS distance of its positions from the run's smoother.

    Raises
    ------
    InputError
        When a folder is no run, or damaged.
    """
    rows: list[dict[str, Any]] = []
    for one in runs:
        run = one if isinstance(one, Run) else read_run(one)
        for name, values in run.metrics["estimators"].items():
            plain = {key: value for key, value in values.items() if not isinstance(value, dict | list)}
            row = {"run": str(run.path), "estimator": name, **plain}
            rows.append({**row, "from_smoother_rms_m": from_reference_m(run, name)})
    return pa.Table.from_pylist(rows)


def from_reference_m(run: Run, name: str) -> float | None:
    """Return an estimator's RMS distance from the smoother's positions, m, which needs no truth.

    Parameters
    ----------
    run : Run
    name : str
        Name of the estimator.

    Returns
    -------
    float or None
        None when the run has no smoother.
    """
    if REFERENCE not in run.trajectories or name not in run.trajectories:
        return None
    step = run.trajectories[name].gP - run.trajectories[REFERENCE].gP
    return float(np.sqrt(np.mean(np.sum(step**2, axis=1))))
