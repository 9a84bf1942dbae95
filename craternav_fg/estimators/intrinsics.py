"""Focal length, principal point and radial distortion of the camera as variables of the graph.

Rims are given in the pixels of the camera as it is stated, normalised by its intrinsics. With other
intrinsics their charts change: by the derivatives here, linear in four numbers that all frames share.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K

from craternav_fg.camera import Camera
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.measurements import RimSet
from factors.arrays import FloatArray
from factors.conic_shape import ChartError

INTRINSICS_KEY: int = K(0)
# Share of the focal length; principal point x and y, px; radial distortion k1.
SIZE, RADIAL = 4, 3
# Steps of the central differences, in the units of the four.
_STEPS = np.array([1e-6, 1e-3, 1e-3, 1e-6])


def intrinsic_slopes(charts: FloatArray, camera: Camera) -> FloatArray:
    """Differentiate charts, as the stated camera gives them, in its true intrinsics.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        In normalised image coordinates.
    camera : Camera
        As stated.

    Returns
    -------
    ndarray, shape (n, 5, 4)
        Per share of the focal length, px of the principal point (x, y), and k1; normalised image coordinates.
    """
    columns = []
    for k, step in enumerate(_STEPS):
        z = np.zeros(SIZE)
        z[k] = step
        columns.append((_seen(charts, z, camera) - _seen(charts, -z, camera)) / (2.0 * step))
    return np.stack(columns, axis=-1)


def _seen(charts: FloatArray, z: FloatArray, camera: Camera) -> FloatArray:
    """Charts (n, 5) that the stated camera gives rims which the true one sees at given charts."""
    m = charts[:, :2]
    L = np.zeros((len(charts), 2, 2))
    L[:, 0, 0], L[:, 1, 1] = np.exp(charts[:, 2]), np.exp(charts[:, 4])
    L[:, 1, 0] = L[:, 0, 0] * charts[:, 3]
    r2 = np.sum(m**2, axis=1)[:, None]
    centre = (1.0 + z[0]) * m * (1.0 + z[3] * r2) + z[1:3] / [camera.fx_px, camera.fy_px]
    J = (1.0 + z[3] * r2)[:, :, None] * np.eye(2) + 2.0 * z[3] * m[:, :, None] * m[:, None, :]
    root = (1.0 + z[0]) * J @ L
    S = root @ np.swapaxes(root, 1, 2)
    xx, xy, yy = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    return np.column_stack([centre, 0.5 * np.log(xx), xy / xx, 0.5 * np.log(yy - xy**2 / xx)])


def add_intrinsics(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Add the prior of the intrinsics' variable, in units of its sigmas, and the variable if it is missing.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
    """
    unit = gtsam.noiseModel.Unit.Create(SIZE)
    graph.push_back(gtsam.PriorFactorVector(INTRINSICS_KEY, np.zeros(SIZE), unit))
    if not values.exists(INTRINSICS_KEY):
        values.insert(INTRINSICS_KEY, np.zeros(SIZE))


def intrinsic_error(rims: RimSet, camera: Camera, sigmas: FloatArray) -> ChartError:
    """Return the error of a frame's rims due to the camera's intrinsics.

    Parameters
    ----------
    rims : RimSet
    camera : Camera
        As stated.
    sigmas : ndarray, shape (4,)
        Prior standard deviations: share of the focal length, px, px, k1.

    Returns
    -------
    ChartError
    """
    roots = intrinsic_slopes(rims.chart, camera) * sigmas
    return ChartError([INTRINSICS_KEY] * len(rims), roots)


def estimated_intrinsics(
    marginals: Marginals, values: gtsam.Values, sigmas: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Read the intrinsics from an optimum.

    Parameters
    ----------
    marginals : Marginals
    values : gtsam.Values
    sigmas : ndarray, shape (4,)
        Prior standard deviations: share of the focal length, px, px, k1.

    Returns
    -------
    values, sigmas : ndarray, shape (4,)
        True less stated intrinsics and their standard deviations: share of the focal length, px, px, k1.
    """
    spread = np.sqrt(np.diag(marginals.covariances([INTRINSICS_KEY])[INTRINSICS_KEY]))
    return sigmas * values.atVector(INTRINSICS_KEY), sigmas * spread
