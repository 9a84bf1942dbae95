"""Acquisition of the pose of one image from a poor prior; see the package's docstring."""

from dataclasses import dataclass

import numpy as np

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.frames import rotate_position_block
from craternav_fg.linalg import scaled_inverse
from craternav_fg.matching.acquire.detected_rims import COARSE, DetectedRims, detect_rims
from craternav_fg.matching.acquire.hypotheses import (
    Craters,
    Prior,
    Rims,
    count_explained,
    expand_inliers,
    poses_of_single_rims,
)
from craternav_fg.matching.acquire.score import log10_improbability
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.vision.detect import BlindOptions
from craternav_fg.vision.grey import on_8_bit_scale, undistorted
from factors.arrays import FloatArray, IntArray
from factors.kernels import conic

# Craters are taken to be at no less than this share of their range from the predicted position.
_MIN_RANGE_SHARE = 0.2
# Standard deviations of the predicted position by which a crater may be nearer.
_POSITION_SIGMAS = 3.0
# Minimum cosine of the angle between the line of sight and a crater's normal, and minimum slope contrast.
_MIN_COS_SLANT = 0.15
_MIN_CONTRAST = 0.1
# Bounds on predicted craters, over the distance of the farthest border from the principal point.
_REACH_FACTOR = 1.2
# Places in the image, as shares of its width and height, at which the spread of a prediction is computed.
_SPREAD_PLACES = np.array([0.1, 0.5, 0.9])


@dataclass(frozen=True)
class AcquireOptions:
    """Extent of the search, and when a pose is accepted.

    Attributes
    ----------
    detect : BlindOptions
        Options of the detection of rims.
    seeds : int
        Number of rims, the largest first, that are taken for each crater in turn.
    hypotheses : int
        Number of poses, those that explain most rims first, that are expanded.
    gate_chi2 : float
        Largest squared Mahalanobis norm of a hypothesis: its correction of the prior, its rim and shading.
    sunward_sigma_rad : float
        Standard deviation of the direction in which a crater's wall is darkest.
    min_score : float
        Minimum score of a pose that is accepted.
    good_score : float
        Score at which the search ends.
    min_found_share : float
        Minimum share of the craters expected in the image that must be found.
    expected_px : tuple of float
        Semi-minor axes from which on craters are expected to be found; the one with the best score counts,
        since the smallest crater that can be found depends on terrain and illumination.
    covariance_factor : float
        Factor on the covariance of the pose, because the errors of the rims are correlated.
    """

    detect: BlindOptions = COARSE
    seeds: int = 24
    hypotheses: int = 40
    gate_chi2: float = 30.0
    sunward_sigma_rad: float = float(np.deg2rad(8.0))
    min_score: float = 4.0
    good_score: float = 12.0
    min_found_share: float = 0.4
    expected_px: tuple[float, ...] = (8.0, 12.0, 20.0)
    covariance_factor: float = 4.0


@dataclass(frozen=True)
class Acquisition:
    """A pose found in an image.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body.
    pose_covariance : ndarray, shape (6, 6)
        Covariance of the attitude error (rotation vector in b, rad) and the position error in g, m. It
        contains prior and image: use it to guide a detector, and not together with measurements of the same
        image.
    score : float
        Minus the decimal logarithm of the expected number of poses, among all tried, that explain as many
        rims by chance.
    craters : ndarray of int, shape (k,)
        Rows of the catalogue that were found.
    """

    gTb: FloatArray
    pose_covariance: FloatArray
    score: float
    craters: IntArray


def acquire(
    image: ImageArray,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    sun_g: FloatArray,
    options: AcquireOptions | None = None,
) -> Acquisition | None:
    """Find the pose of the body from one image.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
        Brightness.
    camera : Camera
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    pose_covariance : ndarray, shape (6, 6)
        Covariance of the prediction: attitude error (rotation vector in b, rad), position error in g, m. The
        standard deviation of the position must be a small share of the altitude; the attitude may be almost
        unknown.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    options : AcquireOptions, optional

    Returns
    -------
    Acquisition or None
        None when no pose is accepted.
    """
    options = options or AcquireOptions()
    prior = Prior(
        np.ascontiguousarray(gTb, dtype=np.float64), np.ascontiguousarray(pose_covariance, dtype=np.float64)
    )
    if len(_craters_in_reach(camera, catalog, prior, sun_g, options)[0]) < 2:
        return None
    # The pose only guides a detector: rims of an interpolated, undistorted image are accurate enough.
    straight = undistorted(on_8_bit_scale(image, camera), camera)
    rims = detect_rims(straight, camera.pinhole, options.detect)
    return acquire_from_rims(rims, camera.pinhole, catalog, gTb, pose_covariance, sun_g, options)


def acquire_from_rims(
    rims: DetectedRims,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    sun_g: FloatArray,
    options: AcquireOptions | None = None,
) -> Acquisition | None:
    """Find the pose of the body from the rims of one image.

    Parameters
    ----------
    rims : DetectedRims
        The largest first.
    camera : Camera
        Without distortion.
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    pose_covariance : ndarray, shape (6, 6)
        Its covariance, as for `acquire`: rad and m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    options : AcquireOptions, optional

    Returns
    -------
    Acquisition or None
        None when no pose is accepted.
    """
    options = options or AcquireOptions()
    prior = Prior(
        np.ascontiguousarray(gTb, dtype=np.float64), np.ascontiguousarray(pose_covariance, dtype=np.float64)
    )
    rows, contrasts = _craters_in_reach(camera, catalog, prior, sun_g, options)
    if len(rows) < 2 or len(rims) < 2:
        return None
    craters = Craters(
        np.ascontiguousarray(catalog.centres[rows]), np.ascontiguousarray(catalog.axes[rows]),
        catalog.normals[rows], contrasts,
    )  # fmt: skip
    found = _search(camera, craters, rims, prior, options)
    if found is None:
        return None
    pose, covariance, score, crater = found
    covariance = options.covariance_factor * rotate_position_block(covariance, pose[:3, :3])
    return Acquisition(pose, covariance, score, rows[crater[crater >= 0]])


def craters_in_reach(
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    sun_g: FloatArray,
    options: AcquireOptions | None = None,
) -> IntArray:
    """Find the craters that an image from near a predicted pose may show, whatever the attitude.

    Parameters
    ----------
    camera : Camera
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    pose_covariance : ndarray, shape (6, 6)
        Its covariance, as for `acquire`: rad and m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    options : AcquireOptions, optional

    Returns
    -------
    ndarray of int, shape (k,)
        Rows of the catalogue: craters that are seen, lit and large enough.
    """
    return _craters_in_reach(
        camera, catalog, Prior(gTb, pose_covariance), sun_g, options or AcquireOptions()
    )[0]


def image_spread_px(camera: Camera, radius_m: float, gTb: FloatArray, pose_covariance: FloatArray) -> float:
    """Compute how uncertain a predicted pose leaves places of the ground in the image.

    Parameters
    ----------
    camera : Camera
    radius_m : float
        Radius of the body.
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    pose_covariance : ndarray, shape (6, 6)
        As for `acquire`.

    Returns
    -------
    float
        Largest standard deviation, px, at nine places in the image; inf when none of them shows the ground.
    """
    columns, rows = np.meshgrid(
        _SPREAD_PLACES * (camera.width_px - 1), _SPREAD_PLACES * (camera.height_px - 1)
    )
    points = camera.normalised(np.stack([columns.ravel(), rows.ravel()], axis=-1))
    gTc = camera.gTc(gTb)
    ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], points, radius_m)
    if not np.any(hit):
        return float("inf")
    ground, points = ground[hit], points[hit]
    depth_m = (ground - gTc[:3, 3]) @ gTc[:3, 2]
    # Derivative of the image, px, in the ground's position relative to the camera in g.
    motion = (gTc[:3, :2].T - points[:, :, None] * gTc[:3, 2]) / depth_m[:, None, None]
    motion *= np.array([camera.fx_px, camera.fy_px])[:, None]
    # A rotation w of the body moves the ground by (X - P) x R w relative to it, a translation dP by -dP.
    turned = np.cross((ground - gTb[:3, 3])[:, None, :], gTb[:3, :3].T[None])
    J = np.concatenate([motion @ np.swapaxes(turned, 1, 2), -motion], axis=-1)
    return float(np.sqrt(np.linalg.eigvalsh(J @ pose_covariance @ np.swapaxes(J, 1, 2)).max()))


def _craters_in_reach(
    camera: Camera, catalog: Catalog, prior: Prior, sun_g: FloatArray, options: AcquireOptions
) -> tuple[IntArray, FloatArray]:
    """Craters that may be seen, lit and large enough, near the predicted position; slope contrasts (n, 3)."""
    gPc = camera.gTc(prior.gTb)[:3, 3]
    reach = camera.focal_px / (_MIN_RANGE_SHARE * options.detect.min_radius_px)
    rows = np.sort(catalog.index.in_view(gPc, -gPc / np.linalg.norm(gPc), -1.0, reach))
    view = gPc - catalog.centres[rows]
    range_m = np.linalg.norm(view, axis=-1)
    view /= range_m[:, None]
    _, contrast = flat_terrain_brightness(catalog.normals[rows], sun_g, view)
    slack_m = _POSITION_SIGMAS * float(np.sqrt(np.linalg.eigvalsh(prior.covariance[3:, 3:])[-1]))
    nearest_m = np.maximum(range_m - slack_m, _MIN_RANGE_SHARE * range_m)
    size_px = camera.focal_px * catalog.semi_major_m[rows] / nearest_m
    keep = (
        (np.sum(view * catalog.normals[rows], axis=-1) > _MIN_COS_SLANT)
        & (size_px > options.detect.min_radius_px)
        & (np.linalg.norm(contrast, axis=-1) > _MIN_CONTRAST)
    )
    return rows[keep], np.ascontiguousarray(contrast[keep])


def _search(
    camera: Camera, craters: Craters, detected: DetectedRims, prior: Prior, options: AcquireOptions
) -> tuple[FloatArray, FloatArray, float, IntArray] | None:
    """Best accepted pose, its covariance for the right twist, its score, and each rim's crater."""
    rims = Rims(
        detected.charts, detected.covariance, scaled_inverse(detected.covariance), detected.sunward_rad,
        options.sunward_sigma_rad,
    )  # fmt: skip
    bTc = camera.bTc
    corners = np.array([[-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5]])
    reach = _REACH_FACTOR * np.abs(camera.normalised(corners)).max(axis=0)
    found = poses_of_single_rims(prior, bTc, craters, rims, options.seeds, options.gate_chi2)
    explained = count_explained(found, bTc, craters, rims, reach)
    best = None
    for k in np.lexsort((found.cost, -explained))[: options.hypotheses]:
        pose, covariance, crater = expand_inliers(prior, found, int(k), bTc, craters, rims, reach)
        charts, seen = conic.project_rims(pose, bTc, craters.centres, craters.axes)
        score = log10_improbability(
            charts[seen], detected.charts_px, camera, max(1, len(found)), options.expected_px,
            options.min_found_share,
        )  # fmt: skip
        if score >= options.min_score and (best is None or score > best[2]):
            best = (pose, covariance, score, crater)
            if score >= options.good_score:
                break
    return best
