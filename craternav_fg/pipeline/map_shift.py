"""Trajectories over a catalogue whose craters are shifted in common: what that adds to their covariance.

Where a catalogue does not say how high its rims lie, the sphere is assumed, and the common shift includes the
height of the ground.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray


def with_common_shift(
    name: str, trajectory: Trajectory, catalog: Catalog, frames: Sequence[FrameMeasurement]
) -> Trajectory:
    """Add the covariance of the map's common shift to those of poses.

    Parameters
    ----------
    name : str
        Name of the estimator.
    trajectory : Trajectory
    catalog : Catalog
    frames : sequence of FrameMeasurement
        What the trajectory rests on, see `common_covariance`.

    Returns
    -------
    Trajectory
        That of an estimator without rims as it is.
    """
    covariance = trajectory.pose_covariance
    if covariance is None or name == DeadReckoning.name:
        return trajectory
    return replace(trajectory, pose_covariance=covariance + common_covariance(trajectory, catalog, frames))


def common_covariance(
    trajectory: Trajectory, catalog: Catalog, frames: Sequence[FrameMeasurement]
) -> FloatArray:
    """Compute the covariance that the map's common shift adds to poses which rest on its craters.

    Parameters
    ----------
    trajectory : Trajectory
    catalog : Catalog
    frames : sequence of FrameMeasurement
        With craters of several sources, each source's shift counts by what its craters contribute to the
        whole trajectory.

    Returns
    -------
    ndarray, shape (k, 6, 6)
        As `Trajectory.pose_covariance`: rotation vector in b, rad; position in g, m.
    """
    return catalog.shift_covariance(trajectory.gTb, _weights(trajectory, catalog, frames))


def _weights(trajectory: Trajectory, catalog: Catalog, frames: Sequence[FrameMeasurement]) -> FloatArray:
    """Weights (n,) of the craters: the inverse of the least variance of their places on the ground, 1/m^2.

    Most of the error belongs to the crater: it is the same in all frames that show it. An arc gives the place
    across the rim only, to the mean of its points.
    """
    positions = dict(zip(trajectory.stamps_ns.tolist(), trajectory.gP, strict=True))
    out = np.zeros(len(catalog))
    for frame in frames:
        if frame.stamp_ns not in positions:
            continue
        arcs = frame.arcs
        of_rims = frame.rims.covariance[:, [0, 1], [0, 1]].mean(axis=1)
        of_arcs = np.array([1.0 / np.sum(sigmas**-2.0) for sigmas in arcs.sigmas])
        if arcs.correlated_sigmas is not None:
            of_arcs = of_arcs + arcs.correlated_sigmas**2
        for rows, variance in ((frame.rims.craters, of_rims), (arcs.craters, of_arcs)):
            range_m = np.linalg.norm(catalog.centres[rows] - positions[frame.stamp_ns], axis=1)
            out[rows] = np.maximum(out[rows], 1.0 / (variance * range_m**2))
    return out
