"""The lander's pose from one image and a poor prior.

Rims are found in the image without a prediction. Each of the larger ones is taken for each catalogue
crater in turn: with the sun's direction and the prior position one such pair gives the whole pose, and
most pairs contradict the prior. Those that explain further rims grow by them; a pose is believed when
as many rims as it explains would hardly ever fall into place by chance.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.ellipse import half_sides, pixel_chart, semi_minor_bound
from craternav_fg.frames import rotate_position_block
from craternav_fg.linalg import scaled_inverse
from craternav_fg.matching.acquire import hypotheses as match
from craternav_fg.matching.acquire.candidates import COARSE, Detections, detect_rims
from craternav_fg.photometry import level_ground
from craternav_fg.vision.detect import BlindOptions
from craternav_fg.vision.grey import on_8_bit_scale, undistorted
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# A prior position may be wrong, but not by so much that a crater is nearer than this part of its range.
_LEAST_RANGE = 0.2


@dataclass(frozen=True)
class AcquireOptions:
    """How a pose is searched, and when it is believed.

    Attributes
    ----------
    detect : BlindOptions
        Of the rims in the image.
    seeds : int
        The largest rims, which are taken for each crater in turn.
    hypotheses : int
        Poses, those that explain most rims first, that are grown.
    gate : float
        Largest squared Mahalanobis distance from the prior and from the pair that suggested it.
    sunward_sigma_rad : float
        Standard deviation of a crater's sunward direction.
    min_score : float
        Least score of a pose that is believed.
    good_score : float
        A pose with this score ends the search.
    min_found_share : float
        Least share of the craters expected in the image that must be found.
    expected_px : tuple of float
        Craters are expected to be found from one of these semi-minor axes upwards, whichever makes the
        better score: how small a crater can be found depends on the ground and the light.
    covariance_factor : float
        The covariance of the matched rims' pose is multiplied by this: their errors have common parts.
    """

    detect: BlindOptions = COARSE
    seeds: int = 24
    hypotheses: int = 40
    gate: float = 30.0
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
        Pose of the lander.
    pose_covariance : ndarray, shape (6, 6)
        Attitude error (rotation vector in b, rad), position error in g, m. Prior and image are both in
        it: it may guide a front end, not be counted beside the measurements of the same image.
    score : float
        Minus the decimal logarithm of the number of poses, among all tried, that would be expected to
        explain as many rims as well if the rims lay at random.
    craters : ndarray of int, shape (k,)
        Rows of the catalogue that were found.
    """

    gTb: FloatArray
    pose_covariance: FloatArray
    score: float
    craters: IntArray


# A rim that agrees with a crater: centre within these, in pixels and in semi-minor axes, the logarithms of
# size and shape within the third.
_AGREEMENT = (3.0, 0.1, 0.12)
# Share of craters of about a given size whose size and shape agree with a random rim's.
_SHAPE_CHANCE = 0.15
# The agreement is also tried this much tighter.
_TIGHTER = (1.0, 0.5, 0.25)


def acquire(
    image: ImageArray,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    sun_g: FloatArray,
    options: AcquireOptions | None = None,
) -> Acquisition | None:
    """Find the lander's pose.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    camera : Camera
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Prior pose.
    pose_covariance : ndarray, shape (6, 6)
        Of the prior: attitude error (rotation vector in b, rad), position error in g, m. The position
        must be known to a small part of the altitude, the attitude hardly at all.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    options : AcquireOptions, optional

    Returns
    -------
    Acquisition or None
        None when nothing convincing was found.
    """
    options = options or AcquireOptions()
    prior = match.Prior(
        np.ascontiguousarray(gTb, dtype=np.float64), np.ascontiguousarray(pose_covariance, dtype=np.float64)
    )
    rows, contrasts = _candidates(camera, catalog, prior, sun_g, options)
    if len(rows) < 2:
        return None
    # Rims found here only guide: an interpolated image will do, and all that follows is a pinhole's.
    straight = undistorted(on_8_bit_scale(image, camera), camera)
    camera = camera.pinhole
    rims = detect_rims(straight, camera, options.detect)
    if len(rims) < 2:
        return None
    return _Search(camera, catalog, rows, contrasts, rims, prior, options).run()


def image_spread_px(camera: Camera, radius_m: float, gTb: FloatArray, pose_covariance: FloatArray) -> float:
    """How uncertain a predicted pose leaves the ground's place in the image: whether to acquire.

    Parameters
    ----------
    camera : Camera
    radius_m : float
        Of the body.
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    pose_covariance : ndarray, shape (6, 6)
        As for `acquire`.

    Returns
    -------
    float
        Largest standard deviation, px, linearised at nine points spread over the image; inf when the
        prediction has none of them on the ground.
    """
    share = np.array([0.1, 0.5, 0.9])
    columns, rows = np.meshgrid(share * (camera.width_px - 1), share * (camera.height_px - 1))
    points = camera.normalised(np.stack([columns.ravel(), rows.ravel()], axis=-1))
    gTc = camera.gTc(gTb)
    ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], points, radius_m)
    if not np.any(hit):
        return float("inf")
    ground, points = ground[hit], points[hit]
    depth_m = (ground - gTc[:3, 3]) @ gTc[:3, 2]
    # Image motion for a motion of the ground relative to the camera, in g.
    motion = (gTc[:3, :2].T - points[:, :, None] * gTc[:3, 2]) / depth_m[:, None, None]
    motion *= np.array([camera.fx_px, camera.fy_px])[:, None]
    # A turn w of the lander moves the ground by (X - P) x R w, a shift dP by -dP.
    turned = np.cross((ground - gTb[:3, 3])[:, None, :], gTb[:3, :3].T[None])
    J = np.concatenate([motion @ np.swapaxes(turned, 1, 2), -motion], axis=-1)
    return float(np.sqrt(np.linalg.eigvalsh(J @ pose_covariance @ np.swapaxes(J, 1, 2)).max()))


def _candidates(
    camera: Camera, catalog: Catalog, prior: match.Prior, sun_g: FloatArray, options: AcquireOptions
) -> tuple[IntArray, FloatArray]:
    """Craters that may be seen, lit and large enough, from about the prior; their slope contrasts (n, 3)."""
    gPc = camera.gTc(prior.gTb)[:3, 3]
    # All that is above the horizon and, at the least part of its range below, large enough.
    reach = camera.focal_px / (_LEAST_RANGE * options.detect.min_radius_px)
    rows = np.sort(catalog.index.in_view(gPc, -gPc / np.linalg.norm(gPc), -1.0, reach))
    view = gPc - catalog.centres[rows]
    range_m = np.linalg.norm(view, axis=-1)
    view /= range_m[:, None]
    _, contrast = level_ground(catalog.normals[rows], sun_g, view)
    slack_m = 3.0 * float(np.sqrt(np.linalg.eigvalsh(prior.covariance[3:, 3:])[-1]))
    nearest_m = np.maximum(range_m - slack_m, _LEAST_RANGE * range_m)
    size_px = camera.focal_px * catalog.semi_major_m[rows] / nearest_m
    keep = (
        (np.sum(view * catalog.normals[rows], axis=-1) > 0.15)
        & (size_px > options.detect.min_radius_px)
        & (np.linalg.norm(contrast, axis=-1) > 0.1)
    )
    return rows[keep], np.ascontiguousarray(contrast[keep])


class _Search:
    """One image's search: rims against candidate craters."""

    def __init__(
        self, camera: Camera, catalog: Catalog, rows: IntArray, contrasts: FloatArray, found: Detections,
        prior: match.Prior, options: AcquireOptions,
    ) -> None:  # fmt: skip
        self.camera = camera
        self.rows = rows
        self.craters = match.Craters(
            np.ascontiguousarray(catalog.centres[rows]), np.ascontiguousarray(catalog.axes[rows]),
            catalog.normals[rows], contrasts,
        )  # fmt: skip
        self.rims = match.Rims(
            found.charts, found.covariance, scaled_inverse(found.covariance), found.sunward_rad,
            options.sunward_sigma_rad,
        )  # fmt: skip
        self.rims_px = found.charts_px
        self.prior = prior
        self.options = options
        self.tried = 1

    def run(self) -> Acquisition | None:
        """Best pose, if any is convincing."""
        opt, camera = self.options, self.camera
        reach = 0.6 * np.array([camera.width_px / camera.fx_px, camera.height_px / camera.fy_px])
        found = match.single_poses(self.prior, camera.bTc, self.craters, self.rims, opt.seeds, opt.gate)
        self.tried = max(1, len(found))
        explained = match.support(found, camera.bTc, self.craters, self.rims, reach)
        best: Acquisition | None = None
        for k in np.lexsort((found.cost, -explained))[: opt.hypotheses]:
            pose, covariance, crater = match.expand_inliers(
                self.prior, found, int(k), camera.bTc, self.craters, self.rims, reach
            )
            score = self._score(pose)
            if score >= opt.min_score and (best is None or score > best.score):
                covariance = opt.covariance_factor * rotate_position_block(covariance, pose[:3, :3])
                best = Acquisition(pose, covariance, score, self.rows[crater[crater >= 0]])
                if score >= opt.good_score:
                    break
        return best

    def _score(self, pose: FloatArray) -> float:
        """Score of a pose, see `Acquisition`; -inf when too few of the expected craters were found."""
        camera, rims_px = self.camera, self.rims_px
        charts, seen = conic.project_rims(pose, camera.bTc, self.craters.centres, self.craters.axes)
        charts = pixel_chart(charts[seen], camera)
        half = half_sides(charts)
        whole = camera.contains(charts[:, :2] - half) & camera.contains(charts[:, :2] + half)
        charts = charts[whole]
        minor = semi_minor_bound(charts)
        off_px = np.linalg.norm(charts[:, None, :2] - rims_px[None, :, :2], axis=-1)
        off_log = np.abs(charts[:, None, 2:] - rims_px[None, :, 2:]).max(axis=-1)
        reach_px = _AGREEMENT[0] + _AGREEMENT[1] * minor
        misfit = np.maximum(off_px / reach_px[:, None], off_log / _AGREEMENT[2]).min(axis=1)
        share = len(rims_px) * np.pi * reach_px**2 / (camera.width_px * camera.height_px)
        tests = len(_TIGHTER) * len(self.options.expected_px)
        best = -np.inf
        for least_px in self.options.expected_px:
            large = minor >= least_px
            expected = int(np.count_nonzero(large))
            if np.count_nonzero(misfit[large] < 1.0) < max(3, self.options.min_found_share * expected):
                continue
            for factor in _TIGHTER:
                # The first two rims made the pose, they don't confirm it.
                confirming = int(np.count_nonzero(misfit[large] < factor)) - 2
                if confirming < 1:
                    continue
                chance = min(1.0, float(np.mean(share[large])) * _SHAPE_CHANCE * factor**5)
                ways = _log10_choose(expected - 2, confirming)
                best = max(best, -(np.log10(self.tried * tests) + ways + confirming * np.log10(chance)))
        return best


def _log10_choose(n: int, k: int) -> float:
    return float((gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)) / np.log(10.0))
