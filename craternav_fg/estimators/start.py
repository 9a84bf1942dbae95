"""The common start: the first frame's maximum a posteriori pose.

From a prior of 25 deg and 4 km the first frame's problem has many local minima. Lowering the measurement
noise in steps from 300 times its size (annealing) lets the well-determined coarse geometry decide first.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from craternav_fg.estimators.base import Descent, Start
from craternav_fg.estimators.graph import GraphOptions, add_frame, pose_covariance_in_g
from craternav_fg.estimators.optimise import levenberg_marquardt
from craternav_fg.measurements import FrameMeasurement

NOISE_SCALES = (300.0, 30.0, 3.0, 1.0)


def first_frame_map(
    descent: Descent,
    frame: FrameMeasurement,
    options: GraphOptions = GraphOptions(),
) -> Start:
    """Pose at the first frame from the prior, all its craters and its sun tilt.

    Parameters
    ----------
    descent : Descent
    frame : FrameMeasurement
        The first; without craters and sun the start is the prior.
    options : GraphOptions
        Loss and kind of measurement.

    Returns
    -------
    Start
        The covariance is Gaussian at the optimum: honest with three craters or more, too small with
        one, where the posterior bends.
    """
    initial = descent.initial
    sigmas = np.repeat([initial.attitude_sigma_rad, initial.position_sigma_m], 3)
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(initial.gTb))
    for scale in NOISE_SCALES:
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(
            gtsam.PriorFactorPose3(X(0), gtsam.Pose3(initial.gTb), gtsam.noiseModel.Diagonal.Sigmas(sigmas))
        )
        add_frame(graph, descent, options, X(0), frame, scale)
        values = levenberg_marquardt(graph, values).values
    information, _ = graph.linearize(values).hessian()
    # Scaled before inversion: radians and metres differ by six orders of magnitude.
    scales = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scales, scales)) * np.outer(scales, scales)
    gTb = values.atPose3(X(0)).matrix()
    return Start(np.ascontiguousarray(gTb), pose_covariance_in_g(covariance, gTb[:3, :3]))
