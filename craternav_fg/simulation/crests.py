"""Offsets of the rendered rim crests from the projected rims of the catalogue."""

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.render import Renderer
from factors.arrays import FloatArray

# Samples of the terrain along a rim's normal.
_SAMPLES = 17


def crest_offsets_px(
    renderer: Renderer,
    catalog: Catalog,
    gTb: FloatArray,
    rows: npt.NDArray[np.int64],
    count: int = 16,
    reach_px: float = 1.6,
) -> FloatArray:
    """Distance of the rim crest outside the projected rim, along the rim's normals.

    The crest is where the terrain's slope away from the crater's centre changes sign, over the sphere, at
    the points where rays through the pixels meet the terrain.

    Parameters
    ----------
    renderer : Renderer
        Its camera coincides with the body and has no distortion.
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Pose of body and camera in g.
    rows : ndarray of int, shape (n,)
        Craters.
    count : int
        Normals around each rim.
    reach_px : float
        Half length of the normals.

    Returns
    -------
    ndarray, shape (n, count)
        Pixels of the renderer's camera; NaN where no crest is within reach.
    """
    theta = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    offsets = np.linspace(-reach_px, reach_px, _SAMPLES)
    out = np.full((len(rows), count), np.nan)

    def seen(row: int, angles: FloatArray) -> FloatArray:
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        points = catalog.centres[row] + c * catalog.axes[row, 0] + s * catalog.axes[row, 1]
        return renderer.camera.project((points - gTb[:3, 3]) @ gTb[:3, :3])

    for k, row in enumerate(rows.tolist()):
        rim_px = seen(row, theta)
        along = seen(row, theta + 1e-4) - rim_px
        normal = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=1)[:, None]
        normal *= np.sign(np.sum(normal * (rim_px - rim_px.mean(axis=0)), axis=1, keepdims=True))
        px = rim_px[:, None] + offsets[:, None] * normal[:, None]
        points, ground = (
            (of_ground @ catalog.gRl[row]).reshape(count, _SAMPLES, 3)
            for of_ground in renderer.ground_points(gTb, px.reshape(-1, 2))
        )
        outward = np.stack(
            [
                np.cos(theta) / catalog.semi_major_m[row],
                np.sin(theta) / catalog.semi_minor_m[row],
                np.zeros(count),
            ],
            axis=-1,
        )[:, None]
        up = points / np.linalg.norm(points, axis=-1, keepdims=True)
        level = outward - np.sum(up * outward, axis=-1, keepdims=True) * up
        rise = -np.sum(ground * level, axis=-1) / np.sum(ground * up, axis=-1)
        for a in range(count):
            cross = np.flatnonzero((rise[a, :-1] > 0.0) & (rise[a, 1:] <= 0.0))
            if len(cross):
                i = cross[np.argmin(np.abs(offsets[cross]))]
                out[k, a] = np.interp(0.0, -rise[a, i : i + 2], offsets[i : i + 2])
    return out
