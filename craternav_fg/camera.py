"""The camera on the lander: a pinhole behind a lens that may distort."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from craternav_fg import frames, lens
from factors.arrays import FloatArray

# Along each side of the image, to find how far the distortion must reach.
_BORDER_POINTS = 33


@dataclass(frozen=True)
class Camera:
    """Camera with OpenCV axes: x right, y down, z along the optical axis.

    Pixel (0, 0) is the centre of the top-left pixel. Normalised image coordinates are x_c / z_c and y_c / z_c
    of a direction, without distortion. A lens that distorts does not image an ellipse as an ellipse; ellipses
    in pixels are therefore given in the pixels of `pinhole`.

    Attributes
    ----------
    width_px, height_px : int
        Image size.
    fx_px, fy_px : float
        Focal lengths.
    cx_px, cy_px : float
        Principal point.
    bTc : ndarray, shape (4, 4)
        Mounting (camera-IMU extrinsics): pose of the camera in b.
    distortion : tuple of float
        Coefficients of the lens, see `lens`: k1, k2, p1, p2, k3 unless `lens_model` says otherwise.
    psf_sigma_px : float
        Standard deviation of the point-spread function, with the pixels' own blur. The default is typical of
        optics whose resolution matches the pixels.
    bit_depth : int
        Bits of a grey level.
    lens_model : str
        "radial-tangential", "rational" or "fisheye".
    focal_sigma_percent, principal_sigma_px : float or None
        How well the intrinsics are known: standard deviations of the focal length and of each coordinate of
        the principal point; None where nobody states them.
    lever_arm_sigma_m : float or None
        Standard deviation of each coordinate of the camera's position in b, m; None where nobody states it.
    mounting_sigma_deg : float or None
        Standard deviation about each axis of b of the camera's rotation in b; None where nobody states it.

    Raises
    ------
    ValueError
        When the lens is wrong, or folds inside the image, see `lens.parameters` and `lens.reach_of`.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    bTc: FloatArray = field(default_factory=lambda: np.eye(4))
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    psf_sigma_px: float = 0.7
    bit_depth: int = 8
    lens_model: str = lens.RADIAL_TANGENTIAL
    focal_sigma_percent: float | None = None
    principal_sigma_px: float | None = None
    lever_arm_sigma_m: float | None = None
    mounting_sigma_deg: float | None = None

    def __post_init__(self) -> None:
        # Computed here, so that a camera whose distortion folds is never made.
        _ = self.lens

    @property
    def mounting_sigma_rad(self) -> float:
        """Standard deviation about each axis of the camera's rotation in b; 0 where nobody states it."""
        return float(np.radians(self.mounting_sigma_deg or 0.0))

    def mounting_covariance(self, share: float = 1.0) -> FloatArray:
        """Compute what stated errors of the mounting add to a pose of b that images give.

        Images give the pose of the camera. A small error of its rotation in b turns b by the same rotation
        vector, and moves its origin by what that turn moves the lever arm.

        Parameters
        ----------
        share : float
            Of the information on the attitude that comes from the image, not from a known attitude of b.

        Returns
        -------
        ndarray, shape (6, 6)
            Covariance of (rotation vector in b, rad; position in b, m); zero where no error is stated.
        """
        slopes = np.vstack([share * np.eye(3), frames.cross_matrix(self.bTc[:3, 3])])
        covariance = self.mounting_sigma_rad**2 * slopes @ slopes.T
        covariance[3:, 3:] += (self.lever_arm_sigma_m or 0.0) ** 2 * np.eye(3)
        return np.asarray(covariance)

    @cached_property
    def pinhole(self) -> "Camera":
        """The same camera without distortion."""
        if not self.distorts:
            return self
        return replace(self, distortion=(0.0,) * 5, lens_model=lens.RADIAL_TANGENTIAL)

    @property
    def distorts(self) -> bool:
        """Whether the lens distorts."""
        return self.lens_model == lens.FISHEYE or any(self.distortion)

    @cached_property
    def lens(self) -> FloatArray:
        """Parameters for kernels, shape (14,): fx, fy, cx, cy, px, and those of `lens`, its reach last."""
        reach, own = np.inf, lens.parameters(self.lens_model, self.distortion)
        if self.distorts:
            # Half a pixel beyond the outermost centres: the whole of their pixels.
            border = self.border_px(_BORDER_POINTS, -0.5)
            border = (border - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]
            reach = lens.reach_of(own, border)
        return np.array([self.fx_px, self.fy_px, self.cx_px, self.cy_px, *own, reach])

    @property
    def full_scale(self) -> int:
        """Largest grey level of the images: 2^bits - 1."""
        return int(2**self.bit_depth - 1)

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths."""
        return float(np.sqrt(self.fx_px * self.fy_px))

    @property
    def matrix(self) -> FloatArray:
        """Calibration matrix (3, 3), px: from the camera frame to homogeneous pixels of `pinhole`."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def border_px(self, count: int, margin_px: float = 0.0) -> FloatArray:
        """Place points along the four sides of the image.

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
        sides = np.empty((4, count, 2))
        sides[:2, :, 0], sides[2:, :, 1] = x, y
        for k, end in enumerate((0, -1)):
            sides[k, :, 1], sides[2 + k, :, 0] = y[end], x[end]
        return sides.reshape(-1, 2)

    def gTc(self, gTb: FloatArray) -> FloatArray:
        """Compute poses of the camera from poses of the lander.

        Parameters
        ----------
        gTb : ndarray, shape (..., 4, 4)
            Poses of the lander in g.

        Returns
        -------
        ndarray, shape (..., 4, 4)
            Poses of the camera in g.
        """
        return gTb @ self.bTc

    def normalised(self, points_px: FloatArray) -> FloatArray:
        """Convert pixels to normalised image coordinates.

        Parameters
        ----------
        points_px : ndarray, shape (..., 2)
            Pixels of the image as it is.

        Returns
        -------
        ndarray, shape (..., 2)
            Normalised image coordinates; NaN where the distortion has no inverse.
        """
        points = np.asarray((points_px - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px])
        return self._through_lens(points, inverse=True)[..., :2] if self.distorts else points

    def pixels(self, points: FloatArray) -> FloatArray:
        """Convert normalised image coordinates to pixels.

        Parameters
        ----------
        points : ndarray, shape (..., 2)
            Normalised image coordinates.

        Returns
        -------
        ndarray, shape (..., 2)
            Pixels of the image as it is.
        """
        if self.distorts:
            points = self._through_lens(points, inverse=False)[..., :2]
        return np.asarray(points * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px])

    def pixels_jacobian(self, points: FloatArray) -> FloatArray:
        """Differentiate `pixels`.

        Parameters
        ----------
        points : ndarray, shape (..., 2)
            Normalised image coordinates.

        Returns
        -------
        ndarray, shape (..., 2, 2)
            Derivatives of the pixels in the normalised image coordinates.
        """
        focal = np.diag([self.fx_px, self.fy_px])
        if not self.distorts:
            return np.broadcast_to(focal, (*np.shape(points)[:-1], 2, 2))
        J = self._through_lens(points, inverse=False)[..., 2:]
        return np.asarray(focal @ J.reshape(*J.shape[:-1], 2, 2))

    def _through_lens(self, points: FloatArray, *, inverse: bool) -> FloatArray:
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 2)
        return np.asarray(lens.distort_all(flat, self.lens[4:], inverse)).reshape(*np.shape(points)[:-1], 6)

    def project(self, points_c: FloatArray) -> FloatArray:
        """Project points.

        Parameters
        ----------
        points_c : ndarray, shape (..., 3)
            Positions in the camera frame, m, all in front of the camera.

        Returns
        -------
        ndarray, shape (..., 2)
            Pixels of the image as it is.
        """
        return self.pixels(points_c[..., :2] / points_c[..., 2:])

    def contains(self, points_px: FloatArray, margin_px: float = 0.0) -> npt.NDArray[np.bool_]:
        """Determine which points lie in the image.

        Parameters
        ----------
        points_px : ndarray, shape (..., 2)
            Pixels.
        margin_px : float
            Minimum distance from the centres of the outermost pixels; negative: outside.

        Returns
        -------
        ndarray of bool, shape (...,)
        """
        x, y = points_px[..., 0], points_px[..., 1]
        return np.asarray(
            (x >= margin_px)
            & (y >= margin_px)
            & (x <= self.width_px - 1 - margin_px)
            & (y <= self.height_px - 1 - margin_px)
        )
