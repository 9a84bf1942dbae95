"""The photometric law of the ground, as its rims show it."""

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.photometry import LunarLambert, lunar_lambert_share
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.world import make_world
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.predicted_rims import PredictedRims, predict_rims
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from craternav_fg.vision.reflectance import photometric_law
from craternav_fg.vision.rim_shading import RimShading
from tests.vision.oblique_crater import PSF_PX, SUN_ELEVATION_RAD, crater

OPTIONS = EdgeOptions()


def rims_of(chart_px: np.ndarray, shading: RimShading, phase_rad: float) -> PredictedRims:
    reference, gradient, contrast_px, *others = (np.array([value]) for value in shading)
    return PredictedRims(
        np.array([0]), np.zeros((1, 5)), chart_px[None], np.ones(1), contrast_px, *others,
        np.array([phase_rad]), reference, gradient, np.zeros((1, 5, 6)),
    )  # fmt: skip


@pytest.mark.parametrize("law", [LunarLambert(), LunarLambert(0.8, 0.0), LunarLambert(0.1, 0.0)])
def test_one_crater_shows_the_share_at_its_phase_angle(law: LunarLambert) -> None:
    emission_rad = np.deg2rad(45.0)
    for azimuth_rad in np.deg2rad([60.0, 140.0]):
        image, chart, shading = crater(32.0, emission_rad, azimuth_rad, law)
        across = np.cos(SUN_ELEVATION_RAD) * np.cos(azimuth_rad) * np.sin(emission_rad)
        phase_rad = np.arccos(np.sin(SUN_ELEVATION_RAD) * np.cos(emission_rad) - across)
        rims = rims_of(chart, shading._replace(lommel_share=0.5), phase_rad)
        camera = Camera(len(image), len(image), 1e3, 1e3, chart[0], chart[1], psf_sigma_px=PSF_PX)
        found = photometric_law(image, camera, rims, OPTIONS)
        share = lunar_lambert_share(rims.phase_rad, found)[0]
        assert share == pytest.approx(shading.lommel_share, abs=0.05)


@pytest.mark.parametrize("share", [0.15, 0.95])
def test_the_rims_of_rendered_ground_show_its_law(share: float) -> None:
    """With shadows and neighbours, and craters that are not the canonical one."""
    scenario = load_scenario("lunar_descent")
    render = scenario.render.model_copy(update={"lunar_lambert": share})
    seldom = scenario.trajectory.model_copy(update={"frame_interval_s": scenario.trajectory.duration_s / 4.0})
    scenario = scenario.model_copy(update={"render": render, "trajectory": seldom})
    world = make_world(scenario, np.random.default_rng([0, 0]), trial=True)
    renderer = world.renderer()
    stamps_ns = world.stamps_ns[:3]
    poses = world.descent.evaluate(np.multiply(stamps_ns, 1e-9)).gTb
    errors = []
    for stamp_ns, gTb in zip(stamps_ns.tolist(), poses, strict=True):
        sun_g = world.sun.at(stamp_ns)
        image = renderer.render(gTb, sun_g, np.random.default_rng(0)).astype(np.float32)
        brightness = ReferenceBrightness(image, world.camera, world.catalog.body.radius_m, gTb, sun_g)
        rows, _ = world.catalog.visible(world.camera, gTb, min_semi_minor_px=8.0, margin_px=10.0)
        rims = predict_rims(rows, world.camera, world.catalog, gTb, sun_g, brightness)
        found = photometric_law(image, world.camera, rims, OPTIONS)
        errors.append(np.median(lunar_lambert_share(rims.phase_rad, found)) - share)
    assert len(errors) == 3
    assert np.abs(errors).max() < 0.15
    assert abs(np.mean(errors)) < 0.1


def test_without_rims_the_law_is_a_usual_one() -> None:
    camera = Camera(64, 64, 1e3, 1e3, 31.5, 31.5)
    image, chart, shading = crater(32.0, 0.0, 0.0, LunarLambert())
    nothing = rims_of(chart, shading, 0.5).take(np.empty(0, int))
    law = photometric_law(image, camera, nothing, OPTIONS)
    assert (law.middle_share, law.phase_factor) == pytest.approx((0.5, 0.5))
