"""Craters of the catalogue for the maps of a run: those along its whole ground track."""

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

IntArray = npt.NDArray[np.intp]


def near_track(catalog: Catalog, trajectory: Trajectory, body: Body, reach_altitudes: float) -> IntArray:
    """Find the craters near the ground track of a trajectory.

    Parameters
    ----------
    catalog : Catalog
    trajectory : Trajectory
    body : Body
    reach_altitudes : float
        Reach on both sides of the track, as a multiple of the highest altitude.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the catalogue, rising.
    """
    gP = trajectory.gP
    ground = gP * (body.radius_m / np.linalg.norm(gP, axis=1, keepdims=True))
    # Between two frames the track is half their distance from one of them at most.
    between_m = 0.5 * np.linalg.norm(np.diff(ground, axis=0), axis=1).max(initial=0.0)
    reach_m = reach_altitudes * np.abs(body.altitude_m(gP)).max() + between_m
    away_m, _ = cKDTree(ground).query(catalog.centres, distance_upper_bound=reach_m)
    return np.flatnonzero(np.isfinite(away_m))


def outlines(catalog: Catalog, rows: IntArray, points: int) -> FloatArray:
    """Outline rims of the catalogue.

    Parameters
    ----------
    catalog : Catalog
    rows : ndarray of int, shape (n,)
    points : int
        Of a rim, of which the last is the first again.

    Returns
    -------
    ndarray, shape (n, points, 3)
        In g, m.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, points)[None, :, None]
    axes = catalog.axes[rows]
    outline = np.cos(angle) * axes[:, None, 0] + np.sin(angle) * axes[:, None, 1]
    return np.asarray(catalog.centres[rows][:, None] + outline)
