"""Rims that a pose predicts in an image: their ellipses, slope contrast and reference brightness."""

from dataclasses import dataclass, fields

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import pixel_chart, semi_minor_bound
from craternav_fg.photometry import flat_terrain_brightness, lunar_lambert_share, slope_curvature
from craternav_fg.vision.reference_brightness import MIN_REFERENCE_BRIGHTNESS, ReferenceBrightness
from craternav_fg.vision.rim_shading import RimShading
from factors.arrays import FloatArray, IntArray
from factors.kernels import conic

# Largest diameter of a rim that does not shape the brightness of the whole image, over its shorter side.
_SMALL_SHARE = 0.25


@dataclass(frozen=True)
class PredictedRims:
    """Predicted rims of one frame, in the image without lens distortion.

    Attributes
    ----------
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    charts : ndarray, shape (n, 5)
        Ellipse charts in normalised image coordinates.
    charts_px : ndarray, shape (n, 5)
        The same in the pixels of `Camera.pinhole`.
    slope_contrast : ndarray, shape (n,)
        Relative change of brightness per unit slope, see `photometry`.
    contrast_px : ndarray, shape (n, 2)
        The same as a vector in the image, per pixel of crater radius, see `edge_kernel.trace_rim`.
    curvature_px : ndarray, shape (n, 2, 2)
        Second-order change of brightness with slope, in the image, per square pixel of crater radius.
    to_sun_px, to_camera_px, cosines, lommel_share : ndarray, shapes (n, 2), (n, 2), (n, 2), (n,)
        See `RimShading`.
    phase_rad : ndarray, shape (n,)
        Phase angle at the centre.
    reference : ndarray, shape (n,)
        Reference brightness: that of locally flat terrain there, 0 to 255.
    gradient : ndarray, shape (n, 2)
        Relative change of the reference brightness along the image, 1/px.
    jacobians : ndarray, shape (n, 5, 6)
        Derivative of the charts in the right twist of the body's pose (rotation, rad; translation in b, m).
    """

    rows: IntArray
    charts: FloatArray
    charts_px: FloatArray
    slope_contrast: FloatArray
    contrast_px: FloatArray
    curvature_px: FloatArray
    to_sun_px: FloatArray
    to_camera_px: FloatArray
    cosines: FloatArray
    lommel_share: FloatArray
    phase_rad: FloatArray
    reference: FloatArray
    gradient: FloatArray
    jacobians: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, keep: IntArray) -> "PredictedRims":
        """Select some rims.

        Parameters
        ----------
        keep : ndarray of int, shape (k,)
            Their indices.
        """
        return PredictedRims(*(getattr(self, field.name)[keep] for field in fields(self)))

    def shading(self, i: int) -> RimShading:
        """Return what is expected of the brightness around a rim."""
        return RimShading(
            float(self.reference[i]), self.gradient[i], self.contrast_px[i], self.curvature_px[i],
            self.to_sun_px[i], self.to_camera_px[i], self.cosines[i], float(self.lommel_share[i]),
        )  # fmt: skip

    def smallest_radius_px(self, i: int) -> float:
        """Return the approximate semi-minor axis of a rim, px."""
        return float(semi_minor_bound(self.charts_px[i]))

    def smallest_radii_px(self) -> FloatArray:
        """Return the approximate semi-minor axes of all rims.

        Returns
        -------
        ndarray, shape (n,)
            px.
        """
        return np.array([self.smallest_radius_px(i) for i in range(len(self))])

    def reach_px(self, px: float, share: float) -> FloatArray:
        """Return the half lengths of the normals on which rims are searched.

        Parameters
        ----------
        px, share : float
            Constant part, px, and part of the semi-minor axis.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.asarray(px + share * self.smallest_radii_px())

    def motion_px(self, camera: Camera) -> FloatArray:
        """Differentiate the rims' centres, px, in the right twist of the body's pose.

        Parameters
        ----------
        camera : Camera

        Returns
        -------
        ndarray, shape (n, 2, 6)
        """
        return np.array([[camera.fx_px], [camera.fy_px]]) * self.jacobians[:, :2]


def predict_rims(
    rows: IntArray,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    sun_g: FloatArray,
    brightness: ReferenceBrightness,
) -> PredictedRims:
    """Predict rims from a pose.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        Craters in the catalogue.
    camera : Camera
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    brightness : ReferenceBrightness

    Returns
    -------
    PredictedRims
        Without those that the pose cannot see, and those on ground too dark to show an edge.
    """
    centres = catalog.centres[rows]
    charts, H, seen = conic.chart_jacobian(gTb, camera.bTc, centres, catalog.axes[rows])
    rows, centres, charts, H = rows[seen], centres[seen], charts[seen], H[seen]
    gTc = camera.gTc(gTb)
    view = gTc[:3, 3] - centres
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    law, contrast = flat_terrain_brightness(catalog.normals[rows], sun_g, view, brightness.law)
    centres_c = (centres - gTc[:3, 3]) @ gTc[:3, :3]
    points = centres_c[:, :2] / centres_c[:, 2:]
    radius_m = np.sqrt(catalog.semi_major_m[rows] * catalog.semi_minor_m[rows])
    # From vectors along the ground, in g, to pixels per radius.
    to_image = gTc[:3, :2].T - points[:, :, None] * gTc[:3, 2]
    to_image *= (np.array([camera.fx_px, camera.fy_px]) * (radius_m / centres_c[:, 2])[:, None])[:, :, None]
    curvature = slope_curvature(catalog.normals[rows], sun_g, view, brightness.law)
    reference = law * brightness.ratio(points)
    normals = catalog.normals[rows]
    cosines = np.stack([normals @ sun_g, np.sum(normals * view, axis=-1)], axis=-1)
    phase_rad = np.arccos(np.clip(view @ sun_g, -1.0, 1.0))
    lit = reference > MIN_REFERENCE_BRIGHTNESS
    return PredictedRims(
        rows[lit],
        charts[lit],
        pixel_chart(charts[lit], camera),
        np.linalg.norm(contrast[lit], axis=-1),
        np.einsum("nij,nj->ni", to_image[lit], contrast[lit]),
        to_image[lit] @ curvature[lit] @ np.swapaxes(to_image[lit], 1, 2),
        np.einsum("nij,nj->ni", to_image[lit], (sun_g - cosines[:, :1] * normals)[lit]),
        np.einsum("nij,nj->ni", to_image[lit], (view - cosines[:, 1:] * normals)[lit]),
        cosines[lit],
        lunar_lambert_share(phase_rad[lit], brightness.law),
        phase_rad[lit],
        reference[lit],
        _gradient(rows[lit], camera, catalog, gTc, sun_g, brightness) / reference[lit, None],
        H[lit],
    )


def _gradient(
    rows: IntArray,
    camera: Camera,
    catalog: Catalog,
    gTc: FloatArray,
    sun_g: FloatArray,
    brightness: ReferenceBrightness,
) -> FloatArray:
    """Change (n, 2) of the reference brightness per pixel, from the four ends of each rim's axes.

    Where a rim takes up much of the image, it shapes the ratio itself, and the law alone tells.
    """
    centres, axes = catalog.centres[rows], catalog.axes[rows]
    ends = centres[:, None, None] + np.array([1.0, -1.0])[:, None] * axes[:, :, None]
    view = gTc[:3, 3] - ends
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    normals = ends / np.linalg.norm(ends, axis=-1, keepdims=True)
    law, _ = flat_terrain_brightness(normals.reshape(-1, 3), sun_g, view.reshape(-1, 3), brightness.law)
    ends_c = (ends - gTc[:3, 3]) @ gTc[:3, :3]
    points = ends_c[..., :2] / ends_c[..., 2:]
    step_px = (points[:, :, 0] - points[:, :, 1]) * [camera.fx_px, camera.fy_px]
    length_px = np.linalg.norm(step_px, axis=-1).max(axis=-1)
    small = length_px < _SMALL_SHARE * min(camera.width_px, camera.height_px)
    centre = points.mean(axis=(1, 2), keepdims=True)
    ratio = brightness.ratio(np.where(small[:, None, None, None], points, centre).reshape(-1, 2))
    values = (law * ratio).reshape(-1, 2, 2)
    return np.asarray(np.linalg.solve(step_px, (values[:, :, :1] - values[:, :, 1:]))[:, :, 0])
