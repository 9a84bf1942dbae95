"""Growth that all rims of a frame have in common."""

import numpy as np

from craternav_fg.ellipse import points_on
from craternav_fg.measurements import RimSet
from craternav_fg.vision import guided
from craternav_fg.vision.error_model.common_growth import CommonGrowth, common_growth, without_growth
from craternav_fg.vision.error_model.correlated import radii_px
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.kernels.conic import project_rims
from tests.vision import scene
from tests.vision.test_arcs import distances_px

PX, SHARE = 0.25, 0.004
BLUR_PX = 2.0  # the camera states none: 0.7 px
TURN_SIGMA_RAD, SHIFT_SIGMA_M = 1e-3, 30.0


def grown(catalog, gTb, px, share):
    """Charts of rims that are too large, and their radii."""
    rows = np.arange(len(catalog))
    radius_px = radii_px(rows, gTb, scene.camera(), catalog)
    larger = catalog.axes * (1.0 + px / radius_px + share)[:, None, None]
    return project_rims(gTb, scene.camera().bTc, catalog.centres, larger)[0], radius_px


def test_it_is_found_with_its_covariance_whatever_the_pose():
    rng = np.random.default_rng(1)
    squares = []
    sigma = np.array([0.1, 0.1, 0.006, 0.006, 0.006])
    sigma[:2] /= scene.camera().focal_px
    prior = np.diag(np.repeat([TURN_SIGMA_RAD, SHIFT_SIGMA_M], 3) ** 2)
    for _ in range(60):
        catalog = scene.craters(rng, 20, 8.0, 60.0)
        gTb = scene.pose(rng.uniform(0.0, 6.0))
        truth = rng.normal(0.0, [0.2, 0.005])
        charts, _ = grown(catalog, gTb, *truth)
        charts += rng.normal(0.0, sigma, charts.shape)
        rims = RimSet(np.arange(len(catalog)), charts, np.tile(np.diag(sigma**2), (len(catalog), 1, 1)))
        off = np.sqrt(np.diag(prior)) * rng.normal(size=6)
        predicted = scene.moved(gTb, off[:3], gTb[:3, :3] @ off[3:])
        found = common_growth(rims, gTb, predicted, prior, scene.camera(), catalog)
        error = found.mean - truth
        squares.append(error @ np.linalg.solve(found.covariance, error))
        assert np.sqrt(found.covariance[0, 0]) < 0.15
    # Of 120 degrees of freedom.
    assert 0.7 < np.mean(squares) / 2.0 < 1.4


def test_points_of_a_grown_rim_come_back_to_it():
    rng = np.random.default_rng(2)
    catalog, gTb = scene.craters(rng, 10, 15.0, 60.0), scene.pose(2.0)
    charts, radius_px = grown(catalog, gTb, PX, SHARE)
    truth, _ = grown(catalog, gTb, 0.0, 0.0)
    focal_px = scene.camera().focal_px
    for chart, right, radius in zip(charts, truth, radius_px, strict=True):
        points = points_on(chart[None], 40)[0]
        moved = without_growth(points * focal_px, right[:2] * focal_px, PX / radius + SHARE) / focal_px
        assert np.abs(distances_px(points, right)).min() > 0.2
        assert np.abs(distances_px(moved, right)).max() < 0.05


def test_arcs_are_no_larger_where_all_rims_are():
    """An image that is less sharp than the camera's file says."""
    arcs_px, rims_px = [], []
    for seed in range(3):
        rng = np.random.default_rng(40 + seed)
        catalog = scene.craters(rng, 26, 14.0, 40.0, half=0.48)
        gTb, sun_g = scene.pose(rng.uniform(0.0, 6.0)), scene.sun(rng.uniform(20.0, 50.0))
        image = scene.render(catalog, gTb, sun_g, rng, blur_px=BLUR_PX)
        frame = GuidedFrontEnd(scene.camera(), catalog).measure(image, 0, gTb, scene.covariance(0.5), sun_g)
        truth, radius_px = grown(catalog, gTb, 0.0, 0.0)
        rims, arcs = frame.rims, frame.arcs
        off = rims.chart[:, [2, 4]] - truth[rims.craters][:, [2, 4]]
        rims_px += (radius_px[rims.craters] * off.mean(axis=1)).tolist()
        arcs_px += [
            float(np.mean(distances_px(points, truth[crater])))
            for crater, points in zip(arcs.craters, arcs.points, strict=True)
        ]
    assert len(arcs_px) >= 12
    assert np.mean(rims_px) > 0.25
    assert abs(np.mean(arcs_px)) < 0.4 * np.mean(rims_px)


def test_arcs_are_as_uncertain_as_the_growth(monkeypatch):
    rng = np.random.default_rng(40)
    catalog = scene.craters(rng, 26, 14.0, 40.0, half=0.48)
    gTb, sun_g = scene.pose(1.0), scene.sun(30.0)
    image = scene.render(catalog, gTb, sun_g, rng)
    sigmas = []
    for variance_px2 in (0.0, 1.0):
        growth = CommonGrowth(np.zeros(2), np.diag([variance_px2, 0.0]))
        monkeypatch.setattr(guided, "common_growth", lambda *_, growth=growth: growth)
        arcs = (
            GuidedFrontEnd(scene.camera(), catalog).measure(image, 0, gTb, scene.covariance(0.5), sun_g).arcs
        )
        assert arcs.correlated_sigmas is not None
        px = scene.camera().focal_px * arcs.correlated_sigmas
        sigmas.append(dict(zip(arcs.craters.tolist(), px, strict=True)))
    both = sigmas[0].keys() & sigmas[1].keys()
    assert len(both) >= 3
    # Of one pixel along the major axis, less across foreshortened rims.
    added = [np.sqrt(sigmas[1][row] ** 2 - sigmas[0][row] ** 2) for row in both]
    assert 0.7 < min(added) <= max(added) < 1.1
