"""The common start: the maximum a posteriori pose at the first frame that shows a known crater.

From a prior of 25 deg and 4 km that frame's problem has many local minima. Annealing, which lowers the
measurement noise in steps from 300 times its size, lets the well-determined coarse geometry decide first.
After minutes without rims the prior is far wider. Where that leads to a pose from which most rims are out of
sight, the pose of the rims alone, which needs no prior, is the start of a second optimisation.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, add_frame
from craternav_fg.estimators.optimise import levenberg_marquardt
from craternav_fg.frames import rotate_position_block
from craternav_fg.linalg import scaled_inverse
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Factors of the measurement noise in successive optimisations: large first, so that a poor prior converges.
ANNEALING_SCALES = (300.0, 30.0, 3.0, 1.0)


def find_start(
    descent: Descent, frames: Sequence[FrameMeasurement], options: GraphOptions = GraphOptions()
) -> Start:
    """Pose at the first frame with a rim, from the propagated prior, its rims and its sun tilt.

    Parameters
    ----------
    descent : Descent
    frames : sequence of FrameMeasurement
        At least one; without a rim in any the start is the prior at the first.
    options : GraphOptions
        Loss and kind of measurement.

    Returns
    -------
    Start
        The covariance is Gaussian at the optimum: consistent with three craters or more, too small with one,
        where the posterior is curved.

    Raises
    ------
    ValueError
        When the IMU log does not cover the interval up to the frame.
    """
    index = next((k for k, frame in enumerate(frames) if len(frame.rims)), None)
    if index is None:
        prior = filter_state.prior(descent)
        return Start(prior.gTb, prior.covariance[filter_state.POSE, filter_state.POSE], 0)
    prior = filter_state.propagated_prior(descent, frames[: index + 1])[-1]
    # GTSAM's position errors are in body axes.
    of_pose = prior.covariance[filter_state.POSE, filter_state.POSE]
    covariance = rotate_position_block(of_pose, prior.gTb[:3, :3].T)
    noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))
    expected = gtsam.PriorFactorPose3(X(0), gtsam.Pose3(prior.gTb), noise)

    def optimum(gTb: FloatArray, scales: Sequence[float]) -> tuple[FactorGraph, gtsam.Values]:
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose3(gTb))
        for scale in scales:
            graph = FactorGraph()
            graph.push_back(expected)
            add_frame(graph, descent, options, X(0), frames[index], noise_scale=scale)
            values = levenberg_marquardt(graph, values).values
        return graph, values

    graph, values = optimum(prior.gTb, ANNEALING_SCALES)
    if _out_of_sight(descent, frames[index], values.atPose3(X(0)).matrix()):
        rims = MatchedRims.of(frames[index].rims, descent.catalog)
        found = solve(ResectionProblem(rims, descent.camera.bTc, sun=frames[index].sun)).poses
        if found:
            graph, values = optimum(found[0].gTb, ANNEALING_SCALES[-1:])
    information, _ = graph.linearize(values).hessian()
    posterior = scaled_inverse(information)
    gTb = np.ascontiguousarray(values.atPose3(X(0)).matrix())
    return Start(gTb, rotate_position_block(posterior, gTb[:3, :3]), index)


def _out_of_sight(descent: Descent, frame: FrameMeasurement, gTb: FloatArray) -> bool:
    """Whether most of a frame's rims cannot be seen from a pose: nothing then corrects it."""
    rows = frame.rims.craters
    centres, axes = descent.catalog.centres[rows], descent.catalog.axes[rows]
    seen = project_rims(np.ascontiguousarray(gTb), descent.camera.bTc, centres, axes)[1]
    return bool(2 * np.count_nonzero(seen) < len(rows))


def make_problem(descent: Descent, frames: Sequence[FrameMeasurement]) -> Problem:
    """State the problem that estimators solve: a descent, its frames and the start that `find_start` gives.

    Parameters
    ----------
    descent : Descent
    frames : sequence of FrameMeasurement
        At least one.

    Returns
    -------
    Problem

    Raises
    ------
    ValueError
        When the IMU log does not cover the interval up to the start's frame.
    """
    return Problem(**vars(descent), start=find_start(descent, frames), frames=frames)
