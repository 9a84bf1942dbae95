"""What matching with a prior computes of rims and poses, by itself."""

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body

FloatArray = npt.NDArray[np.float64]


def raised_above_ground(gTc: FloatArray, pose_covariance: FloatArray, body: Body) -> FloatArray:
    """Pose of the camera, raised to its altitude's standard deviation when it is predicted below that."""
    up = gTc[:3, 3] / np.linalg.norm(gTc[:3, 3])
    sigma_m = float(np.sqrt(up @ pose_covariance[3:, 3:] @ up))
    raised = gTc.copy()
    raised[:3, 3] += max(sigma_m - float(body.altitude_m(gTc[:3, 3])), 0.0) * up
    return raised
