"""Heights of an elevation model on the grids of the terrain."""

import time

import cv2
import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.nested_dem import read_nested_dem
from craternav_fg.simulation.relief import Relief, ReliefOptions, Window
from tests.catalogs.test_dem import write
from tests.simulation import scene

# As the published models of the Moon: rows 118 m apart, and coarser ones around them.
STEP_DEG = 0.0039
SITE = np.radians([20.0, 30.0])


@pytest.fixture(scope="module")
def relief(tmp_path_factory):
    folder = tmp_path_factory.mktemp("relief")
    rng = np.random.default_rng(3)
    parts = []
    for name, step_deg, size in (("fine", STEP_DEG, 600), ("coarse", 16.0 * STEP_DEG, 120)):
        corner = (30.0 - 0.5 * size * step_deg, 20.0 + 0.5 * size * step_deg, step_deg, step_deg)
        # Stereo models are smooth over a few points.
        rough = cv2.GaussianBlur(rng.normal(scale=200.0, size=(size, size)), (0, 0), 1.5)
        parts.append(write(folder / f"{name}.tif", (2000.0 + rough).astype(np.float32), corner))
    return Relief(scene.MOON, frames.up(*SITE), ReliefOptions(slope=0.0), read_nested_dem(parts))


def direct(relief, exponent, first, window):
    x = 2.0**exponent * (first[0] + np.arange(window.left, window.right))
    y = 2.0**exponent * (first[1] + np.arange(window.low, window.high))
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return relief.base_m(xy).reshape(len(y), len(x))


@pytest.mark.parametrize("exponent", [0, 2, 3, 4, 5, 7])
def test_grids_have_the_heights_of_the_elevation_model(relief, exponent):
    window = Window(37, 260, 101, 180)
    first = (-(40 << 5 >> exponent), 11)
    found = relief.grid(exponent, first, 512, 32, window)
    expected = direct(relief, exponent, first, window)
    assert np.ptp(expected) > 5.0
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.1)
    slopes = [np.diff(one, axis=0) / 2.0**exponent for one in (found, expected)]
    assert np.std(slopes[0] - slopes[1]) < 0.003 * np.std(slopes[1]) + 2e-4


def test_models_give_way_to_each_other_without_a_cliff(tmp_path):
    # The fine one is 300 m higher than the one around it.
    size, coarse = 600, 16.0 * STEP_DEG
    half_deg = 0.5 * size * STEP_DEG
    fine = write(
        tmp_path / "fine.tif", np.full((size, size), 300.0, np.float32),
        (30.0 - half_deg, 20.0 + half_deg, STEP_DEG, STEP_DEG),
    )  # fmt: skip
    around = write(
        tmp_path / "coarse.tif", np.zeros((120, 120), np.float32),
        (30.0 - 60 * coarse, 20.0 + 60 * coarse, coarse, coarse),
    )  # fmt: skip
    dem = read_nested_dem([fine, around])
    relief = Relief(scene.MOON, frames.up(*SITE), ReliefOptions(slope=0.0), dem)
    for across in ([1.0, 0.0], [0.0, -1.0], [-0.6, 0.8]):
        xy = np.linspace(0.0, 80e3, 4000)[:, None] * np.array(across)
        heights = relief.base_m(xy)
        assert heights[[0, -1]] == pytest.approx([300.0, 0.0], abs=0.1)
        assert np.abs(np.diff(heights)).max() < 4.0
        ground = np.concatenate([xy, np.full((len(xy), 1), scene.MOON.radius_m)], axis=1) @ relief.gRs.T
        ground /= np.linalg.norm(ground, axis=1, keepdims=True)
        np.testing.assert_allclose(heights, dem.heights_m(ground), atol=1e-6)


def test_a_grid_is_the_same_in_parts(relief):
    whole = relief.grid(2, (-500, 300), 512, 32)
    for window in (Window(0, 1, 0, 512), Window(13, 300, 7, 9), Window(200, 512, 511, 512)):
        part = relief.grid(2, (-500, 300), 512, 32, window)
        np.testing.assert_array_equal(part, whole[window.low : window.high, window.left : window.right])


def test_fine_grids_cost_a_fraction_of_their_points(relief):
    def seconds(work):
        begun = time.process_time()
        work()
        return time.process_time() - begun

    relief.grid(2, (0, 0), 64, 4)
    window = Window(0, 512, 0, 512)
    fast, slow = (
        min(seconds(work) for _ in range(3))
        for work in (lambda: relief.grid(2, (0, 0), 512, 32), lambda: direct(relief, 2, (0, 0), window))
    )
    assert fast < 0.4 * slow
