"""The pose from one rendered image at 50 km and a prior of 25 deg and 4 km."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.body import Body, ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import pixel_chart
from craternav_fg.matching.acquire import search
from craternav_fg.matching.acquire.detected_rims import DetectedRims, detect_rims
from craternav_fg.matching.acquire.search import AcquireOptions, acquire, image_spread_px
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.simulation.craters import CraterFieldOptions, random_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from factors.kernels import gauss_newton

MOON = Body("Moon", 1_737_400.0, 4.9028e12, (0.0, 0.0, 2.66e-6))
FOCAL = 512.0 / np.tan(np.deg2rad(22.0))
MOUNTING = frames.pose(frames.rotation_exp(np.array([0.0, 0.0, 0.5 * np.pi])), np.array([1.2, -0.3, 0.8]))
CAMERA = Camera(1024, 1024, FOCAL, FOCAL, 511.5, 511.5, MOUNTING)
ALTITUDE_M = 50e3


class View:
    """One rendered image and all that was true when it was taken."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        lat, lon = np.array(0.2), np.array(0.4 + 0.1 * seed)
        site = frames.east_north_up(lat, lon)
        up = site[:, 2]
        track = np.stack([(MOON.radius_m + h) * up for h in (ALTITUDE_M, 0.7 * ALTITUDE_M)])
        relief = Relief(MOON, track[-1], ReliefOptions(seed=seed))
        self.catalog = random_craters(rng, MOON, track, CraterFieldOptions(), relief)
        looking = frames.rotation_exp(np.deg2rad(12.0) * (site @ [0.6, 0.8, 0.0]))
        down = site @ np.diag([1.0, -1.0, -1.0])
        gTc = frames.pose(
            looking @ down @ frames.rotation_exp(np.array([0.0, 0.0, 2.0])), (MOON.radius_m + ALTITUDE_M) * up
        )
        self.gTb = gTc @ frames.inverse(MOUNTING)
        self.sun_g = site @ [0.6, 0.5, np.sqrt(1.0 - 0.36 - 0.25)]
        self.image = Renderer(
            CAMERA, Terrain(self.catalog, relief, TerrainOptions()), RenderOptions()
        ).render(self.gTb, self.sun_g, rng)

    def prior(self, seed, attitude_deg=25.0, position_m=4000.0):
        rng = np.random.default_rng(seed)
        sigmas = np.repeat([np.deg2rad(attitude_deg), position_m], 3)
        error = sigmas * rng.standard_normal(6)
        gTb = self.gTb.copy()
        gTb[:3, :3] = self.gTb[:3, :3] @ frames.rotation_exp(error[:3])
        gTb[:3, 3] += error[3:]
        return gTb, np.diag(sigmas**2)

    def image_error_px(self, gTb):
        rows, _ = self.catalog.visible(CAMERA, self.gTb, min_semi_minor_px=12.0)
        pixels = []
        for pose in (gTb, self.gTb):
            gTc = CAMERA.gTc(pose)
            pixels.append(CAMERA.project((self.catalog.centres[rows] - gTc[:3, 3]) @ gTc[:3, :3]))
        return float(np.sqrt(np.mean(np.sum((pixels[0] - pixels[1]) ** 2, axis=-1))))


@pytest.fixture(scope="module")
def view():
    return View(1)


@pytest.fixture(scope="module")
def detected() -> dict[tuple[bytes, str], DetectedRims]:
    return {}


@pytest.fixture(autouse=True)
def each_image_is_searched_once(monkeypatch, detected):
    def once(image, camera, options):
        key = (image.tobytes(), repr(options))
        if key not in detected:
            detected[key] = detect_rims(image, camera, options)
        return detected[key]

    monkeypatch.setattr(search, "detect_rims", once)


def part_of(catalog, rows):
    return Catalog(
        tuple(np.array(catalog.identifiers)[rows]), catalog.latitude_rad[rows], catalog.longitude_rad[rows],
        catalog.semi_major_m[rows], catalog.semi_minor_m[rows], catalog.angle_rad[rows],
        catalog.height_m[rows], catalog.body,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("seed", "attitude_deg", "position_m"),
    [(0, 25.0, 4e3), (1, 25.0, 4e3), (2, 25.0, 4e3), (3, 5.0, 1e3), (4, 0.05, 50.0)],
)
def test_pose_is_found_whatever_the_prior(view, seed, attitude_deg, position_m):
    prior, covariance = view.prior(seed, attitude_deg, position_m)
    found = acquire(view.image, CAMERA, view.catalog, prior, covariance, view.sun_g)
    assert found is not None
    assert found.score > 20.0
    assert view.image_error_px(found.gTb) < 1.0
    error = np.concatenate(
        [
            frames.rotation_log(found.gTb[:3, :3].T @ view.gTb[:3, :3]),
            view.gTb[:3, 3] - found.gTb[:3, 3],
        ]
    )
    assert error @ np.linalg.solve(found.pose_covariance, error) < 16.8  # chi-square, 6, 99 %
    assert image_spread_px(CAMERA, MOON.radius_m, found.gTb, found.pose_covariance) < 5.0


def test_found_craters_are_in_the_image(view):
    found = acquire(view.image, CAMERA, view.catalog, *view.prior(5), view.sun_g)
    seen, _ = view.catalog.visible(CAMERA, view.gTb, min_semi_minor_px=5.0, margin_px=-60.0)
    assert len(found.craters) >= 8
    assert len(set(found.craters)) == len(found.craters)
    assert np.isin(found.craters, seen).all()


def test_rims_far_from_the_principal_point_count(view):
    """Those of a cropped image all lie beyond three fifths of its width."""
    left = 760
    cropped = replace(CAMERA, width_px=CAMERA.width_px - left, cx_px=CAMERA.cx_px - left)
    found = acquire(
        np.ascontiguousarray(view.image[:, left:]),
        cropped,
        view.catalog,
        *view.prior(5, 3.0, 500.0),
        view.sun_g,
    )
    assert found is not None
    assert len(found.craters) >= 4
    assert view.image_error_px(found.gTb) < 6.0


def test_half_a_catalogue_will_do(view):
    rows = np.sort(np.random.default_rng(0).permutation(len(view.catalog))[: len(view.catalog) // 2])
    found = acquire(view.image, CAMERA, part_of(view.catalog, rows), *view.prior(6), view.sun_g)
    assert found is not None
    assert view.image_error_px(found.gTb) < 2.0


def test_other_ground_is_not_recognised(view):
    other = View(2)
    for seed in range(3):
        prior, covariance = other.prior(seed)
        assert acquire(view.image, CAMERA, other.catalog, prior, covariance, other.sun_g) is None


def test_mirrored_image_is_not_recognised(view):
    mirrored = np.ascontiguousarray(view.image[:, ::-1])
    assert acquire(mirrored, CAMERA, view.catalog, *view.prior(0), view.sun_g) is None


@pytest.mark.parametrize("seed", range(4))
def test_prior_far_from_the_truth_gives_nothing_wrong(view, seed):
    """Ten standard deviations off: the ground in sight may be recognised all the same, no other ground."""
    prior, covariance = view.prior(seed)
    prior[:3, 3] += 40e3 * np.cross(view.gTb[:3, 3] / np.linalg.norm(view.gTb[:3, 3]), [0.0, 0.0, 1.0])
    found = acquire(view.image, CAMERA, view.catalog, prior, covariance, view.sun_g)
    assert found is None or view.image_error_px(found.gTb) < 1.0
    prior[:3, 3] += 300e3 * np.cross(view.gTb[:3, 3] / np.linalg.norm(view.gTb[:3, 3]), [0.0, 0.0, 1.0])
    assert acquire(view.image, CAMERA, view.catalog, prior, covariance, view.sun_g) is None


@pytest.mark.parametrize("kind", ["dark", "grey", "noise"])
def test_image_without_craters_gives_nothing(view, kind):
    image = np.full((1024, 1024), 0 if kind == "dark" else 110, dtype=np.uint8)
    if kind == "noise":
        image = np.random.default_rng(0).normal(110.0, 8.0, image.shape).astype(np.uint8)
    assert acquire(image, CAMERA, view.catalog, *view.prior(0), view.sun_g) is None


def test_no_crater_in_reach_gives_nothing(view):
    prior, covariance = view.prior(0)
    prior[:3, 3] = -prior[:3, 3]
    assert acquire(view.image, CAMERA, view.catalog, prior, covariance, view.sun_g) is None


def test_fewer_confirming_craters_score_less(view):
    whole = acquire(view.image, CAMERA, view.catalog, *view.prior(7), view.sun_g)
    rows = np.sort(np.random.default_rng(1).permutation(len(view.catalog))[: len(view.catalog) // 2])
    half = acquire(
        view.image, CAMERA, part_of(view.catalog, rows), *view.prior(7), view.sun_g, AcquireOptions(seeds=40)
    )
    assert half.score < whole.score


def test_blind_rims_lie_on_the_true_ones(view):
    rims = detect_rims(view.image, CAMERA)
    rows, charts = view.catalog.visible(CAMERA, view.gTb, min_semi_minor_px=12.0)
    true = pixel_chart(charts, CAMERA)
    off = np.linalg.norm(true[:, None, :2] - rims.charts_px[None, :, :2], axis=-1)
    nearest = off.argmin(axis=1)
    found = off.min(axis=1) < 2.0
    assert np.mean(found) >= 0.9
    size = np.abs(true[:, [2, 4]] - rims.charts_px[nearest][:, [2, 4]])[found]
    assert np.median(size) < 0.02
    # Walls are darkest where the shading gain points in the image.
    gTc = CAMERA.gTc(view.gTb)
    towards = gTc[:3, 3] - view.catalog.centres[rows]
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    _, gain = flat_terrain_brightness(view.catalog.normals[rows], view.sun_g, towards)
    step = 100.0 * gain / np.linalg.norm(gain, axis=-1, keepdims=True)
    start = CAMERA.project((view.catalog.centres[rows] - gTc[:3, 3]) @ gTc[:3, :3])
    end = CAMERA.project((view.catalog.centres[rows] + step - gTc[:3, 3]) @ gTc[:3, :3])
    angle = np.arctan2(*(end - start).T[::-1])
    turned = np.angle(np.exp(1j * (rims.sunward_rad[nearest] - angle)))[found]
    assert np.rad2deg(np.sqrt(np.mean(turned**2))) < 15.0


def test_image_spread_is_that_of_sampled_poses(view):
    rng = np.random.default_rng(0)
    root = np.diag(np.repeat([1e-3, 30.0], 3)) @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    covariance = root @ root.T
    corners = np.array([[102.3, 102.3], [921.0, 102.3], [511.5, 511.5], [102.3, 921.0], [921.0, 921.0]])
    gTc = CAMERA.gTc(view.gTb)
    ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], CAMERA.normalised(corners), MOON.radius_m)
    assert hit.all()
    moved = []
    for _ in range(4000):
        e = root @ rng.standard_normal(6)
        pose = view.gTb.copy()
        pose[:3, :3] = view.gTb[:3, :3] @ frames.rotation_exp(e[:3])
        pose[:3, 3] += e[3:]
        gTc = CAMERA.gTc(pose)
        moved.append(CAMERA.project((ground - gTc[:3, 3]) @ gTc[:3, :3]))
    sampled = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(moved)[:, k].T))[-1]) for k in range(5)]
    spread = image_spread_px(CAMERA, MOON.radius_m, view.gTb, covariance)
    assert spread == pytest.approx(max(sampled), rel=0.05)


def test_image_spread_is_infinite_off_the_ground(view):
    away = (
        view.gTb @ MOUNTING @ frames.pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ frames.inverse(MOUNTING)
    )
    assert image_spread_px(CAMERA, MOON.radius_m, away, np.eye(6)) == np.inf


@pytest.mark.parametrize("angle_rad", [0.0, 1e-5, 0.3, 2.5])
def test_gradient_of_the_prior_is_the_slope_of_its_cost(angle_rad):
    rng = np.random.default_rng(3)
    root = rng.standard_normal((6, 6))
    weight = root @ root.T
    prior = frames.pose(frames.rotation_exp(rng.standard_normal(3)), rng.standard_normal(3))
    turn = rng.standard_normal(3)
    pose = prior.copy()
    pose[:3, :3] = prior[:3, :3] @ frames.rotation_exp(angle_rad * turn / np.linalg.norm(turn))
    pose[:3, 3] += rng.standard_normal(3)
    N, gradient, scratch = np.empty((6, 6)), np.empty(6), np.empty(6)
    gauss_newton.prior_terms(prior, weight, pose, N, gradient)
    slope = np.empty(6)
    for k in range(6):
        cost = []
        for step in (1e-6, -1e-6):
            near = pose.copy()
            gauss_newton.move(near, step * np.eye(6)[k])
            cost.append(gauss_newton.prior_terms(prior, weight, near, N, scratch))
        slope[k] = (cost[0] - cost[1]) / 2e-6
    np.testing.assert_allclose(2.0 * gradient, slope, rtol=1e-6, atol=1e-6)


def test_moves_compose_like_rotations():
    pose = frames.pose(frames.rotation_exp(np.array([0.3, -0.2, 0.9])), np.array([1.0, 2.0, 3.0]))
    delta = np.array([0.4, 0.1, -0.7, 5.0, 6.0, 7.0])
    moved = pose.copy()
    gauss_newton.move(moved, delta)
    expected = pose @ frames.pose(frames.rotation_exp(delta[:3]), delta[3:])
    np.testing.assert_allclose(moved, expected, atol=1e-12)
