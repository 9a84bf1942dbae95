"""What each measurement of a rim keeps of its information: smoother, online and EKF on the same descents.

Not part of the paper, which has eqs. (10), (11) and (19) in a filter alone.
"""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.figure import Figure

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.basins import POSE, steps_to_optimum
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.ekf.filter import DistributedEkf, EkfOptions
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.rim_models import RIM_MODELS, RimModel, rim_factors
from craternav_fg.evaluation.consistency import anees_by_altitude
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.plots.style import colour
from craternav_fg.reproduce.fig15_18_trials import Trial, first_trials, problem_of
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.results import NO_NUMBER, Reproduction, Row, known, number
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray
from factors.custom import Loss

NAME = "rim_models"
ESTIMATORS = ("smoother", "online", "ekf")
# Medians of more trials change little; each trial is run with eighteen estimators.
MAX_TRIALS = 10
# Of the altitude, over which the ANEES is averaged.
BINS_KM = (100.0, 70.0, 40.0, 10.0)
_BINS = tuple(f"ANEES, {high:.0f} to {low:.0f} km" for high, low in itertools.pairwise(BINS_KM))
# A view with so many rims determines the pose by itself; fewer are judged apart.
ENOUGH_RIMS = 3
# Frames of a descent that an estimator runs through before it is timed.
_WARM_UP_FRAMES = 3
# Starting poses around the truth at a frame: their number, turn, and shift as a share of the altitude.
_STARTS, _TURN_RAD, _SHIFT = 24, np.radians(10.0), 0.1
_SCHEMA = pa.schema(
    {
        "trial": pa.int64(),
        "model": pa.string(),
        "estimator": pa.string(),
        "altitude_m": pa.float64(),
        "rims": pa.int64(),
        "error_m": pa.float64(),
        "nees": pa.float64(),
        "from_chart_sigmas": pa.float64(),
        "frame_s": pa.float64(),
        "basin": pa.float64(),
    }
)


@dataclass(frozen=True)
class Kept:
    """How an estimator does with a measurement of rims.

    Attributes
    ----------
    trials : int
        That produced a trajectory.
    rms_m : float
        RMS position error over trials and frames.
    few_rims_rms_m : float
        The same over the frames with one or two rims; NaN without such frames.
    anees : float
        ANEES of the pose, 6 expected.
    anees_by_altitude : tuple of float
        In the bins of `BINS_KM`; NaN where no frame is.
    from_chart_sigmas : float
        RMS distance of the poses from those with the ellipse chart, per dimension, in the latter's sigmas,
        over the trials with both; NaN without any.
    frame_ms : float
        CPU time per frame.
    basin : float
        Share of starting poses, turned by 10 deg and shifted by 10 % of the altitude, from which undamped
        Gauss-Newton reaches the optimum of a frame.
    """

    trials: int
    rms_m: float
    few_rims_rms_m: float
    anees: float
    anees_by_altitude: tuple[float, ...]
    from_chart_sigmas: float
    frame_ms: float
    basin: float


def rim_models(options: ReproduceOptions, progress: Progress | None = None) -> Reproduction:
    """Run every estimator with every measurement of rims.

    Parameters
    ----------
    options : ReproduceOptions
    progress : callable, optional

    Returns
    -------
    Reproduction
    """
    trials = first_trials(options, MAX_TRIALS)
    data = pa.concat_tables(run_all(_run_trial, trials, options.workers, "measurements of rims", progress))
    kept = evaluate(data)
    rows = []
    for (model, name), one in kept.items():
        condition = f"{name}: {model}; {one.trials} of {len(trials)} trials"
        for quantity, unit, value in (
            ("position error, RMS", "m", one.rms_m),
            ("ANEES", "", one.anees),
            *(
                (name_of_bin, "", value)
                for name_of_bin, value in zip(_BINS, one.anees_by_altitude, strict=True)
            ),
            ("CPU time per frame", "ms", one.frame_ms),
            ("basin", "", one.basin),
        ):
            rows.append(
                Row(
                    NAME, quantity, condition, unit,
                    corrected=known(value), verdict=NO_NUMBER, headline=unit == "m",
                )
            )  # fmt: skip
    title = "What each measurement of a rim keeps of its information"
    return Reproduction(NAME, title, rows, note(data, len(trials)), _draw(kept), data)


def evaluate(data: pa.Table) -> dict[tuple[RimModel, str], Kept]:
    """Evaluate trials.

    Parameters
    ----------
    data : pyarrow.Table
        See `rim_models`.

    Returns
    -------
    dict of (str, str) to Kept
        By measurement and estimator; a pair that produced no trajectory is missing.
    """
    found: dict[tuple[RimModel, str], Kept] = {}
    for model, name in itertools.product(RIM_MODELS, ESTIMATORS):
        rows = _of(data, model, name)
        if len(rows):
            found[model, name] = _kept(rows)
    return found


def _of(data: pa.Table, model: RimModel, name: str) -> pa.Table:
    """Rows of an estimator with a measurement."""
    return data.filter(pc.and_(pc.equal(data["model"], model), pc.equal(data["estimator"], name)))


def _kept(rows: pa.Table) -> Kept:
    column = {key: rows[key].to_numpy() for key in rows.column_names if key not in ("model", "estimator")}
    trials = len(np.unique(column["trial"]))
    of_trials = column["nees"].reshape(trials, -1)
    altitude_m = column["altitude_m"].reshape(trials, -1).mean(axis=0)
    edges_m = [1001.0 * BINS_KM[0], *(1e3 * km for km in BINS_KM[1:-1]), 999.0 * BINS_KM[-1]]
    bins = {one.highest_m: one.mean for one in anees_by_altitude(of_trials, altitude_m, edges_m)}
    return Kept(
        trials=trials,
        rms_m=_rms(column["error_m"]),
        few_rims_rms_m=_rms(column["error_m"][column["rims"] < ENOUGH_RIMS]),
        anees=float(of_trials.mean()),
        anees_by_altitude=tuple(bins.get(high_m, np.nan) for high_m in edges_m[:-1]),
        from_chart_sigmas=_rms(column["from_chart_sigmas"][np.isfinite(column["from_chart_sigmas"])]),
        frame_ms=float(1e3 * np.median(column["frame_s"])),
        basin=float(column["basin"].mean()),
    )


def _beside_chart(data: pa.Table, model: RimModel, name: str) -> tuple[Kept, Kept] | None:
    """Evaluate an estimator with a measurement and with the chart over the trials with both, if any."""
    parts = [_of(data, one, name) for one in (model, "chart")]
    common = np.intersect1d(*(part["trial"].to_numpy() for part in parts))
    if not len(common):
        return None
    one, chart = (_kept(part.filter(pc.is_in(part["trial"], pa.array(common)))) for part in parts)
    return one, chart


def note(data: pa.Table, trials: int) -> str:
    """Paragraph of the figure, from its numbers.

    Parameters
    ----------
    data : pyarrow.Table
        See `rim_models`.
    trials : int

    Returns
    -------
    str
    """

    def over(one: Kept) -> str:
        return "" if one.trials == trials else f" (over the {one.trials} of {trials} trials with both)"

    kept = evaluate(data)
    chart = kept.get(("chart", "online"))
    text = f"Online smoother, first {trials} trials of figs. 17 and 18: the ellipse chart "
    if chart is None:
        parts = [f"{text}produced no trajectory."]
    else:
        counted = "" if chart.trials == trials else f" in the {chart.trials} with a trajectory"
        parts = [f"{text}has an RMS position error of {number(chart.rms_m)} m{counted}."]
    for model in RIM_MODELS[1:]:
        pair = _beside_chart(data, model, "online")
        if (model, "online") not in kept:
            parts.append(f"{model} produced no trajectory.")
        elif pair is None:
            parts.append(f"{model}: no trial in common with the chart.")
        else:
            one, beside = pair
            consistent = "" if one.anees < 2.0 * beside.anees else f", but an ANEES of {number(one.anees)}"
            parts.append(
                f"{model}: {number(one.rms_m / beside.rms_m)} times that error{consistent}; "
                f"{number(one.frame_ms / beside.frame_ms)} times its CPU time{over(one)}."
            )
    if (pair := _beside_chart(data, "eq19", "smoother")) is not None:
        parts.append(
            f"The smoother's poses with eq. (19) are {number(pair[0].from_chart_sigmas)} sigma from those "
            f"with the chart{over(pair[0])}."
        )
    if (pair := _beside_chart(data, "los", "smoother")) is not None:
        los, whole = pair
        few = los.few_rims_rms_m / whole.few_rims_rms_m
        parts.append(
            "Lines of sight leave out size and shape: the smoother's error is "
            f"{number(los.rms_m / whole.rms_m)} times that with the chart{over(los)}"
            + (f", {number(few)} times in frames with one or two rims." if np.isfinite(few) else ".")
        )
    basins = ", ".join(
        f"{model} {100 * one.basin:.0f} %" for (model, name), one in kept.items() if name == "online"
    )
    if basins:
        parts.append(
            "Share of starting poses, turned by 10 deg and shifted by 10 % of the altitude, from which "
            f"undamped Gauss-Newton reaches a frame's optimum: {basins}."
        )
    return " ".join(parts)


def _rms(values: FloatArray) -> float:
    """RMS of values; NaN without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def _run_trial(trial: Trial) -> pa.Table:
    problem, truth = problem_of(trial)
    altitude_m = problem.body.altitude_m(truth.gP)
    rims = [len(frame.rims) for frame in problem.frames]
    rng = np.random.default_rng([trial.scenario.seed, trial.number])
    references: dict[str, Trajectory] = {}
    parts = [_SCHEMA.empty_table()]
    starts = _starts(problem, truth, rng)
    for model in RIM_MODELS:
        basin = _basin(problem, truth, model, starts)
        for name, one in _estimators(model).items():
            try:
                # Loads or compiles kernels, which each process does once.
                one.estimate(replace(problem, frames=problem.frames[:_WARM_UP_FRAMES]))
                began = time.process_time()
                found = one.estimate(problem)
            except (EstimationError, RuntimeError, np.linalg.LinAlgError):
                continue
            frame_s = (time.process_time() - began) / len(truth)
            error = errors(found, truth)
            assert found.pose_covariance is not None
            if model == "chart":
                references[name] = found
            parts.append(
                pa.table(
                    {
                        "trial": np.full(len(truth), trial.number),
                        "model": [model] * len(truth),
                        "estimator": [name] * len(truth),
                        "altitude_m": altitude_m,
                        "rims": rims,
                        "error_m": np.linalg.norm(error.position_m, axis=1),
                        "nees": nees(error.pose, found.pose_covariance),
                        "from_chart_sigmas": _apart_sigmas(found, references.get(name)),
                        "frame_s": np.full(len(truth), frame_s),
                        "basin": np.full(len(truth), basin),
                    },
                    schema=_SCHEMA,
                )
            )
    return pa.concat_tables(parts)


def _apart_sigmas(found: Trajectory, chart: Trajectory | None) -> FloatArray:
    """RMS distance (k,) per dimension of the poses from those with the chart, NaN without the latter."""
    if chart is None:
        return np.full(len(found), np.nan)
    assert chart.pose_covariance is not None
    return np.sqrt(nees(errors(found, chart).pose, chart.pose_covariance) / 6.0)


def _estimators(model: RimModel) -> dict[str, Estimator]:
    options = GraphOptions(rims=model)
    return {
        "smoother": BatchSmoother(options),
        "online": OnlineSmoother(options),
        "ekf": DistributedEkf("ekf", EkfOptions(measurement=model)),
    }


def _starts(problem: Problem, truth: Trajectory, rng: np.random.Generator) -> dict[int, FloatArray]:
    """Draw starting poses (n, 4, 4) around the truth at the first, middle and last frame with enough rims."""
    enough = [k for k, frame in enumerate(problem.frames) if len(frame.rims) >= ENOUGH_RIMS]
    chosen = {enough[i] for i in (0, len(enough) // 2, -1)} if enough else set()
    out = {}
    for k in sorted(chosen):
        turn, shift = rng.standard_normal((2, _STARTS, 3))
        turn *= _TURN_RAD / np.linalg.norm(turn, axis=1)[:, None]
        far_m = _SHIFT * float(problem.body.altitude_m(truth.gP[k]))
        shift *= far_m / np.linalg.norm(shift, axis=1)[:, None]
        steps = [frames.pose(frames.rotation_exp(w), t) for w, t in zip(turn, shift, strict=True)]
        out[k] = truth.gTb[k] @ np.array(steps)
    return out


def _basin(problem: Problem, truth: Trajectory, model: RimModel, starts: dict[int, FloatArray]) -> float:
    reached = []
    for k, poses in starts.items():
        rims = problem.frames[k].rims
        factors = rim_factors(model, POSE, problem.camera, problem.catalog, rims, truth.gTb[k], Loss())
        try:
            reached.append(float(np.mean(steps_to_optimum(factors, truth.gTb[k], poses) >= 0)))
        except EstimationError:
            reached.append(0.0)
    return float(np.mean(reached)) if reached else np.nan


def _draw(kept: dict[tuple[RimModel, str], Kept]) -> Figure:
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    place: Sequence[int] = range(len(RIM_MODELS))
    for k, name in enumerate(ESTIMATORS):
        y = [p + 0.25 * (k - 1) for p in place]
        ones = [kept.get((model, name)) for model in RIM_MODELS]
        for axes, values in (
            (left, [np.nan if one is None else one.rms_m for one in ones]),
            (right, [np.nan if one is None else one.anees for one in ones]),
        ):
            axes.plot(values, y, "o", color=colour(name), label=name)
    left.set_yticks(place, RIM_MODELS)
    left.invert_yaxis()
    left.set_xlabel("position error, RMS, m")
    right.set_xlabel("ANEES (6 expected)")
    right.axvline(6.0, color="k", lw=0.8)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
    right.legend(frameon=False)
    return figure
