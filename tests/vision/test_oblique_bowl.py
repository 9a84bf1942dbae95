"""Oblique images that one large bowl fills: it hides neither other craters nor where the light is from."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.scenes import FOCAL_PX, MOON, photograph, sun_direction
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from craternav_fg.vision.network_detect import find_rims_network
from tests.shared_data import shared

# Craters of this radius, m, and more shape the ground; smaller ones follow it: the catalogue has no heights.
LARGE_M = 12e3
# Heights of the floor of a bowl under its rim, m, at which a crater may lie.
FLOORS_M = np.linspace(0.0, -3500.0, 8)
BORDER_PX = 30.0


def _view(catalog, bowl, seed):
    """Photograph a bowl 25 to 35 deg off nadir; return the scene, and its small rims at each height."""
    rng = np.random.default_rng(seed)
    centre = catalog.centres[bowl]
    near = np.flatnonzero(catalog.centres @ centre > np.cos(0.1) * MOON.radius_m**2)
    near = near[np.argsort(-catalog.semi_major_m[near])]
    large = catalog.take(near[catalog.semi_major_m[near] > LARGE_M])
    small = catalog.take(near[catalog.semi_major_m[near] <= LARGE_M])
    camera = Camera(1024, 1024, FOCAL_PX, FOCAL_PX, 511.5, 511.5)
    altitude_m, tilt = rng.uniform(100e3, 160e3), np.deg2rad(rng.uniform(25.0, 35.0))
    toward, heading, azimuth = rng.uniform(0.0, 2.0 * np.pi, 3)
    site = frames.east_north_up(catalog.latitude_rad[bowl], catalog.longitude_rad[bowl])
    gRc = frames.rotation_exp(tilt * (site @ [np.cos(toward), np.sin(toward), 0.0])) @ site
    gRc = gRc @ np.diag([1.0, -1.0, -1.0]) @ frames.rotation_exp(np.array([0.0, 0.0, heading]))
    gTb = frames.pose(gRc, MOON.radius_m * site[:, 2] - gRc[:, 2] * altitude_m / np.cos(tilt))
    relief = Relief(MOON, (MOON.radius_m + altitude_m) * site[:, 2], ReliefOptions(seed=seed))
    renderer = Renderer(camera, Terrain(large, relief, TerrainOptions(), small), RenderOptions())
    sun_g = sun_direction(site, np.deg2rad(rng.uniform(12.0, 60.0)), azimuth)
    rims = np.full((len(FLOORS_M), len(small), 5), np.nan)
    for out, height_m in zip(rims, FLOORS_M, strict=True):
        lowered = replace(small, height_m=np.full(len(small), height_m))
        rows, charts = lowered.visible(camera, gTb, min_semi_minor_px=3.0)
        out[rows] = axes_of_chart(pixel_chart(charts, camera))
    return photograph(renderer, gTb, sun_g, rng), rims


def _clean(one, rims):
    """Rows of small rims of at least 10 px that no other rim and no crest of a large crater touches."""
    x, y, a, b, _ = rims[0].T
    inside = (b >= 10.0) & (np.minimum(x, y) > a + BORDER_PX) & (np.maximum(x, y) < 1023.0 - BORDER_PX - a)
    out = []
    for i in np.flatnonzero(inside):
        touches = (b > 0.3 * b[i]) & (np.hypot(x - x[i], y - y[i]) < 1.05 * (a + a[i]))
        large_x, large_y, large, _, _ = one.ellipses_px.T
        off = np.abs(np.hypot(large_x - x[i], large_y - y[i]) - large)
        if touches.sum() == 1 and not np.any(off < a[i] + 0.15 * large):
            out.append(i)
    return out


def _is_found(found, rims):
    """Whether there is a rim of a crater at one of its heights, (k, 5)."""
    sizes = np.log(np.sqrt(found.ellipses_px[:, 2] * found.ellipses_px[:, 3]))
    for x, y, a, b, _ in rims:
        near = np.hypot(found.ellipses_px[:, 0] - x, found.ellipses_px[:, 1] - y) < 0.4 * np.sqrt(a * b)
        if np.any(near & (np.abs(sizes - np.log(np.sqrt(a * b))) < 0.4)):
            return True
    return False


def _bowls(catalog):
    """Rows of craters of 54 to 110 km that no other large one touches."""
    large = np.flatnonzero((catalog.semi_major_m > LARGE_M) & (np.abs(catalog.latitude_rad) < 1.1))
    radius, centre = catalog.semi_major_m[large], catalog.centres[large]
    wide = np.flatnonzero((radius > 27e3) & (radius < 55e3) & (np.abs(catalog.latitude_rad[large]) < 1.0))
    reach = [np.linalg.norm(centre - centre[i], axis=1) < 1.2 * (radius + radius[i]) for i in wide]
    return large[wide[np.sum(reach, axis=1) == 1]]


@pytest.mark.slow
def test_a_large_bowl_hides_neither_the_others_nor_the_light():
    catalog, _ = import_catalog(shared("lu1319381.parquet"))
    bowls = np.random.default_rng(0).choice(_bowls(catalog), 8, replace=False)
    clean, seen, undecided = 0, 0, 0
    for seed, bowl in enumerate(bowls):
        one, rims = _view(catalog, bowl, seed)
        found = find_rims_network(one.image)
        rows = _clean(one, rims)
        clean += len(rows)
        seen += sum(_is_found(found, rims[:, i]) for i in rows)
        undecided += np.isnan(found.sun_angle_rad)
        off_rad = np.angle(np.exp(1j * (found.sun_angle_rad - one.sun_angle_rad)))
        assert not abs(np.rad2deg(off_rad)) > 30.0, seed
    assert clean >= 40
    assert seen >= 0.92 * clean
    assert undecided <= 1
