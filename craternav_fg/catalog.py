"""The crater catalogue: rims as ellipses on the body, and which of them a camera sees."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Catalog:
    """Catalogue craters. A rim is a planar ellipse, level at its centre, `height_m` above the sphere.

    Attributes
    ----------
    identifiers : tuple of str, length n
        Unique names.
    latitude_rad, longitude_rad : ndarray, shape (n,)
        Rim centre; longitude counts to the east.
    semi_major_m, semi_minor_m : ndarray, shape (n,)
        Rim semi-axes a >= b > 0.
    angle_rad : ndarray, shape (n,)
        Of the major axis, from local east towards north.
    height_m : ndarray, shape (n,)
        Of the rim's plane above the reference sphere, at the centre.
    body : Body
        The body it describes.
    """

    identifiers: tuple[str, ...]
    latitude_rad: FloatArray
    longitude_rad: FloatArray
    semi_major_m: FloatArray
    semi_minor_m: FloatArray
    angle_rad: FloatArray
    height_m: FloatArray
    body: Body

    def __len__(self) -> int:
        return len(self.identifiers)

    def take(self, rows: IntArray) -> "Catalog":
        """Return the craters of some rows."""
        return Catalog(
            tuple(self.identifiers[row] for row in rows),
            self.latitude_rad[rows],
            self.longitude_rad[rows],
            self.semi_major_m[rows],
            self.semi_minor_m[rows],
            self.angle_rad[rows],
            self.height_m[rows],
            self.body,
        )

    @cached_property
    def gRl(self) -> FloatArray:
        """Rotations (n, 3, 3) from each crater's local frame l (x along a, y along b, z outward) to g."""
        enu = frames.east_north_up(self.latitude_rad, self.longitude_rad)
        cos, sin = np.cos(self.angle_rad)[:, None], np.sin(self.angle_rad)[:, None]
        l1 = cos * enu[:, :, 0] + sin * enu[:, :, 1]
        l2 = -sin * enu[:, :, 0] + cos * enu[:, :, 1]
        return np.stack([l1, l2, enu[:, :, 2]], axis=-1)

    @cached_property
    def centres(self) -> FloatArray:
        """Rim centres gL (n, 3) in g, m."""
        return (self.body.radius_m + self.height_m)[:, None] * self.gRl[:, :, 2]

    @cached_property
    def axes(self) -> FloatArray:
        """Semi-axes a l1 and b l2 in g, shape (n, 2, 3), m."""
        sizes = np.stack([self.semi_major_m, self.semi_minor_m], axis=-1)
        return np.ascontiguousarray(sizes[:, :, None] * np.swapaxes(self.gRl[:, :, :2], 1, 2))

    @cached_property
    def normals(self) -> FloatArray:
        """Outward unit normals (n, 3) of the rim planes in g."""
        return np.ascontiguousarray(self.gRl[:, :, 2])

    def visible(
        self, camera: Camera, gTb: FloatArray, *, min_semi_minor_px: float, margin_px: float = 0.0
    ) -> tuple[IntArray, FloatArray]:
        """Craters whose whole rim a camera sees.

        Parameters
        ----------
        camera : Camera
            With its mounting.
        gTb : ndarray, shape (4, 4)
            Pose of the body in g.
        min_semi_minor_px : float
            Smallest semi-minor axis of the rim's image, without distortion.
        margin_px : float
            How far inside the image's border the rim's bounding box must stay; negative: outside.

        Returns
        -------
        craters : ndarray of int, shape (k,)
            Rows of the catalogue, in their order.
        charts : ndarray, shape (k, 5)
            Their images in the ellipse chart.
        """
        charts, seen = conic.project_rims(gTb, camera.bTc, self.centres, self.axes)
        rows = np.flatnonzero(seen)
        charts = charts[rows]
        centre_px, S = chart_to_pixels(camera, charts)
        half = np.sqrt(np.stack([S[:, 0, 0], S[:, 1, 1]], axis=-1))
        small = np.sqrt(np.linalg.eigvalsh(S)[:, 0]) if len(rows) else np.empty(0)
        if camera.distorts:
            inside = np.all(camera.contains(camera.pixels(rim_points(charts)), margin_px), axis=-1)
        else:
            inside = camera.contains(centre_px - half, margin_px) & camera.contains(
                centre_px + half, margin_px
            )
        keep = inside & (small >= min_semi_minor_px)
        return rows[keep], charts[keep]


def rim_points(charts: FloatArray, count: int = 48) -> FloatArray:
    """Points (..., count, 2) around ellipses given by their charts (..., 5), in the charts' coordinates."""
    charts = np.asarray(charts)[..., None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    x = np.exp(charts[..., 2]) * np.cos(angle)
    y = charts[..., 3] * x + np.exp(charts[..., 4]) * np.sin(angle)
    return np.stack([charts[..., 0] + x, charts[..., 1] + y], axis=-1)


def chart_to_pixels(camera: Camera, charts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ellipses in the pixels of `camera.pinhole`: centres m (..., 2) and matrices S (..., 2, 2).

    Their points x have (x - m)' S^-1 (x - m) = 1.
    """
    charts = np.asarray(charts)
    sxx = np.exp(2.0 * charts[..., 2])
    sxy = charts[..., 3] * sxx
    syy = np.exp(2.0 * charts[..., 4]) + charts[..., 3] * sxy
    fx, fy = camera.fx_px, camera.fy_px
    S = np.stack([fx * fx * sxx, fx * fy * sxy, fx * fy * sxy, fy * fy * syy], axis=-1)
    return camera.pinhole.pixels(charts[..., :2]), S.reshape(*charts.shape[:-1], 2, 2)
