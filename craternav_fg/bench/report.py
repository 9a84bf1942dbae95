"""The whole benchmark: ratios, cost over size, and their figure."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from craternav_fg.bench import ratios
from craternav_fg.bench.compare import SPREAD
from craternav_fg.bench.detect import detect_ms
from craternav_fg.bench.floors import batch_errors_floor, batch_steps, factor_floor, online_errors_floor
from craternav_fg.bench.guided import guided_costs
from craternav_fg.bench.identification import identify_scalars
from craternav_fg.bench.images import render_costs
from craternav_fg.bench.pipeline import pipeline_ms
from craternav_fg.bench.problems import make, tracked
from craternav_fg.bench.ratios import Online, Ratio
from craternav_fg.bench.resection import resection_scalars
from craternav_fg.bench.timing import peak_mb
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.files import replacing
from factors.arrays import FloatArray

Report = Callable[[str, int, int], None]

OURS, REFERENCE = "#0072B2", "#D55E00"


@dataclass(frozen=True)
class Sizes:
    """Sizes of the problems.

    Attributes
    ----------
    frames : tuple of int
        Frames of the batch optimiser's scaling.
    craters : tuple of int
        In a frame, of the factor's scaling.
    batch_frames : int
        Frames of the batch ratio, 5 craters each.
    online_frames : int
        Frames of the online run, 10 craters each.
    lag_frames : int
        Frames of the fixed-lag run, 10 craters each.
    online_runs : int
        Repetitions of both.
    resection_problems : int
        Problems of the resection solver, of each size.
    images : int
        In which rims are detected and measured, of each kind of terrain.
    views : int
        In which craters are identified.
    """

    frames: tuple[int, ...]
    craters: tuple[int, ...]
    batch_frames: int
    online_frames: int
    lag_frames: int
    online_runs: int
    resection_problems: int
    images: int
    views: int


# In the order of the fields of `Sizes`; `FULL` adds 10,000 online frames, which take minutes.
QUICK = Sizes((100, 300, 1000, 3000, 10_000), (1, 3, 10, 30, 100), 600, 1000, 300, 3, 200, 3, 100)
FULL = Sizes((100, 300, 1000, 3000, 10_000), (1, 3, 10, 30, 100), 600, 10_000, 1000, 3, 1000, 6, 1000)
# Frames of the descent with errors that last.
TRACKED_FRAMES = 75
# Lag of the fixed-lag smoother that is timed: the default of `fixed_lag`.
LAG_S = 30.0


@dataclass(frozen=True)
class Result:
    """Measured costs.

    Attributes
    ----------
    ratios : dict of str to Ratio
        By the names of the JSON output.
    scalars : dict of str to float
        By the names of the JSON output: numbers that are no ratios to the reference.
    factor : ndarray, shape (n, 3)
        Number of craters in a frame; time per frame of ours and of the reference, us.
    batch : ndarray, shape (n, 2)
        Number of frames; time of ours, s.
    online : Online
        The last run.
    """

    ratios: dict[str, Ratio]
    scalars: dict[str, float]
    factor: FloatArray
    batch: FloatArray
    online: Online

    def json(self) -> dict[str, float | list[float]]:
        """Return all numbers by name: median, 10 % and 90 % points and wall-clock median of each ratio."""
        out: dict[str, float | list[float]] = {}
        for name, ratio in self.ratios.items():
            out[name] = ratio.median
            out[f"{name}{SPREAD}"] = [ratio.low, ratio.high]
            out[f"{name}_wall"] = ratio.wall
        return {**out, **self.scalars}


def run(sizes: Sizes, report: Report) -> Result:
    """Measure everything.

    Parameters
    ----------
    sizes : Sizes
    report : callable
        Called with a description, the number of finished steps and the number of all steps.

    Returns
    -------
    Result
    """
    steps = len(sizes.craters) + len(sizes.frames) + 2 * sizes.online_runs + 12
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        report("benchmark", done, steps)

    began = time.perf_counter(), time.process_time()
    measured: dict[str, Ratio] = {}
    factor = []
    for craters in sizes.craters:
        ratio = ratios.factor_ratio(make(100, craters))
        factor.append((craters, ratio.ours_us, ratio.reference_us))
        step()
    for craters in (10, 30):
        bench = make(100, craters)
        measured[f"factor_ratio_n{craters}"] = ratios.factor_ratio(bench)
        measured[f"factor_ratio_landmark_n{craters}"] = ratios.factor_ratio(bench, landmarks=True)
        measured[f"factor_floor_n{craters}"] = factor_floor(bench)
        step()
    bench = make(sizes.batch_frames, 5)
    measured["batch_ratio"] = ratios.batch_ratio(bench)
    steps_of_batch, counts = batch_steps(bench)
    measured.update(steps_of_batch)
    step()
    batch_s = ratios.batch_seconds([make(frames, 5) for frames in sizes.frames])
    for _ in sizes.frames:
        step()
    online = []
    lagged = []
    for seed in range(sizes.online_runs):
        online.append(ratios.online(make(sizes.online_frames, 10, seed)))
        step()
        lagged.append(ratios.online(make(sizes.lag_frames, 10, seed), LAG_S))
        step()
    measured["online_mean_ratio"] = _over_runs(online, lambda s: s.mean(axis=0))
    measured["online_p99_ratio"] = _over_runs(online, lambda s: np.percentile(s, 99, axis=0))
    measured["fixed_lag_ratio"] = _over_runs(lagged, lambda s: s.mean(axis=0))
    problem = tracked(TRACKED_FRAMES, 10)
    measured["errors_batch_ratio"] = ratios.errors_ratio(BatchSmoother, problem)
    measured["errors_batch_floor"] = batch_errors_floor(problem)
    step()
    measured["errors_online_ratio"] = ratios.errors_ratio(OnlineSmoother, problem)
    measured["errors_online_floor"] = online_errors_floor(problem)
    step()
    ekf_step_us = ratios.ekf_step_us(make(100, 10))
    step()
    exponents = [ratios.exponent(sizes.frames, turn_s) for turn_s in batch_s]
    scalars = {
        "ekf_step_us": ekf_step_us,
        "scaling_exponent_batch": float(np.median(exponents)),
        "online_flatness": float(np.median([run.flatness for run in online])),
        "online_frames_per_s": 1.0 / float(np.mean([run.ours_s[:, 0].mean() for run in online])),
        "online_frames": float(sizes.online_frames),
        **counts,
        **resection_scalars(sizes.resection_problems),
    }
    step()
    scalars.update(render_costs())
    step()
    scalars.update(detect_ms(sizes.images))
    step()
    scalars.update(identify_scalars(sizes.views))
    step()
    scalars.update(guided_costs(sizes.images))
    step()
    scalars.update(pipeline_ms())
    step()
    scalars["bench_wall_s"] = time.perf_counter() - began[0]
    scalars["bench_cpu_s"] = time.process_time() - began[1]
    scalars["bench_peak_mb"] = peak_mb()
    curve = np.stack([np.array(sizes.frames, dtype=np.float64), np.median(batch_s, axis=0)], axis=1)
    return Result(measured, scalars, np.array(factor), curve, online[-1])


def write_figure(result: Result, path: Path) -> None:
    """Draw cost over size: factor over craters, batch over frames, online over the descent."""
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    factor, batch, online = figure.subplots(1, 3)
    factor.loglog(result.factor[:, 0], result.factor[:, 1], "o-", color=OURS, label="ours, stacked")
    factor.loglog(result.factor[:, 0], result.factor[:, 2], "s--", color=REFERENCE, label="GTSAM, C++")
    factor.set(xlabel="craters in a frame", ylabel="linearise a frame, us")
    factor.legend(frameon=False)
    batch.loglog(result.batch[:, 0], result.batch[:, 1], "o-", color=OURS)
    batch.set(xlabel="frames, 5 craters each", ylabel="batch, s")
    batch.set_title(f"exponent {result.scalars['scaling_exponent_batch']:.2f}", fontsize=10)
    width = max(1, len(result.online.ours_s) // 50)
    for seconds, colour, label in (
        (result.online.ours_s[:, 0], OURS, "ours"),
        (result.online.reference_s[:, 0], REFERENCE, "GTSAM, C++"),
    ):
        blocks = seconds[: len(seconds) // width * width].reshape(-1, width)
        online.semilogy(
            width * (np.arange(len(blocks)) + 0.5), 1e3 * blocks.mean(axis=1), color=colour, label=label
        )
    online.set(xlabel="frame, 10 craters each", ylabel="online, ms a frame")
    online.legend(frameon=False)
    for axes in (factor, batch, online):
        axes.grid(alpha=0.3, which="both")
    with replacing(path) as temporary:
        FigureCanvasAgg(figure).print_figure(temporary, dpi=150, format=path.suffix.lstrip(".") or "png")


def _over_runs(runs: list[Online], statistic: Callable[[FloatArray], FloatArray]) -> Ratio:
    ours, reference = (
        np.array([statistic(one) for one in side])
        for side in ([run.ours_s for run in runs], [run.reference_s for run in runs])
    )
    return ratios.summary(ours, reference)
