"""Intersection of lines of sight with a sphere around the body's centre."""

import numpy as np

from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def distance_to_sphere(along: float, range2: float, radius: float) -> float:
    """Distance from a point to where a ray from it first meets a sphere; -1 when it does not.

    Parameters
    ----------
    along : float
        Distance along the ray to the point of it that is nearest to the sphere's centre.
    range2 : float
        Squared distance of the point from the sphere's centre.
    radius : float
        The sphere's radius, in the same unit.
    """
    under = along * along - (range2 - radius * radius)
    if not (along > 0.0 and under > 0.0):
        return -1.0
    return along - np.sqrt(under)
