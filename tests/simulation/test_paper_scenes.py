"""Rendered scenes of the paper: single craters in windows of an image."""

import numpy as np

from craternav_fg.simulation.flat_scenes import CAMERA
from craternav_fg.simulation.paper_scenes import photograph_window, single_crater, window
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import TerrainOptions


def test_a_window_has_the_pixels_of_the_whole_image() -> None:
    rng = np.random.default_rng(8)
    view = single_crater(rng, 40e3, 3)
    ground = TerrainOptions(cells=1024)
    one, renderer = photograph_window(view, rng, ground)
    camera = window(view)
    assert one.image.shape == (camera.height_px, camera.width_px) != (1024, 1024)
    x0, y0 = round(CAMERA.cx_px - camera.cx_px), round(CAMERA.cy_px - camera.cy_px)
    clean = RenderOptions(full_well_e=0.0)
    whole = Renderer(CAMERA, renderer.terrain, clean).render(view.gTb, view.sun_g, rng)
    part = Renderer(camera, renderer.terrain, clean).render(view.gTb, view.sun_g, rng)
    inside = whole[y0 : y0 + camera.height_px, x0 : x0 + camera.width_px].astype(float)
    off = np.abs(inside - part)[4:-4, 4:-4]
    assert np.median(off) <= 1.0
    assert np.corrcoef(inside.ravel(), part.ravel())[0, 1] > 0.99


def test_views_are_of_the_papers_first_case() -> None:
    rng = np.random.default_rng(1)
    for seed in range(20):
        view = single_crater(rng, 50e3, seed)
        semi_axes = np.array([view.catalog.semi_major_m[0], view.catalog.semi_minor_m[0]])
        assert np.all((semi_axes >= 500.0) & (semi_axes <= 2500.0))
        down = -view.gTb[:3, 3] / np.linalg.norm(view.gTb[:3, 3])
        assert np.degrees(np.arccos(down @ view.gTb[:3, 2])) <= 30.0
        rows, _ = view.catalog.visible(CAMERA, view.gTb, min_semi_minor_px=12.0, margin_px=2.0)
        assert len(rows) == 1
