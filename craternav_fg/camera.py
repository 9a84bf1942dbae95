"""A pinhole camera on the lander, and ellipses in its pixels."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Pinhole camera without distortion; OpenCV axes: x right, y down, z along the optical axis.

    Pixel (0, 0) is the centre of the top-left pixel.

    Attributes
    ----------
    width_px, height_px : int
        Image size.
    fx_px, fy_px : float
        Focal lengths.
    cx_px, cy_px : float
        Principal point.
    bTc : ndarray, shape (4, 4)
        Mounting: pose of the camera in the lander's body frame.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    bTc: FloatArray = field(default_factory=lambda: np.eye(4))

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths."""
        return float(np.sqrt(self.fx_px * self.fy_px))

    @property
    def matrix(self) -> FloatArray:
        """Calibration matrix, shape (3, 3)."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def gTc(self, gTb: FloatArray) -> FloatArray:
        """Camera poses in g, shape (..., 4, 4), of lander poses `gTb`."""
        return gTb @ self.bTc

    def normalised(self, points_px: FloatArray) -> FloatArray:
        """Normalised coordinates u = x_c / z_c, shape (..., 2), of pixels (..., 2)."""
        return (points_px - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]

    def pixels(self, points: FloatArray) -> FloatArray:
        """Pixels (..., 2) of normalised coordinates (..., 2)."""
        return np.asarray(points * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px])

    def project(self, points_c: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame, all of them in front of the camera."""
        return self.pixels(points_c[..., :2] / points_c[..., 2:])

    def contains(self, points_px: FloatArray, margin_px: float = 0.0) -> npt.NDArray[np.bool_]:
        """Whether pixels (..., 2) lie in the image, `margin_px` away from its border."""
        x, y = points_px[..., 0], points_px[..., 1]
        return np.asarray(
            (x >= margin_px)
            & (y >= margin_px)
            & (x <= self.width_px - 1 - margin_px)
            & (y <= self.height_px - 1 - margin_px)
        )


def normalised_chart(chart_px: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Chart (..., 5) in normalised coordinates of a chart in pixels, and the derivative's diagonal (5,)."""
    scale = np.array([1.0 / camera.fx_px, 1.0 / camera.fy_px, 1.0, camera.fx_px / camera.fy_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return (chart_px - offset) * scale, scale


def pixel_chart(chart: FloatArray, camera: Camera) -> FloatArray:
    """Chart (..., 5) in pixel coordinates of a chart in normalised coordinates."""
    scale = np.array([camera.fx_px, camera.fy_px, 1.0, camera.fy_px / camera.fx_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return np.asarray(chart * scale + offset)


def ellipse_chart(cx: float, cy: float, r1: float, r2: float, phi_rad: float) -> FloatArray:
    """Chart (5,) of an ellipse with centre (cx, cy), semi-axes r1 and r2, r1 at phi from x towards y."""
    c, d = np.cos(phi_rad), np.sin(phi_rad)
    sxx = (r1 * c) ** 2 + (r2 * d) ** 2
    sxy = (r1**2 - r2**2) * c * d
    # The determinant of S is (r1 r2)^2: no digits are lost on a thin ellipse.
    return np.array([cx, cy, 0.5 * np.log(sxx), sxy / sxx, np.log(r1 * r2) - 0.5 * np.log(sxx)])
