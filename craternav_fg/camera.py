"""The camera on the lander, and ellipses in its pixels."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from craternav_fg import lens

FloatArray = npt.NDArray[np.float64]

# Along each side of the image, to find how far the distortion must reach.
_BORDER_POINTS = 33


@dataclass(frozen=True)
class Camera:
    """Pinhole camera whose lens may distort; OpenCV axes: x right, y down, z along the optical axis.

    Pixel (0, 0) is the centre of the top-left pixel. Normalised coordinates are those of directions,
    x_c / z_c: without distortion. An ellipse in them is none in the pixels of a lens that distorts;
    ellipses in pixels are therefore given in those of `pinhole`.

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
    distortion : tuple of float
        Radial-tangential: k1, k2, p1, p2, k3 (see `lens`).
    psf_sigma_px : float
        Standard deviation of the point-spread function; without a better knowledge that of optics which
        the pixels just sample.
    bit_depth : int
        Bits of the images' grey levels.

    Raises
    ------
    ValueError
        When the distortion folds inside the image.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    bTc: FloatArray = field(default_factory=lambda: np.eye(4))
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    psf_sigma_px: float = 0.7
    bit_depth: int = 8

    def __post_init__(self) -> None:
        # Computed here, so that a camera that folds is never made.
        _ = self.lens

    @cached_property
    def pinhole(self) -> "Camera":
        """The same camera without distortion."""
        return replace(self, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)) if self.distorts else self

    @property
    def distorts(self) -> bool:
        """Whether the lens distorts."""
        return any(self.distortion)

    @cached_property
    def lens(self) -> FloatArray:
        """For kernels, shape (10,): fx, fy, cx, cy, px; k1, k2, p1, p2, k3 and the reach of `lens`."""
        reach = np.inf
        if self.distorts:
            # Half a pixel beyond the outermost centres: the whole of their pixels.
            border = self.border_px(_BORDER_POINTS, -0.5)
            border = (border - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]
            reach = lens.reach_of(self.distortion, border)
        return np.array([self.fx_px, self.fy_px, self.cx_px, self.cy_px, *self.distortion, reach])

    @property
    def full_scale(self) -> int:
        """Largest grey level of the images."""
        return int(2**self.bit_depth - 1)

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths."""
        return float(np.sqrt(self.fx_px * self.fy_px))

    @property
    def matrix(self) -> FloatArray:
        """Calibration matrix, shape (3, 3)."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def border_px(self, count: int, margin_px: float = 0.0) -> FloatArray:
        """Give points along the four sides of the image.

        Parameters
        ----------
        count : int
            Points of each side, its corners among them.
        margin_px : float
            Distance inside the centres of the outermost pixels; negative: outside.

        Returns
        -------
        ndarray, shape (4 * count, 2)
            Pixels: the upper, the lower, the left and the right side.
        """
        x = np.linspace(margin_px, self.width_px - 1 - margin_px, count)
        y = np.linspace(margin_px, self.height_px - 1 - margin_px, count)
        sides = [np.stack(np.broadcast_arrays(x, end), axis=-1) for end in (y[0], y[-1])]
        sides += [np.stack(np.broadcast_arrays(end, y), axis=-1) for end in (x[0], x[-1])]
        return np.concatenate(sides)

    def gTc(self, gTb: FloatArray) -> FloatArray:
        """Camera poses in g, shape (..., 4, 4), of lander poses `gTb`."""
        return gTb @ self.bTc

    def normalised(self, points_px: FloatArray) -> FloatArray:
        """Normalised coordinates u = x_c / z_c, shape (..., 2), of pixels (..., 2)."""
        points = np.asarray((points_px - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px])
        return self._through_lens(points, inverse=True)[..., :2] if self.distorts else points

    def pixels(self, points: FloatArray) -> FloatArray:
        """Pixels (..., 2) of normalised coordinates (..., 2)."""
        if self.distorts:
            points = self._through_lens(points, inverse=False)[..., :2]
        return np.asarray(points * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px])

    def pixels_jacobian(self, points: FloatArray) -> FloatArray:
        """Give the derivative (..., 2, 2) of `pixels` at normalised coordinates (..., 2)."""
        focal = np.diag([self.fx_px, self.fy_px])
        if not self.distorts:
            return np.broadcast_to(focal, (*np.shape(points)[:-1], 2, 2))
        J = self._through_lens(points, inverse=False)[..., 2:]
        return np.asarray(focal @ J.reshape(*J.shape[:-1], 2, 2))

    def _through_lens(self, points: FloatArray, *, inverse: bool) -> FloatArray:
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 2)
        return np.asarray(lens.distort_all(flat, self.lens[4:], inverse)).reshape(*np.shape(points)[:-1], 6)

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
