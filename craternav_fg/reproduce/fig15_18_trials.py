"""Trials behind figs. 15 to 18, the paper's third case (4.2.3): whole descents, each with its own terrain."""

import functools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from craternav_fg.campaign.trial import (
    FILTERED_BOUND,
    SMOOTHED_BOUND,
    TrialResult,
    TrialTask,
    run_trial,
    software,
)
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.registry import is_retrospective
from craternav_fg.estimators.start import make_problem
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.simulation.scenario import simulate as simulate_trial
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

SCENARIO = "paper_case3"
PAPERS, FILTER, ONLINE, SMOOTHER, CENTRES = "ekf_paper", "ekf", "online", "smoother", "centre_smoother"
ESTIMATORS = (SMOOTHER, ONLINE, FILTER, PAPERS, CENTRES)
# The paper's limits at 10 km: a trial that ends within them has converged.
CONVERGED_M, CONVERGED_DEG = 200.0, 1.0


def simulate(options: ReproduceOptions, progress: Progress | None = None) -> pa.Table:
    """Run the trials with every estimator.

    Returns
    -------
    pyarrow.Table
        Columns as in `craternav_fg.campaign.trial.SCHEMA`.

    Raises
    ------
    CraternavError
        When a trial cannot be simulated.
    """
    scenario, versions = scenario_of(options), software()
    tasks = [TrialTask(scenario, number, ESTIMATORS, versions) for number in range(options.descents)]
    return table(run_all(run_trial, tasks, options.workers, "descents", progress))


def scenario_of(options: ReproduceOptions) -> Scenario:
    """Return the paper's third case with the seed of the options; the default seed is the scenario's own.

    With the default seed the trials are those of a campaign of the scenario.
    """
    scenario = load_scenario(SCENARIO)
    return scenario.model_copy(update={"seed": scenario.seed + options.seed - ReproduceOptions.seed})


@dataclass(frozen=True)
class Trial:
    """A trial of a scenario by its number, for a worker."""

    scenario: Scenario
    number: int


def first_trials(options: ReproduceOptions, count: int) -> list[Trial]:
    """Return the first trials of figs. 17 and 18, at most `count`."""
    scenario = scenario_of(options)
    return [Trial(scenario, number) for number in range(min(options.descents, count))]


def problem_of(trial: Trial) -> tuple[Problem, Trajectory]:
    """Simulate a trial: its problem and the truth."""
    with tempfile.TemporaryDirectory(prefix="craternav-") as folder:
        path = simulate_trial(trial.scenario, Path(folder) / "dataset", trial=trial.number)
        dataset = Dataset.open(path)
    assert dataset.truth is not None
    assert dataset.measurements is not None
    return make_problem(Descent.of(dataset), dataset.measurements), dataset.truth


def table(results: Sequence[TrialResult]) -> pa.Table:
    """Join the tables of trials.

    Raises
    ------
    CraternavError
        When a trial failed as a whole.
    """
    for result in results:
        if result.error is not None:
            raise CraternavError(f"trial {result.number}: {result.error}")
    # `pq.read_table` leaves threads by which one process in twenty ended with an abort (pyarrow 26.0.1).
    parts = [pq.ParquetFile(pa.BufferReader(result.parquet)).read() for result in results]
    return pa.concat_tables(part.replace_schema_metadata(None) for part in parts)


@dataclass(frozen=True)
class Errors:
    """An estimator's errors in one quantity, in the trials in which it produced a trajectory.

    Means over no trial are NaN.

    Attributes
    ----------
    trials : ndarray, shape (trials,)
        Trial numbers.
    error : ndarray, shape (trials, k)
        Norms of the position error, m, or of the attitude error, deg, at each frame.
    nees : ndarray, shape (trials, k)
        Normalised estimation error squared of the pose.
    bound : ndarray, shape (k,)
        RMS of the posterior Cramér-Rao bound over these trials, m or deg: that of smoothing for the
        estimators that use later data.
    """

    trials: npt.NDArray[np.int64]
    error: FloatArray
    nees: FloatArray
    bound: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Mean error over the trials, shape (k,), m or deg."""
        return _mean(self.error)

    @property
    def rms(self) -> FloatArray:
        """RMS error over the trials, shape (k,), m or deg."""
        return np.asarray(np.sqrt(_mean(self.error**2)))

    @property
    def anees(self) -> float:
        """Average NEES over the trials and frames."""
        return float(_mean(self.nees).mean())


def rms_ratio(one: Errors, other: Errors) -> FloatArray:
    """Ratio of two estimators' RMS errors over the trials of both.

    Trials of one alone are left out: they may be easier or harder than the others.

    Parameters
    ----------
    one, other : Errors

    Returns
    -------
    ndarray, shape (k,)
        At each frame; NaN when they have no trial in common.
    """
    mine, theirs = (a.error[np.isin(a.trials, b.trials)] for a, b in ((one, other), (other, one)))
    return np.asarray(np.sqrt(_mean(mine**2) / _mean(theirs**2)))


def _mean(values: FloatArray) -> FloatArray:
    """Mean (k,) over the trials."""
    return np.asarray(values.mean(axis=0)) if len(values) else np.full(values.shape[1:], np.nan)


class Descents:
    """Errors and bounds of all trials as arrays.

    Parameters
    ----------
    data : pyarrow.Table
        See `simulate`.
    unit : {"m", "deg"}
        Position or attitude.
    """

    def __init__(self, data: pa.Table, unit: str) -> None:
        self.data = data
        self._column, part = ("position_error_m", slice(3, 6)) if unit == "m" else (
            "attitude_error_rad", slice(0, 3)
        )  # fmt: skip
        self._part = part
        self._scale = 1.0 if unit == "m" else np.degrees(1.0)
        self.unit = unit
        bound = data.filter(pc.equal(data["estimator"], FILTERED_BOUND))
        self.numbers = np.array(pc.unique(bound["trial"]).to_pylist(), dtype=np.int64)
        self._frames = len(bound) // len(self.numbers)
        self.altitude_km = 1e-3 * self._array(bound, "altitude_m").mean(axis=0)
        self.craters = self._array(bound, "rims").astype(np.float64)

    def at(self, altitude_km: float) -> int:
        """Index of the frame nearest to an altitude."""
        return int(np.argmin(np.abs(self.altitude_km - altitude_km)))

    def first(self) -> "Descents":
        """Return the first trial alone."""
        return Descents(self.data.filter(pc.equal(self.data["trial"], self.numbers[0])), self.unit)

    def of(self, name: str) -> Errors:
        """Errors of an estimator."""
        rows = self.data.filter(pc.equal(self.data["estimator"], name))
        trials = pc.unique(rows["trial"])
        numbers = np.array(trials.to_pylist(), dtype=np.int64)
        error = self._scale * np.linalg.norm(self._array(rows, self._column), axis=-1)
        bound = self.bound(SMOOTHED_BOUND if is_retrospective(name) else FILTERED_BOUND, trials)
        return Errors(numbers, error, self._array(rows, "nees"), bound)

    def bound(self, name: str, trials: pa.Array | None = None) -> FloatArray:
        """RMS of one of the bounds over the trials.

        Parameters
        ----------
        name : str
        trials : pyarrow.Array, shape (n,), optional
            Numbers of the trials; all if not given.

        Returns
        -------
        ndarray, shape (k,)
            At each frame, in `unit`.
        """
        rows = self.data.filter(pc.equal(self.data["estimator"], name))
        if trials is not None:
            rows = rows.filter(pc.is_in(rows["trial"], value_set=trials))
        sigmas = self._array(rows, "pose_sigma")[..., self._part]
        return np.asarray(self._scale * np.sqrt(_mean(np.sum(sigmas**2, axis=-1))))

    @functools.cached_property
    def lost(self) -> dict[str, int]:
        """Number of trials in which each estimator produced no trajectory."""
        return {name: len(self.numbers) - len(self.of(name).trials) for name in ESTIMATORS}

    @functools.cached_property
    def converged(self) -> dict[str, int]:
        """Number of trials in which each estimator ends within the paper's 200 m and 1 deg."""
        out = {}
        for name in ESTIMATORS:
            rows = self.data.filter(pc.equal(self.data["estimator"], name))
            position, attitude = (
                np.linalg.norm(self._array(rows, column), axis=-1)[:, -1]
                for column in ("position_error_m", "attitude_error_rad")
            )
            near = (position <= CONVERGED_M) & (np.degrees(attitude) <= CONVERGED_DEG)
            out[name] = int(np.count_nonzero(near))
        return out

    def _array(self, rows: pa.Table, name: str) -> FloatArray:
        values = rows[name].combine_chunks()
        shape: tuple[int, ...] = (len(pc.unique(rows["trial"])), self._frames)
        if pa.types.is_fixed_size_list(values.type):
            shape = (*shape, values.type.list_size)
            values = values.flatten()
        return np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(shape)
