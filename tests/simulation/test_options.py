"""Options of terrain, illumination and sensor that the demo does not use."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset
from craternav_fg.simulation.craters import CraterFieldOptions, random_craters
from craternav_fg.simulation.crests import crest_offsets_px
from craternav_fg.simulation.render import Hapke, Renderer, RenderOptions
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from tests.simulation import scene

CLEAN = RenderOptions(psf_sigma_px=0.0, full_well_e=0.0)
FRESH = TerrainOptions(cells=1024, depth_scatter_share=0.0)
# Four craters of 30 to 45 px from 6 km.
FOUR = scene.craters(
    [
        (-700.0, 600.0, 210.0, 180.0, 0.0, 0.4),
        (800.0, 700.0, 190.0, 160.0, 0.0, 1.1),
        (600.0, -800.0, 170.0, 170.0, 0.0, 0.0),
        (-800.0, -700.0, 150.0, 130.0, 0.0, 2.2),
    ]
)
ABOVE = scene.pose(scene.place(0.0, 0.0, 6e3))


def smooth(options=FRESH, catalog=FOUR, light=CLEAN):
    return Renderer(scene.CAMERA, Terrain(catalog, scene.relief(slope=0.0), options), light)


def rim_px(catalog, row):
    return np.sqrt(catalog.semi_major_m[row] * catalog.semi_minor_m[row]) * scene.FOCAL / 6e3


def test_irregular_rims_scatter_around_their_ellipse():
    renderer = smooth(replace(FRESH, irregularity_share=0.03))
    rows = np.arange(4)
    count = 72
    offsets = crest_offsets_px(renderer, FOUR, ABOVE, rows, count, reach_px=6.0)
    assert not np.any(np.isnan(offsets))
    share = offsets / [[rim_px(FOUR, row)] for row in rows]
    assert 0.02 < share.std() < 0.045
    # The ellipse is the best fit: the deviations have no mean, no shift and no stretch.
    theta = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    for order in range(3):
        assert np.all(np.abs(share @ np.exp(1j * order * theta)) / count < 0.004)
    # Every rim has a different shape.
    assert np.abs(np.corrcoef(share)[np.triu_indices(4, 1)]).max() < 0.9


def test_degraded_craters_keep_their_crest_and_lose_their_depth():
    fresh, degraded = smooth(), smooth(replace(FRESH, degradation=1.0))
    rows = np.arange(4)
    offsets = crest_offsets_px(degraded, FOUR, ABOVE, rows)
    assert np.nanmean(np.abs(offsets)) < 0.05
    middle = scene.project(ABOVE, FOUR.centres)
    floors = [scene.MOON.altitude_m(r.ground_points(ABOVE, middle)[0]) for r in (fresh, degraded)]
    left = floors[1] / floors[0]
    assert np.all((left > 0.45) & (left < 1.0))
    assert left.std() > 0.05
    light = [r.radiance(ABOVE, scene.sun(30.0, 70.0)) for r in (fresh, degraded)]
    assert light[1].std() < 0.9 * light[0].std()


def test_large_craters_have_a_central_peak():
    limit_m = 2.0 * np.sqrt(170.0 * 170.0) - 1.0
    renderer = smooth(replace(FRESH, peaks_from_m=limit_m))
    for row in range(4):
        along = FOUR.centres[row] + np.array([[0.0], [0.25]]) * FOUR.axes[row, 0]
        ground, _ = renderer.ground_points(ABOVE, scene.project(ABOVE, along))
        middle, aside = scene.MOON.altitude_m(ground)
        assert (middle > aside) == (row < 3)


def test_a_size_frequency_distribution_is_followed():
    table = ((0.2, 0.6), (1.0, 0.03), (3.0, 1e-3))
    options = CraterFieldOptions(
        focal_px=scene.FOCAL,
        size_frequency_km=table,
        separation_ratio=0.0,
        min_apparent_px=8.0,
        max_apparent_px=1e4,
    )
    # At one altitude: all sizes are in view from everywhere, on the same area.
    east = np.linspace(-60e3, 60e3, 40)
    track = np.array([scene.place(x, 0.0, 12e3) for x in east])
    catalog = random_craters(np.random.default_rng(3), scene.MOON, track, options, scene.relief())
    diameter = 2e-3 * catalog.semi_minor_m
    counts = np.array([np.count_nonzero(diameter > d) for d in (0.2, 0.4, 1.0, 2.0, 3.0)])
    # 0.4 and 2 km lie half-way between rows on logarithmic axes, more or less.
    expected = np.interp(
        np.log([0.2, 0.4, 1.0, 2.0, 3.0]), np.log([0.2, 1.0, 3.0]), np.log([0.6, 0.03, 1e-3])
    )
    ratio = counts[1:4] / counts[0]
    relative = np.exp(expected - expected[0])[1:4]
    assert counts[3] > 10
    assert np.all(np.abs(ratio / relative - 1.0) < 4.0 / np.sqrt(counts[1:4]))


def test_craters_overlap_when_they_may():
    options = CraterFieldOptions(focal_px=scene.FOCAL, density=0.01)
    apart, over = (
        random_craters(
            np.random.default_rng(4),
            scene.MOON,
            scene.track(),
            replace(options, separation_ratio=s),
            scene.relief(),
        )
        for s in (1.3, 0.0)
    )

    def overlaps(catalog):
        P = catalog.centres[:600]
        gap = np.linalg.norm(P[:, None] - P[None], axis=-1)
        near = gap < catalog.semi_minor_m[:600, None] + catalog.semi_minor_m[None, :600]
        return np.count_nonzero(np.triu(near, 1))

    assert overlaps(apart) == 0
    assert overlaps(over) > 20
    assert np.all(np.isfinite(over.height_m))
    gTb = scene.pose(scene.track()[30])
    light = Renderer(scene.CAMERA, Terrain(over, scene.relief(), TerrainOptions()), CLEAN).radiance(
        gTb, scene.sun(30.0, 70.0)
    )
    assert np.all(np.isfinite(light))
    assert np.mean(light == 0.0) < 0.2


def test_hapkes_limits():
    """Dark isotropic grains give Lommel-Seeliger; the opposition surge doubles it at zero phase."""
    dark = Hapke(1e-6, 0.0, 0.0, 0.05)
    sun = scene.sun(40.0, 120.0)
    seeliger = smooth(light=replace(CLEAN, lunar_lambert=1.0)).radiance(ABOVE, sun)
    flat = smooth(light=replace(CLEAN, hapke=dark)).radiance(ABOVE, sun)
    lit = seeliger > 0.05
    ratio = flat[lit] / seeliger[lit]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=1e-3)
    zenith = scene.SITE[:, 2]
    surge = smooth(light=replace(CLEAN, hapke=replace(dark, opposition_amplitude=1.0))).radiance(
        ABOVE, zenith
    )
    none = smooth(light=replace(CLEAN, hapke=dark)).radiance(ABOVE, zenith)
    assert surge[511, 511] / none[511, 511] == pytest.approx(2.0, abs=0.02)
    assert surge[0, 0] / none[0, 0] < 1.3
    # Grains that scatter back are the brighter the smaller the phase.
    back = smooth(light=replace(CLEAN, hapke=replace(dark, asymmetry=-0.3))).radiance(ABOVE, zenith)
    assert back[511, 511] / back[0, 0] > none[511, 511] / none[0, 0]


def test_vignetting_darkens_the_corners():
    rng = np.random.default_rng(0)
    whole, dim = (
        smooth(light=replace(CLEAN, vignetting_share=v))
        .render(ABOVE, scene.sun(50.0, 70.0), rng)
        .astype(float)
        for v in (0.0, 0.4)
    )
    assert dim[0, 0] / whole[0, 0] == pytest.approx(0.6, abs=0.02)
    assert dim[512, 512] / whole[512, 512] == pytest.approx(1.0, abs=0.01)
    # Half-way to the corner a quarter of that.
    assert dim[256, 256] / whole[256, 256] == pytest.approx(0.9, abs=0.02)


def test_motion_blur_is_the_mean_over_the_exposure():
    fine = Camera(320, 320, scene.FOCAL, scene.FOCAL, 159.5, 159.5, bit_depth=14)
    renderer = Renderer(fine, Terrain(FOUR, scene.relief(slope=0.05), FRESH), CLEAN)
    sun = scene.sun(20.0, 70.0)
    turn, way = np.array([0.002, -0.001, 0.004]), scene.SITE @ np.array([12.0, -5.0, -8.0])

    def pose(share):
        out = ABOVE.copy()
        out[:3, :3] = ABOVE[:3, :3] @ frames.rotation_exp(share * turn)
        out[:3, 3] += share * way
        return out

    shares = (np.arange(10) + 0.5) / 10.0 - 0.5
    mean = np.mean([renderer.radiance(pose(s), sun) for s in shares], axis=0)
    rng = np.random.default_rng(0)
    flat = renderer.render(ABOVE, sun, rng)
    swept = renderer.render(ABOVE, sun, rng, (pose(-0.5), pose(0.5))).astype(float)
    scale = np.median(flat) / np.median(renderer.radiance(ABOVE, sun))
    inside = (slice(20, -20), slice(20, -20))
    off = np.abs(swept - scale * mean)[inside]
    sharp = np.abs(flat.astype(float) - scale * mean)[inside]
    assert np.percentile(off, 99.0) < 0.25 * np.percentile(sharp, 99.0)
    np.testing.assert_array_equal(renderer.render(ABOVE, sun, rng, (ABOVE, ABOVE)), flat)


def test_crests_on_a_fourfold_zoom():
    zoom = replace(scene.CAMERA, fx_px=4.0 * scene.FOCAL, fy_px=4.0 * scene.FOCAL)
    inner = scene.craters(
        [
            (-150.0, 140.0, 90.0, 80.0, 0.0, 0.4),
            (160.0, 150.0, 85.0, 70.0, 0.0, 1.1),
            (150.0, -160.0, 75.0, 75.0, 0.0, 0.0),
            (-160.0, -150.0, 70.0, 60.0, 0.0, 2.2),
        ]
    )
    ground = Terrain(
        inner, scene.relief(), TerrainOptions(cells=1024, irregularity_share=0.0, degradation=0.5)
    )
    offsets = crest_offsets_px(Renderer(zoom, ground, CLEAN), inner, ABOVE, np.arange(4), 48) / 4.0
    assert abs(np.nanmean(offsets)) < 0.01
    assert np.nanmean(np.abs(offsets)) < 0.03


@pytest.mark.parametrize("name", ["dione_descent", "bennu_descent"])
def test_other_bodies_are_rendered(name, tmp_path):
    case = load_scenario(name)
    camera = case.camera.model_copy(update={"width_px": 128, "height_px": 128})
    craters = case.craters.model_copy(update={"min_apparent_px": 8.0, "max_apparent_px": 40.0})
    trajectory = case.trajectory.model_copy(update={"frame_interval_s": 0.5 * case.trajectory.duration_s})
    case = case.model_copy(update={"camera": camera, "craters": craters, "trajectory": trajectory})
    data = Dataset.open(simulate(case, tmp_path / "data"))
    assert data.camera.distortion == case.camera.distortion
    assert data.camera.bit_depth == case.render.bit_depth
    for k in range(3):
        image = data.image(k) / data.camera.full_scale
        assert 0.2 < np.median(image) < 0.7
        assert image.std() > 0.01
