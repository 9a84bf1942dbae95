"""Rendered scenes of the paper: four craters (fig. 10), single craters in windows of images (table 2)."""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg import frames
from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import half_sides, pixel_chart
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, standing
from craternav_fg.simulation.flat_scenes import CAMERA, SEMI_AXES_M, tilted_camera
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.scenes import (
    MIN_SEMI_MINOR_PX,
    MOON,
    Scene,
    photograph,
    sun_direction,
)
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from factors.arrays import FloatArray

# The scene of fig. 10; the paper prints none of these numbers.
FOUR_CRATERS_ALTITUDE_M = 20e3
# East, north, semi-axes, m, and angle, rad, largest first; assumed, as the paper prints none of its own.
_FOUR_CRATERS = np.array(
    [
        (-3600.0, 2600.0, 2300.0, 2100.0, 0.4),
        (3300.0, -2900.0, 1900.0, 1500.0, 1.9),
        (3500.0, 3000.0, 1300.0, 1200.0, 2.6),
        (-2900.0, -3600.0, 800.0, 650.0, 0.9),
    ]
)
_FOUR_TILT_RAD = float(np.deg2rad(15.0))
_FOUR_SUN_ELEVATION_RAD, _FOUR_SUN_AZIMUTH_RAD = np.deg2rad([22.0, 215.0])
_FOUR_RELIEF_SEED = 10
# A third of the usual roughness: the terrain in the paper's picture is smooth.
_FOUR_SLOPE = 0.004

# Single craters: the rim keeps this distance from the image's border.
_BORDER_PX = 8.0
_MAX_TILT_RAD = float(np.deg2rad(30.0))
_SUN_ELEVATION_DEG = (10.0, 50.0)
# Smallest axis ratio; most craters lie above (Robbins 2018). The paper draws both semi-axes by themselves.
_MIN_AXIS_RATIO = 0.75
# A window holds this multiple of the rim's extent and this margin: the front end needs terrain around it.
_WINDOW_SCALE, _WINDOW_MARGIN_PX = 1.5, 80.0
# Draws of a crater until its rim is whole in the image.
_TRIES = 1000


def four_craters(seed: int) -> Scene:
    """Render the scene of fig. 10: the Moon from 20 km, camera 15 deg off nadir, sun 22 deg high.

    Parameters
    ----------
    seed : int
        Seed of the clutter and the sensor noise.

    Returns
    -------
    Scene
    """
    rng = np.random.default_rng([seed, 10])
    site = frames.east_north_up(np.array(0.3), np.array(1.2))
    east, north, a, b, angle = _FOUR_CRATERS.T
    places = np.stack([east, north, np.full(len(east), MOON.radius_m)], axis=-1) @ site.T
    latitude, longitude = frames.latitude_longitude(places)
    relief = Relief(MOON, site[:, 2], ReliefOptions(seed=_FOUR_RELIEF_SEED, slope=_FOUR_SLOPE))
    names = tuple(f"T{k + 1}" for k in range(len(a)))
    catalog = standing(Catalog(names, latitude, longitude, a, b, angle, np.zeros(len(a)), MOON), relief)
    gRc = site @ tilted_camera(FOUR_CRATERS_ALTITUDE_M, _FOUR_TILT_RAD)[:3, :3]
    back_m = FOUR_CRATERS_ALTITUDE_M / np.cos(_FOUR_TILT_RAD)
    gTb = frames.pose(gRc, MOON.radius_m * site[:, 2] - gRc[:, 2] * back_m)
    above = (site[:, 2] * (MOON.radius_m + FOUR_CRATERS_ALTITUDE_M))[None]
    clutter = random_clutter(rng, MOON, above, CraterFieldOptions(reach_altitudes=0.7), catalog)
    sun_g = sun_direction(site, _FOUR_SUN_ELEVATION_RAD, _FOUR_SUN_AZIMUTH_RAD)
    renderer = Renderer(CAMERA, Terrain(catalog, relief, TerrainOptions(), clutter), RenderOptions())
    return photograph(renderer, gTb, sun_g, rng)


@dataclass(frozen=True)
class SingleCrater:
    """A crater and a camera that sees it whole; the body's axes are the camera's.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of body and camera in g.
    catalog : Catalog
        The one crater, standing in the relief.
    relief : Relief
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    """

    gTb: FloatArray
    catalog: Catalog
    relief: Relief
    sun_g: FloatArray


def single_crater(rng: np.random.Generator, altitude_m: float, seed: int) -> SingleCrater:
    """Draw a crater with semi-axes of 0.5 to 2.5 km anywhere in the image of a camera up to 30 deg off nadir.

    Parameters
    ----------
    rng : Generator
    altitude_m : float
    seed : int
        Seed of the terrain.

    Returns
    -------
    SingleCrater

    Raises
    ------
    AssertionError
        When no crater of these sizes lies whole in an image from that altitude.
    """
    for _ in range(_TRIES):
        site = frames.east_north_up(np.arcsin(rng.uniform(-0.9, 0.9, 1)), rng.uniform(0.0, 2.0 * np.pi, 1))[0]
        low = tilted_camera(altitude_m, rng.uniform(0.0, _MAX_TILT_RAD), *rng.uniform(0.0, 2.0 * np.pi, 2))
        gTb = frames.pose(site @ low[:3, :3], (MOON.radius_m + altitude_m) * site[:, 2])
        pixel = rng.uniform(0.0, [CAMERA.width_px - 1.0, CAMERA.height_px - 1.0])
        centre, _ = ground_points(gTb[:3, :3], gTb[:3, 3], CAMERA.normalised(pixel)[None], MOON.radius_m)
        ratio = rng.uniform(_MIN_AXIS_RATIO, 1.0)
        semi_major_m = rng.uniform(SEMI_AXES_M[0] / ratio, SEMI_AXES_M[1])
        latitude, longitude = frames.latitude_longitude(centre)
        catalog = Catalog(
            ("T1",), latitude, longitude, np.array([semi_major_m]), np.array([ratio * semi_major_m]),
            rng.uniform(0.0, np.pi, 1), np.zeros(1), MOON,
        )  # fmt: skip
        relief = Relief(MOON, centre[0], ReliefOptions(seed=seed))
        catalog = standing(catalog, relief)
        elevation, azimuth = np.deg2rad(rng.uniform(*_SUN_ELEVATION_DEG)), rng.uniform(0.0, 2.0 * np.pi)
        sun_g = sun_direction(site, elevation, azimuth)
        rows, _ = catalog.visible(CAMERA, gTb, min_semi_minor_px=MIN_SEMI_MINOR_PX, margin_px=_BORDER_PX)
        if len(rows):
            return SingleCrater(gTb, catalog, relief, sun_g)
    raise AssertionError("no crater of these sizes lies whole in an image from there")


def photograph_window(
    view: SingleCrater, rng: np.random.Generator, options: TerrainOptions, zoom: int = 1
) -> tuple[Scene, Renderer]:
    """Render the window of an image that holds a crater: its pixels are those of the whole image.

    Parameters
    ----------
    view : SingleCrater
    rng : Generator
        Clutter and sensor noise.
    options : TerrainOptions
    zoom : int
        Pixels of the returned renderer along one of the image's.

    Returns
    -------
    Scene
        The window.
    Renderer
        Renderer of the same terrain, with a camera finer by `zoom`.
    """
    camera = window(view)
    gP = view.catalog.centres
    range_m = float(np.linalg.norm(view.gTb[:3, 3] - gP[0]))
    reach = 0.75 * np.hypot(camera.width_px, camera.height_px) / camera.focal_px
    field = CraterFieldOptions(min_apparent_px=10.0, focal_px=camera.focal_px, reach_altitudes=reach)
    above = gP * (1.0 + range_m / MOON.radius_m)
    clutter = random_clutter(rng, MOON, above, field, view.catalog)
    terrain = Terrain(view.catalog, view.relief, options, clutter)
    one = photograph(Renderer(camera, terrain, RenderOptions()), view.gTb, view.sun_g, rng)
    return one, Renderer(_zoomed(camera, zoom), terrain, RenderOptions())


def window(view: SingleCrater) -> Camera:
    """Camera that takes the part of the paper's image around a crater."""
    _, charts = view.catalog.visible(CAMERA, view.gTb, min_semi_minor_px=0.0, margin_px=0.0)
    rim_px = pixel_chart(charts, CAMERA)[0]
    reach = _WINDOW_SCALE * half_sides(rim_px) + _WINDOW_MARGIN_PX
    size = np.array([CAMERA.width_px, CAMERA.height_px])
    low = np.maximum(np.floor(rim_px[:2] - reach), 0.0).astype(int)
    high = np.minimum(np.ceil(rim_px[:2] + reach).astype(int), size - 1)
    width, height = (int(k) for k in high - low + 1)
    return replace(
        CAMERA, width_px=width, height_px=height, cx_px=CAMERA.cx_px - low[0], cy_px=CAMERA.cy_px - low[1]
    )


def _zoomed(camera: Camera, zoom: int) -> Camera:
    return replace(
        camera,
        width_px=zoom * camera.width_px,
        height_px=zoom * camera.height_px,
        fx_px=zoom * camera.fx_px,
        fy_px=zoom * camera.fy_px,
        cx_px=zoom * (camera.cx_px + 0.5) - 0.5,
        cy_px=zoom * (camera.cy_px + 0.5) - 0.5,
    )
