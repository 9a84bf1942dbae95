"""Accuracy and cost of the fixed-lag smoother over its lag; the paper has no smoother."""

import time
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from gtsam.symbol_shorthand import X
from matplotlib.figure import Figure

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.incremental import FixedLagIsam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.reproduce.fig15_18_trials import Trial, first_trials, problem_of
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.results import Reproduction, Row, number
from craternav_fg.reproduce.sentences import compared
from factors.arrays import FloatArray

LAGS_S = (4.0, 10.0, 30.0, 60.0, 120.0)
# Enough for curves without visible noise; each trial is run once per lag.
MAX_TRIALS = 6
# States that are read out before they leave the lag: several may leave at one frame.
_LEAVING_STATES = 5
# Altitudes of the comparison: the start has converged, and all craters are in view.
BAND_KM = (50.0, 30.0)
_NO_SMOOTHER = "the paper has no smoother"


def lag(options: ReproduceOptions, progress: Progress | None = None) -> Reproduction:
    """Measure errors of the newest and the oldest state in the lag, and the time per frame, over the lag.

    Parameters
    ----------
    options : ReproduceOptions
    progress : callable, optional

    Returns
    -------
    Reproduction
    """
    trials = first_trials(options, MAX_TRIALS)
    data = pa.concat_tables(run_all(_run_trial, trials, options.workers, "lags", progress))
    columns = {name: data[name].to_numpy() for name in data.column_names}
    newest, oldest, cost = [], [], []
    for lag_s in LAGS_S:
        mine = columns["lag_s"] == lag_s
        newest.append(_rms(columns["newest_m"][mine]))
        oldest.append(_rms(columns["oldest_m"][mine]))
        cost.append(float(np.median(columns["frame_ms"][mine])))
    bounds = [_rms(columns[name]) for name in ("bound_online_m", "bound_smoothed_m")]
    band = f"{BAND_KM[0]:g} to {BAND_KM[1]:g} km, {len(trials)} trials"
    rows = []
    for k, lag_s in enumerate(LAGS_S):
        where = f"lag {lag_s:g} s, {band}"
        for quantity, value, unit, bound in (
            ("position error, RMS, newest state", newest[k], "m", bounds[0]),
            ("position error, RMS, state one lag old", oldest[k], "m", bounds[1]),
            ("processor time per frame, median", cost[k], "ms", None),
        ):
            rows.append(Row("lag", quantity, where, unit, efficient=value, bound=bound, verdict=_NO_SMOOTHER))
    drawing = _draw(np.array(newest), np.array(oldest), np.array(cost), bounds)
    text = note(newest, oldest, cost, bounds, len(trials))
    return Reproduction(
        "lag", "Accuracy and cost of the fixed-lag smoother over its lag", rows, text, drawing, data
    )


def note(
    newest: Sequence[float],
    oldest: Sequence[float],
    cost: Sequence[float],
    bounds: Sequence[float],
    trials: int,
) -> str:
    """Paragraph of the figure.

    Parameters
    ----------
    newest, oldest : sequence of float
        RMS position errors of the newest state and of the state one lag old, by `LAGS_S`, m.
    cost : sequence of float
        Processor time per frame, by `LAGS_S`, ms.
    bounds : sequence of float
        RMS of the posterior Cramér-Rao bound: of filtering and of smoothing, m.
    trials : int

    Returns
    -------
    str
    """
    # Of an RMS over three components per trial.
    scatter = 100.0 / np.sqrt(6.0 * trials)
    short, long = f"{LAGS_S[0]:g} s", f"{LAGS_S[-1]:g} s"
    return (
        f"Fixed-lag smoothers of {short} to {long} on the first {trials} trials of figs. 17 and 18, from "
        f"{BAND_KM[0]:g} to {BAND_KM[1]:g} km. The RMS error of the newest state is {number(min(newest))} to "
        f"{number(max(newest))} m over the lags (bound {number(bounds[0])} m); at {long} it is "
        f"{compared(newest[-1], newest[0])} that at {short}. The state one lag old has {number(oldest[0])} m "
        f"at {short} and {number(oldest[-1])} m at {long}, {compared(oldest[-1], oldest[0])} at {short} "
        f"(bound from all data {number(bounds[1])} m). With {trials} trials an RMS has a standard error of "
        f"about {scatter:.0f} %, common to all lags. A frame takes {number(cost[0])} ms of processor time at "
        f"{short} and {number(cost[-1])} ms at {long} on this machine, {compared(cost[-1], cost[0])} at "
        f"{short}."
    )


def _run_trial(trial: Trial) -> pa.Table:
    problem, truth = problem_of(trial)
    bound = posterior_bound(problem, problem.frames, truth)
    altitude_km = 1e-3 * problem.body.altitude_m(truth.gP)
    band = (altitude_km <= BAND_KM[0]) & (altitude_km >= BAND_KM[1])
    tables = []
    for lag_s in LAGS_S:
        newest, oldest, frame_ms = _run(problem, lag_s)
        columns = {
            "trial": np.full(len(altitude_km), trial.number),
            "lag_s": np.full(len(altitude_km), lag_s),
            "altitude_km": altitude_km,
            "newest_m": np.linalg.norm(newest - truth.gP, axis=1),
            "oldest_m": np.linalg.norm(oldest - truth.gP, axis=1),
            "bound_online_m": position_rms_m(bound.filtered),
            "bound_smoothed_m": position_rms_m(bound.smoothed),
            "frame_ms": frame_ms,
        }
        tables.append(pa.table({name: values[band] for name, values in columns.items()}))
    return pa.concat_tables(tables)


def _run(problem: Problem, lag_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position (k, 3) of each frame as the newest and as it left the lag; processor time (k,) of each, ms."""
    solver = FixedLagIsam(lag_s)
    session = OnlineSession(problem, solver=solver)
    oldest = np.zeros((len(problem.frames), 3))
    frame_ms = np.zeros(len(problem.frames))
    first = 0
    for k, frame in enumerate(problem.frames):
        began = time.process_time()
        if k == 0:
            session.begin(frame, problem.start)
        else:
            session.update(frame)
        frame_ms[k] = 1e3 * (time.process_time() - began)
        numbers = session.frame_state_indices
        while not solver.tree.valueExists(X(numbers[first])):
            first += 1
        # The next states to leave the lag and the newest; at the end, all.
        leaving = range(first, k + 1 if k + 1 == len(problem.frames) else min(first + _LEAVING_STATES, k + 1))
        for older in {*leaving, k}:
            oldest[older] = solver.tree.calculateEstimatePose3(X(numbers[older])).translation()
    return session.filtered().gP, oldest, frame_ms


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _draw(newest: FloatArray, oldest: FloatArray, cost: FloatArray, bounds: list[float]) -> Figure:
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    axes.plot(LAGS_S, newest, "o-", color="#56B4E9", label="newest state")
    axes.plot(LAGS_S, oldest, "s-", color="#0072B2", label="state one lag old")
    for bound, style, name in zip(bounds, ("--", ":"), ("online", "in retrospect"), strict=True):
        axes.axhline(bound, color="k", ls=style, lw=1.2, label=f"bound (PCRB), {name}")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("position error, RMS, m")
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    below.plot(LAGS_S, cost, "o-", color="0.3")
    below.set_ylim(bottom=0.0)
    below.set_ylabel("CPU ms per frame")
    below.set_xlabel("lag, s")
    for one in (axes, below):
        one.set_xscale("log")
        one.set_xticks(LAGS_S, [f"{lag_s:g}" for lag_s in LAGS_S])
        one.minorticks_off()
        one.grid(alpha=0.3)
    return figure
