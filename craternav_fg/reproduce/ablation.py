"""Effect of single choices of the paper's filter, and of centres in place of rims; not part of the paper."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.ekf.filter import DistributedEkf, ekf_paper
from craternav_fg.estimators.ekf.fusion import Rule
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.linearisation import NoiseModel
from craternav_fg.estimators.rim_models import RimModel
from craternav_fg.evaluation.metrics import errors
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.plots.style import COLOURS
from craternav_fg.reproduce.fig15_18_trials import Trial, first_trials, problem_of
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.results import NO_NUMBER, Reproduction, Row, number
from craternav_fg.reproduce.sentences import listed
from factors.arrays import FloatArray

# Medians of more trials change little; each trial is run with eleven estimators.
MAX_TRIALS = 10
MODELS: dict[RimModel, str] = {"eq19": "eq. (19)", "chart": "ellipse chart"}
NOISES: dict[NoiseModel, str] = {"fixed": "one Qn", "measured": "own noise"}
FUSIONS: dict[Rule | str, str] = {"paper": "eq. (29)", "exact": "prior counted once"}
# The centre of a rim is taken for the image of the crater's centre, or for the centre of the ellipse.
CENTRES, ELLIPSE_CENTRES, RIMS = (
    "smoother: centres, as the crater's", "smoother: centres, as the ellipse's", "smoother: rims",
)  # fmt: skip
# Variance of a rim's size and shape is multiplied by this where only its centre is to count.
_IGNORED_VARIANCE = 1e8


def filters() -> dict[str, Estimator]:
    """Make the filters between the paper's and the chart EKF, each linearised once and without gates."""
    out: dict[str, Estimator] = {}
    for model, noise, fusion in itertools.product(MODELS, NOISES, FUSIONS):
        name = f"EKF: {MODELS[model]}, {NOISES[noise]}, {FUSIONS[fusion]}"
        options = replace(ekf_paper().options, measurement=model, noise=noise, fusion=fusion)  # type: ignore[arg-type]
        out[name] = DistributedEkf(name, options)
    return out


def ablation(options: ReproduceOptions, progress: Progress | None = None) -> Reproduction:
    """Errors at the end of the descents of figs. 17 and 18, for every combination of choices.

    Parameters
    ----------
    options : ReproduceOptions
    progress : callable, optional

    Returns
    -------
    Reproduction
    """
    trials = first_trials(options, MAX_TRIALS)
    data = pa.concat_tables(run_all(_run_trial, trials, options.workers, "ablations", progress))
    error_m = {name: _errors(data, name) for name in dict.fromkeys(data["estimator"].to_pylist())}
    median = {name: float(np.median(values)) for name, values in error_m.items()}
    last = f"end, {len(trials)} trials"
    rows = []
    for name, values in error_m.items():
        printed = name.startswith("EKF: eq. (19)")
        lost = int(np.count_nonzero(np.isinf(values)))
        verdict = NO_NUMBER + (f"; no trajectory in {lost}" if lost else "")
        for quantity, of in (("median", median[name]), ("largest", float(values.max()))):
            value = of if np.isfinite(of) else None
            rows.append(
                Row(
                    "ablation", f"position error, {quantity}", f"{name}; {last}", "m",
                    as_printed=value if printed else None, corrected=None if printed else value,
                    verdict=verdict, headline=quantity == "median",
                )
            )  # fmt: skip
    return Reproduction(
        "ablation", "Effect of single choices of the paper's filter, and of centres in place of rims", rows,
        note(median, len(trials)), _draw(error_m), data,
    )  # fmt: skip


def _errors(data: pa.Table, name: str) -> FloatArray:
    mine = np.array(data["estimator"].to_pylist()) == name
    return np.asarray(data["end_m"].to_numpy()[mine], dtype=np.float64)


def note(median: Mapping[str, float], trials: int) -> str:
    """Paragraph of the figure.

    Parameters
    ----------
    median : mapping of str to float
        Position error at the end by estimator, m: all of `filters`, then the three smoothers. Infinite where
        most trials have no trajectory.
    trials : int

    Returns
    -------
    str
    """
    names = [name for name in median if name.startswith("EKF")]
    values = np.array([median[name] for name in names]).reshape(2, 2, 2)
    choices = ("the ellipse chart for eq. (19)", "each rim's own noise for one Qn", "the prior counted once")
    paper = values[0, 0, 0]
    parts = [f"Medians over the first {trials} trials of figs. 17 and 18, at 10 km."]
    if np.isfinite(paper):
        parts.append(f"The paper's filter ends at {number(paper)} m.")
    alone = _factors(
        [
            (paper, values[1, 0, 0], choices[0]),
            (paper, values[0, 1, 0], choices[1]),
            (paper, values[0, 0, 1], f"{choices[2]}, for eq. (29)"),
        ]
    )
    if alone:
        parts.append(f"One corrected choice alone divides that by {alone}.")
    chart = _factors(
        [(values[1, 0, 0], values[1, 1, 0], choices[1]), (values[1, 0, 0], values[1, 0, 1], choices[2])]
    )
    if chart:
        parts.append(f"With the chart, the error is divided by {chart}.")
    if np.isfinite([paper, values[1, 1, 1]]).all():
        parts.append(f"All three together divide the paper's by {number(paper / values[1, 1, 1])}.")
    if np.isfinite(values).all():
        # Factor by which a corrected choice divides the error, in the geometric mean over the other choices.
        logarithms = np.log(values)
        gains = [float(np.exp(-np.diff(logarithms, axis=axis).mean())) for axis in range(3)]
        parts.append(
            f"In the geometric mean over the other choices the factors are {number(gains[0])}, "
            f"{number(gains[1])} and {number(gains[2])}, so {choices[int(np.argmax(gains))]} has the largest "
            "effect."
        )
    smoothers = {
        CENTRES: "centres taken for the images of the craters' centres",
        ELLIPSE_CENTRES: "the same centres taken for the centres of the ellipses",
        RIMS: "whole rims",
    }
    ends = [
        f"{number(median[name])} m ({what})" for name, what in smoothers.items() if np.isfinite(median[name])
    ]
    if ends:
        parts.append(f"The smoother ends at {listed(ends)}.")
    gained = _factors(
        [
            (median[CENTRES], median[ELLIPSE_CENTRES], "the right model of the centre"),
            (median[ELLIPSE_CENTRES], median[RIMS], "size and shape of the rims"),
        ]
    )
    if gained:
        parts.append(f"Its error is divided by {gained}.")
    lost = [name for name, value in median.items() if not np.isfinite(value)]
    if lost:
        parts.append(f"No trajectory in most trials, hence no factors: {'; '.join(lost)}.")
    return " ".join(parts)


def _factors(changes: Sequence[tuple[float, float, str]]) -> str:
    """List the factors by which errors are divided, and by what; those of a lost trajectory are left out."""
    return listed(
        [
            f"{number(before / after)} ({what})"
            for before, after, what in changes
            if np.isfinite([before, after]).all()
        ]
    )


def _run_trial(trial: Trial) -> pa.Table:
    problem, truth = problem_of(trial)
    centres_only = replace(problem, frames=[_without_shape(frame) for frame in problem.frames])
    runs: dict[str, tuple[Estimator, Problem]] = {
        **{name: (one, problem) for name, one in filters().items()},
        CENTRES: (BatchSmoother(GraphOptions(rims="centre"), CENTRES), problem),
        ELLIPSE_CENTRES: (BatchSmoother(name=ELLIPSE_CENTRES), centres_only),
        RIMS: (BatchSmoother(name=RIMS), problem),
    }
    names, end_m = [], []
    for name, (one, of) in runs.items():
        try:
            error = errors(one.estimate(of), truth).position_m[-1]
        except (EstimationError, np.linalg.LinAlgError):
            error = np.full(3, np.inf)
        names.append(name)
        end_m.append(float(np.linalg.norm(error)))
    return pa.table({"trial": np.full(len(names), trial.number), "estimator": names, "end_m": end_m})


def _without_shape(frame: FrameMeasurement) -> FrameMeasurement:
    """Leave of a frame's rims only the information of the ellipses' centres."""
    scale = np.array([1.0, 1.0, *[np.sqrt(_IGNORED_VARIANCE)] * 3])
    covariance = frame.rims.covariance * np.outer(scale, scale)
    return replace(frame, rims=replace(frame.rims, covariance=covariance))


def _draw(error_m: dict[str, FloatArray]) -> Figure:
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for k, (name, values) in enumerate(error_m.items()):
        kind = "ekf_paper" if "(19)" in name else "ekf" if name.startswith("EKF") else "smoother"
        finite = values[np.isfinite(values)]
        axes.plot(finite, np.full(len(finite), k), ".", color=COLOURS[kind], alpha=0.5)
        axes.plot(np.median(values), k, "|", ms=16, mew=2.5, color=COLOURS[kind])
    axes.set_yticks(range(len(error_m)), list(error_m))
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("position error at 10 km, m: trials, and their median")
    axes.grid(alpha=0.3)
    return figure
