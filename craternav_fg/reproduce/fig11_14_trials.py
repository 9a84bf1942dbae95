"""Monte Carlo trials behind figs. 11 to 14: resection of one image with noisy rims by every method.

The paper's methods start at the truth, as if a filter had predicted it well: the comparison is of their
equations, not of their convergence. Where an optimiser stops without convergence, the pose that it reached
counts, and the data say so. The efficient solver has no start; where an image allows several poses, the one
nearest to the truth counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pyarrow as pa

from craternav_fg import frames
from craternav_fg.reproduce.edge_points import measure, pixel_arc, pose_bound
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.resection import efficient
from craternav_fg.resection.least_squares import minimise
from craternav_fg.resection.paper import equations
from craternav_fg.resection.paper.centres import centre_pose
from craternav_fg.resection.paper.equations import PaperRims
from craternav_fg.resection.problem import ResectionProblem, Status
from craternav_fg.simulation.flat_scenes import FlatScene, random_scene
from factors.arrays import FloatArray

# Methods as the columns of the data name them.
CENTRES = "centres"
EDGES_PRINTED = "edges_printed"
EDGES = "edges"
TWO_PRINTED = "two_craters_printed"
TWO = "two_craters"
SHAPES = "shapes"
EFFICIENT = "efficient"
PAPERS = (CENTRES, EDGES_PRINTED, EDGES, TWO_PRINTED, TWO, SHAPES)
METHODS = (*PAPERS, EFFICIENT)
# Methods that need a third crater.
OF_THREE = (CENTRES, EDGES_PRINTED, EDGES)

# Trials of a task for a process.
_BATCH = 25
# Errors drawn from the bound's Gaussian in each trial, for the mean of their length.
_DRAWS = 200
# With the printed sign the minimisation does not converge; a few trials show it.
PRINTED_TRIALS = 5


@dataclass(frozen=True)
class Batch:
    """Some trials of one condition.

    Attributes
    ----------
    craters : int
    altitude_m, noise_px, arc : float
    points : tuple of int
    semi_axes_m : tuple of float
    seed, first, last : int
        Trials first to last - 1.
    """

    craters: int
    altitude_m: float
    noise_px: float
    arc: float
    points: tuple[int, int]
    semi_axes_m: tuple[float, float]
    seed: int
    first: int
    last: int


def run_batch(batch: Batch) -> list[dict[str, float]]:
    """Return the errors of every method in every trial of a batch; NaN where a method finds no pose.

    `converged` of a method of the paper is 0 where the error is that of the pose at which it stopped.
    """
    return [_run_trial(batch, trial) for trial in range(batch.first, batch.last)]


def _run_trial(batch: Batch, trial: int) -> dict[str, float]:
    rng = np.random.default_rng([batch.seed, 11, batch.craters, round(batch.altitude_m), trial])
    scene = random_scene(rng, batch.craters, batch.altitude_m, batch.semi_axes_m)
    counts = rng.integers(batch.points[0], batch.points[1] + 1, batch.craters)
    problem, bound = measure(scene, rng, counts, batch.arc, batch.noise_px)
    record = {
        "craters": float(batch.craters),
        "altitude_m": batch.altitude_m,
        "noise_px": batch.noise_px,
        "trial": float(trial),
        "fitted": float(problem is not None),
        "solutions": 0.0,
    }
    poses: dict[str, tuple[FloatArray, bool]] = {}
    if problem is not None:
        poses = _paper_poses(problem, scene, printed=trial < PRINTED_TRIALS)
        result = efficient.solve(problem)
        # The poses of an undetermined problem are samples of a continuum, not solutions.
        if result.status in (Status.SOLVED, Status.AMBIGUOUS):
            record["solutions"] = float(len(result.poses))
            nearest = min((pose.gTb for pose in result.poses), key=lambda gTc: _error_m(scene, gTc))
            poses[EFFICIENT] = nearest, True
    for method in METHODS:
        gTc, converged = poses.get(method, (None, None))
        if method in PAPERS:
            record[f"{method}_converged"] = np.nan if converged is None else float(converged)
        record[f"{method}_m"] = np.nan if gTc is None else _error_m(scene, gTc)
        record[f"{method}_deg"] = np.nan if gTc is None else _error_deg(scene, gTc)
    for block, unit in ((bound[3:, 3:], "m"), (np.degrees(1.0) ** 2 * bound[:3, :3], "deg")):
        draws = rng.normal(size=(_DRAWS, 3)) @ np.linalg.cholesky(block).T
        record[f"bound_rms_{unit}"] = float(np.sqrt(np.trace(block)))
        record[f"bound_mean_{unit}"] = float(np.linalg.norm(draws, axis=1).mean())
    arcs = [pixel_arc(rng, chart, int(count)) for chart, count in zip(scene.charts, counts, strict=True)]
    record["arc_bound_rms_m"] = float(np.sqrt(np.trace(pose_bound(scene, arcs, batch.noise_px)[3:, 3:])))
    return record


def _error_m(scene: FlatScene, gTc: FloatArray) -> float:
    return float(np.linalg.norm((gTc - scene.gTc)[:3, 3]))


def _error_deg(scene: FlatScene, gTc: FloatArray) -> float:
    turn = frames.rotation_log(gTc[:3, :3].T @ scene.gTc[:3, :3])
    return float(np.degrees(np.linalg.norm(turn)))


def _paper_poses(
    problem: ResectionProblem, scene: FlatScene, *, printed: bool
) -> dict[str, tuple[FloatArray, bool]]:
    """Poses (4, 4) that the paper's methods reach from the truth, and whether they converged.

    Equations as printed are solved when `printed`.
    """
    seen = PaperRims(problem.rims)
    enough = len(problem.rims) >= 3
    systems = {
        EDGES: partial(equations.edges, seen),
        TWO: partial(equations.two_craters, seen),
        SHAPES: partial(equations.conic_shapes, seen),
    }
    if printed:
        systems[EDGES_PRINTED] = partial(equations.edges, seen, printed_sign=True)
        systems[TWO_PRINTED] = partial(equations.two_craters, seen, printed_sign=True)
    out = {
        method: minimise(system, scene.gTc)
        for method, system in systems.items()
        if enough or method not in OF_THREE
    }
    if enough:
        out[CENTRES] = centre_pose(seen, scene.gTc)
    return out


def simulate(
    options: ReproduceOptions,
    craters: int,
    extra: Sequence[tuple[float, float]] = (),
    progress: Progress | None = None,
) -> pa.Table:
    """Run all trials of one number of craters.

    Parameters
    ----------
    options : ReproduceOptions
    craters : int
    extra : sequence of tuple of float
        Altitude, m, and noise, px, of further conditions.
    progress : callable, optional

    Returns
    -------
    pyarrow.Table
        A row per trial: the errors of each method, NaN where it finds no pose; whether it converged; the
        bound.
    """
    conditions = [(1e3 * km, options.noise_px) for km in altitudes_km(options)] + list(extra)
    batches = [
        Batch(
            craters, altitude, noise, options.arc, options.points, options.semi_axes_m, options.seed, first,
            min(first + _BATCH, options.trials),
        )
        for altitude, noise in conditions
        for first in range(0, options.trials, _BATCH)
    ]  # fmt: skip
    results = run_all(run_batch, batches, options.workers, f"poses of {craters} craters", progress)
    return pa.Table.from_pylist([record for result in results for record in result])


def altitudes_km(options: ReproduceOptions) -> list[float]:
    """Altitudes of figs. 11 to 14."""
    return [float(km) for km in np.unique(np.linspace(*options.altitudes_km, options.altitude_steps))]
