"""Cost of rendering an image by altitude and samples per pixel: time and memory."""

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from craternav_fg import frames
from craternav_fg.bench.timing import peak_mb
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from factors.arrays import FloatArray

# From the start of a descent to its last phase.
ALTITUDES_M = (100e3, 30e3, 10e3, 2e3)
# Frames timed at each altitude, a tenth of the altitude apart; the first ones build the grids.
FRAMES = 4


def render_costs() -> dict[str, float]:
    """Render level flights at several altitudes over one terrain, with the demo's body and camera.

    Returns
    -------
    dict of str to float
        `render_s`: mean seconds per frame with one sample per pixel, grids included, over all altitudes;
        `render_2x2_s`: the same with four samples; `render_altitude_ratio`: the slowest altitude over the
        fastest, with one sample; `render_peak_mb`: peak memory of a process that does nothing else.
    """
    # A process of its own: the memory that this one has held before does not count.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        return alone.submit(_costs, ALTITUDES_M, FRAMES).result()


def _costs(altitudes_m: Sequence[float], count: int) -> dict[str, float]:
    scenario = load_scenario("lunar_descent")
    body, camera = scenario.body.body(), scenario.camera.camera()
    trajectory = scenario.trajectory
    enu = frames.east_north_up(
        np.radians(trajectory.site_latitude_deg), np.radians(trajectory.site_longitude_deg)
    )
    sun = enu @ np.array([np.cos(0.5) * 0.8, np.cos(0.5) * 0.6, np.sin(0.5)])
    # Looking down, the top of the image to the north.
    looking = np.stack([enu[:, 0], -enu[:, 1], -enu[:, 2]], axis=-1) @ camera.bTc[:3, :3].T
    relief = Relief(body, enu[:, 2], ReliefOptions())
    options = CraterFieldOptions(focal_px=camera.focal_px)
    track = (body.radius_m + np.geomspace(altitudes_m[0], altitudes_m[-1], 60))[:, None] * enu[:, 2]
    rng = np.random.default_rng(0)
    catalog = random_craters(rng, body, track, options, relief)
    clutter = random_clutter(rng, body, track, options, catalog)
    seconds = {}
    for samples in (1, 2):
        ground = Terrain(catalog, relief, TerrainOptions(), clutter)
        renderer = Renderer(camera, ground, replace(RenderOptions(), samples=samples))
        # Compiles.
        renderer.render(frames.pose(looking, track[0]), sun, rng)
        seconds[samples] = [
            _frame_s(renderer, looking, enu, altitude_m, sun, rng, count) for altitude_m in altitudes_m
        ]
    return {
        "render_s": float(np.mean(seconds[1])),
        "render_2x2_s": float(np.mean(seconds[2])),
        "render_altitude_ratio": max(seconds[1]) / min(seconds[1]),
        "render_peak_mb": peak_mb(),
    }


def _frame_s(
    renderer: Renderer,
    looking: FloatArray,
    enu: FloatArray,
    altitude_m: float,
    sun: FloatArray,
    rng: np.random.Generator,
    count: int,
) -> float:
    """Mean seconds per frame of a level flight."""
    began = time.perf_counter()
    for k in range(count):
        offset = 0.1 * k * altitude_m * enu[:, 0]
        position = (renderer.terrain.body.radius_m + altitude_m) * enu[:, 2] + offset
        renderer.render(frames.pose(looking, position), sun, rng)
    return (time.perf_counter() - began) / count
