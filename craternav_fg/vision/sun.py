"""The sun's tilt: the direction towards the sun along the ground, as the image shows it.

Relief without preferred direction, lit obliquely, has brightness gradients along the slope contrast G (see
`photometry`) three times as strong, in square, as across it: the axis of the structure tensor is that of G.
Gradients are taken to the ground with the predicted pose, and the G of each block is rotated to a common
axis; the rotation that is left is the azimuth by which the prediction is wrong. The sense along the axis
follows from the mean unit gradient, which points away from the sun.

Craters whose rims have been measured show the direction far better (see `wall_shading`); the relief is for
images without them.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body, ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import SunTilt
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.vision.grey import GreyArray
from craternav_fg.vision.wall_shading import sun_azimuth_offset
from factors.arrays import FloatArray

# Largest standard deviation of the predicted attitude, rad, that decides the sense of the axis.
_MAX_SENSE_SIGMA_RAD = 0.5
# Error of the tilt per error of the predicted attitude, through the foreshortening.
_TILT_PER_ATTITUDE_ERROR = 0.5
# Minimum horizontal part of the unit vector towards the sun: the azimuth is undefined with the sun at the
# zenith.
_MIN_HORIZONTAL_SUN = 0.05
# Minimum part of the direction that is seen across the line of sight: the standard deviation grows with its
# inverse.
_MIN_STRENGTH = 1e-3
# Blocks with a mean brightness, of 255, above this may hold saturated pixels.
_MAX_BLOCK_BRIGHTNESS = 245.0
# Minimum mean unit gradient that decides the sense of the axis, in standard deviations.
_SENSE_SIGMAS = 3.0


@dataclass(frozen=True)
class SunOptions:
    """How the sun's tilt is measured, and its systematic errors.

    Attributes
    ----------
    blur_px : float
        Standard deviation of the Gaussian blur before gradients are taken: suppresses sensor noise.
    block_px : int
        Side of the blocks whose scatter gives the standard deviation.
    min_blocks : int
        Minimum number of usable blocks.
    min_slope_contrast : float
        Minimum slope contrast of a usable block.
    min_emission_cosine : float
        Minimum cosine of a usable block's emission angle.
    min_anisotropy : float
        Least (l1 - l2) / (l1 + l2) of the structure tensor; isotropic relief gives 1/2.
    min_contrast_per_px : float
        Minimum root mean square gradient, relative to the brightness, per pixel.
    floor_rad, floor_oblique_rad : float
        Systematic standard deviation of the direction from the relief: looking straight down, and in
        proportion to the sine of the emission angle, added in quadrature.
    crater_floor_rad, crater_floor_oblique_rad : float
        The same of the direction from craters: seen obliquely, it depends on the ground's reflectance law.
        Rendered ground determines `floor_rad` and does not contradict the other three, see
        `craternav_fg.calibration`.
    max_sigma_rad : float
        Largest standard deviation of a measurement.
    """

    blur_px: float = 1.5
    block_px: int = 64
    min_blocks: int = 12
    min_slope_contrast: float = 0.15
    min_emission_cosine: float = 0.25
    min_anisotropy: float = 0.08
    min_contrast_per_px: float = 0.002
    floor_rad: float = float(np.deg2rad(2.0))
    floor_oblique_rad: float = float(np.deg2rad(8.0))
    crater_floor_rad: float = float(np.deg2rad(0.3))
    crater_floor_oblique_rad: float = float(np.deg2rad(7.5))
    max_sigma_rad: float = float(np.deg2rad(25.0))


def measure_sun_tilt(
    image: GreyArray,
    camera: Camera,
    body: Body,
    gTb: FloatArray,
    sun_g: FloatArray,
    options: SunOptions | None = None,
    attitude_sigma_rad: float = 0.0,
    craters: Catalog | None = None,
) -> SunTilt | None:
    """Measure the direction towards the sun along the ground, at the image centre.

    Parameters
    ----------
    image : ndarray of uint8 or float32, shape (H, W)
        Grey levels up to 255.
    camera : Camera
    body : Body
        Sphere about the origin of g.
    gTb : ndarray, shape (4, 4)
        Predicted pose of the body in g.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    options : SunOptions, optional
    attitude_sigma_rad : float
        Standard deviation of the predicted attitude. It enters that of the tilt through the foreshortening,
        and decides whether the prediction may give the sense of an axis if the brightness does not.
    craters : Catalog, optional
        Those whose rims have been measured where the pose puts them.

    Returns
    -------
    SunTilt or None
        None when the image does not show it: no relief in sight, no slope contrast, the sun at the zenith or
        below the horizon, an axis that its own scatter leaves undecided, or a sense that a known attitude
        contradicts.
    """
    options = options or SunOptions()
    gTc = camera.gTc(gTb)
    gRc, gPc = gTc[:3, :3], gTc[:3, 3]
    point = np.zeros(2)
    foot, hit = ground_points(gRc, gPc, point[None], body.radius_m)
    if not hit[0]:
        return None
    normal = foot[0] / np.linalg.norm(foot[0])
    azimuth = sun_g - (sun_g @ normal) * normal
    if sun_g @ normal <= 0.0 or np.linalg.norm(azimuth) < _MIN_HORIZONTAL_SUN:
        return None
    offset, sigma = 0.0, np.inf
    if craters is not None and len(craters) > 0:
        offset, sigma = sun_azimuth_offset(image.astype(np.float32, copy=False), camera, craters, gTb, sun_g)
        floor_rad, oblique_rad = options.crater_floor_rad, options.crater_floor_oblique_rad
    if not np.isfinite(sigma):
        offset, sigma = _relief_offset(image, camera, body, gRc, gPc, sun_g, options, attitude_sigma_rad)
        floor_rad, oblique_rad = options.floor_rad, options.floor_oblique_rad
    if not np.isfinite(sigma):
        return None
    range_m = float(np.linalg.norm(gPc - foot[0]))
    sine = float(np.linalg.norm(np.cross(normal, gPc - foot[0]))) / range_m
    systematic = (floor_rad, oblique_rad * sine, _TILT_PER_ATTITUDE_ERROR * attitude_sigma_rad)
    sigma = float(np.linalg.norm([sigma, *systematic]))
    measured = frames.rotation_exp(normal * offset) @ azimuth
    s = gRc.T @ measured
    x, y = s[0] - point[0] * s[2], s[1] - point[1] * s[2]
    strength = float(np.hypot(x, y) / np.linalg.norm(s))
    sigma /= max(strength, _MIN_STRENGTH)
    if sigma > options.max_sigma_rad:
        return None
    return SunTilt(float(np.arctan2(y, x)), sigma, point, azimuth)


def _relief_offset(
    image: GreyArray,
    camera: Camera,
    body: Body,
    gRc: FloatArray,
    gPc: FloatArray,
    sun_g: FloatArray,
    options: SunOptions,
    attitude_sigma_rad: float,
) -> tuple[float, float]:
    """Azimuth of the sun against the prediction, rad, and its standard deviation; inf when unknown."""
    blocks = _block_gradients(image, camera, body, gRc, gPc, sun_g, options)
    if blocks is None or len(blocks[0]) < options.min_blocks:
        return 0.0, np.inf
    offset, sigma, sign = _axis(*blocks, options)
    known = attitude_sigma_rad < _MAX_SENSE_SIGMA_RAD
    if (sign == 0.0 and not known) or (sign < 0.0 and known):
        return 0.0, np.inf
    return (offset if sign >= 0.0 else offset + np.pi), sigma


def _block_statistics(
    image: GreyArray, options: SunOptions
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute the statistics of the image's blocks.

    Returns their centres (n, 2), px, means of gx^2, gx gy, gy^2 (n, 3) and of the unit gradient (n, 2), and
    mean brightness (n,).
    """
    size = options.block_px
    rows, columns = image.shape[0] // size, image.shape[1] // size
    used = image[: rows * size, : columns * size]
    smooth = cv2.GaussianBlur(used, (0, 0), options.blur_px, dst=None).astype(np.float32)
    # Neighbours in the blurred image share most of their noise: every second pixel will do.
    smooth = smooth[::2, ::2]
    half = size // 2
    gx, gy = np.zeros_like(smooth), np.zeros_like(smooth)
    gx[:, 1:-1] = np.float32(0.25) * (smooth[:, 2:] - smooth[:, :-2])
    gy[1:-1] = np.float32(0.25) * (smooth[2:] - smooth[:-2])

    def per_block(values: npt.NDArray[np.float32]) -> FloatArray:
        cells = values.reshape(rows, half, columns, half)
        return np.asarray(cells.mean(axis=(1, 3), dtype=np.float64).ravel())

    length = np.sqrt(gx * gx + gy * gy) + np.float32(1e-6)
    squares = np.stack([per_block(gx * gx), per_block(gx * gy), per_block(gy * gy)], axis=-1)
    unit = np.stack([per_block(gx / length), per_block(gy / length)], axis=-1)
    x_px, y_px = ((np.arange(n) + 0.5) * size - 0.5 for n in (columns, rows))
    centre_px = np.stack(np.meshgrid(x_px, y_px), axis=-1).reshape(-1, 2)
    return centre_px, squares, unit, per_block(smooth)


def _block_gradients(
    image: GreyArray,
    camera: Camera,
    body: Body,
    gRc: FloatArray,
    gPc: FloatArray,
    sun_g: FloatArray,
    options: SunOptions,
) -> tuple[FloatArray, FloatArray] | None:
    """Structure tensors (n, 2, 2) and mean unit gradients (n, 2) of blocks, on the ground.

    The first axis of each is that of the predicted slope contrast, the second is rotated by 90 deg about the
    outward normal.
    """
    if min(image.shape) < options.block_px:
        return None
    centre_px, J, unit, mean = _block_statistics(image, options)
    points = camera.normalised(centre_px)
    ground, hit = ground_points(gRc, gPc, points, body.radius_m)
    normals = ground / np.linalg.norm(ground, axis=-1, keepdims=True)
    view = gPc - ground
    range_m = np.linalg.norm(view, axis=-1)
    view /= range_m[:, None]
    _, contrast = flat_terrain_brightness(normals, sun_g, view)
    strength = np.linalg.norm(contrast, axis=-1)
    relative = np.sqrt(J[:, 0] + J[:, 2]) / np.maximum(mean, 1.0)
    keep = (
        hit
        & (np.sum(normals * view, axis=-1) > options.min_emission_cosine)
        & (strength > options.min_slope_contrast)
        & (relative > options.min_contrast_per_px)
        & (mean < _MAX_BLOCK_BRIGHTNESS)
    )
    if not np.any(keep):
        return None
    t1 = contrast[keep] / strength[keep, None]
    t2 = np.cross(normals[keep], t1)
    # Image motion, px, of a metre along each tangent: B (n, 2, 2), columns t1, t2.
    depth = (ground[keep] - gPc) @ gRc[:, 2]
    B = np.empty((len(t1), 2, 2))
    for k, tangent in enumerate((t1, t2)):
        c = tangent @ gRc
        B[:, :, k] = (c[:, :2] - points[keep] * c[:, 2:]) / depth[:, None]
    B = camera.pixels_jacobian(points[keep]) @ B
    tensor = np.empty((len(t1), 2, 2))
    tensor[:, 0, 0], tensor[:, 1, 1] = J[keep, 0], J[keep, 2]
    tensor[:, 0, 1] = tensor[:, 1, 0] = J[keep, 1]
    # Gradients go to the ground by B'; blocks count by their relief, not by their brightness or size.
    tensors = np.swapaxes(B, 1, 2) @ tensor @ B
    tensors /= np.sqrt(np.trace(tensors, axis1=1, axis2=2))[:, None, None] + 1e-300
    norm = np.median(np.trace(tensors, axis1=1, axis2=2))
    units = np.einsum("nki,nk->ni", B, unit[keep])
    units /= np.sqrt(np.abs(np.linalg.det(B)))[:, None]
    return tensors / max(float(norm), 1e-300), units


def _axis(tensors: FloatArray, units: FloatArray, options: SunOptions) -> tuple[float, float, float]:
    """Azimuth of the axis against the prediction, rad, its standard deviation (inf: none), and its sense.

    The sense is 1 as predicted, -1 opposite, 0 if undecided.
    """
    cos2 = tensors[:, 0, 0] - tensors[:, 1, 1]
    sin2 = 2.0 * tensors[:, 0, 1]
    trace = tensors[:, 0, 0] + tensors[:, 1, 1]
    c, s, total = cos2.sum(), sin2.sum(), trace.sum()
    anisotropy = float(np.hypot(c, s) / total)
    if not anisotropy > options.min_anisotropy:
        return 0.0, np.inf, 1.0
    offset = 0.5 * np.arctan2(s, c)
    # Scatter of the blocks across the axis.
    across = -np.sin(2.0 * offset) * cos2 + np.cos(2.0 * offset) * sin2
    sigma = 0.5 * float(np.sqrt(np.sum(across**2))) / (anisotropy * total)
    along = units @ np.array([np.cos(offset), np.sin(offset)])
    mean = float(along.mean())
    scatter = float(along.std() / np.sqrt(len(along)))
    # The gradient points away from the sun.
    sign = -float(np.sign(mean)) if abs(mean) > _SENSE_SIGMAS * scatter else 0.0
    return float(offset), sigma, sign
