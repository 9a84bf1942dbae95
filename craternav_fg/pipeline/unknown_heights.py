"""Trajectories over a catalogue without heights: what the height of the ground adds to their covariance.

Where a catalogue does not say how high its rims lie, the sphere is assumed. Ground that is higher as a whole
shifts the trajectory up with it, and no rim shows that.
"""

from dataclasses import replace

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from craternav_fg.trajectory import Trajectory

# Standard deviation of the ground's height above the sphere, in radii. Chosen: on the Moon and on Mars ground
# differs from the sphere by kilometres, about a thousandth of the radius.
HEIGHT_SIGMA_RADII = 1e-3
# Uses no rims, so that their heights do not matter.
_UNAIDED = "dead_reckoning"


def height_sigma_m(body: Body) -> float:
    """Give the standard deviation of the ground's height above a body's sphere, m.

    Parameters
    ----------
    body : Body
    """
    return HEIGHT_SIGMA_RADII * body.radius_m


def with_unknown_height(name: str, trajectory: Trajectory, catalog: Catalog) -> Trajectory:
    """Add the variance of the ground's common height to the covariances of positions, if it is unknown.

    Parameters
    ----------
    name : str
        Name of the estimator.
    trajectory : Trajectory
    catalog : Catalog

    Returns
    -------
    Trajectory
        That of an estimator without rims, and over rims of known heights, as it is.
    """
    if catalog.has_heights or name == _UNAIDED or trajectory.pose_covariance is None:
        return trajectory
    up = trajectory.gTb[:, :3, 3] / np.linalg.norm(trajectory.gTb[:, :3, 3], axis=1, keepdims=True)
    covariance = trajectory.pose_covariance.copy()
    covariance[:, 3:, 3:] += height_sigma_m(catalog.body) ** 2 * up[:, :, None] * up[:, None, :]
    return replace(trajectory, pose_covariance=covariance)
