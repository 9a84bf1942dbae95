"""Images of single craters as the paper's camera takes them, for table 2.

Only the part of the 1024 x 1024 image around the crater is rendered: its pixels are those of the whole image.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.reproduce.options import SEMI_AXES_M
from craternav_fg.reproduce.paper_scenes import CAMERA, tilted_camera
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, standing
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.scenes import MOON, Scene, taken
from craternav_fg.simulation.terrain import Terrain, TerrainOptions

FloatArray = npt.NDArray[np.float64]

# Smaller rims are below what the front end measures.
LEAST_PX = 12.0
_MARGIN_PX = 8.0
_MAX_TILT_RAD = float(np.deg2rad(30.0))
_SUN_DEG = (10.0, 50.0)
# As craters are; the paper draws both semi-axes by themselves.
_LEAST_RATIO = 0.75
# What is rendered around a rim: share of its extent, px; the front end wants level ground about it, too.
_WINDOW = (1.5, 80.0)
_TRIES = 1000


@dataclass(frozen=True)
class View:
    """A crater and a camera that sees it whole; the body's axes are the camera's.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
    catalog : Catalog
        The one crater, standing in the relief.
    relief : Relief
    sun_g : ndarray, shape (3,)
    """

    gTb: FloatArray
    catalog: Catalog
    relief: Relief
    sun_g: FloatArray


def draw_view(rng: np.random.Generator, altitude_m: float, seed: int) -> View:
    """Draw a view: semi-axes of 0.5 to 2.5 km, up to 30 deg off nadir, the crater anywhere in the image.

    Parameters
    ----------
    rng : Generator
    altitude_m : float
    seed : int
        Of the ground.
    """
    for _ in range(_TRIES):
        site = frames.east_north_up(np.arcsin(rng.uniform(-0.9, 0.9, 1)), rng.uniform(0.0, 2.0 * np.pi, 1))[0]
        low = tilted_camera(altitude_m, rng.uniform(0.0, _MAX_TILT_RAD), *rng.uniform(0.0, 2.0 * np.pi, 2))
        gTb = frames.pose(site @ low[:3, :3], (MOON.radius_m + altitude_m) * site[:, 2])
        pixel = rng.uniform(0.0, [CAMERA.width_px - 1.0, CAMERA.height_px - 1.0])
        centre, _ = ground_points(gTb[:3, :3], gTb[:3, 3], CAMERA.normalised(pixel)[None], MOON.radius_m)
        ratio = rng.uniform(_LEAST_RATIO, 1.0)
        semi_major_m = rng.uniform(SEMI_AXES_M[0] / ratio, SEMI_AXES_M[1])
        latitude, longitude = frames.latitude_longitude(centre)
        catalog = Catalog(
            ("T1",), latitude, longitude, np.array([semi_major_m]), np.array([ratio * semi_major_m]),
            rng.uniform(0.0, np.pi, 1), np.zeros(1), MOON,
        )  # fmt: skip
        relief = Relief(MOON, centre[0], ReliefOptions(seed=seed))
        catalog = standing(catalog, relief)
        elevation, azimuth = np.deg2rad(rng.uniform(*_SUN_DEG)), rng.uniform(0.0, 2.0 * np.pi)
        flat = np.cos(elevation)
        sun_g = site @ [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
        if len(catalog.visible(CAMERA, gTb, min_semi_minor_px=LEAST_PX, margin_px=_MARGIN_PX)[0]):
            return View(gTb, catalog, relief, sun_g)
    raise AssertionError("no crater of these sizes lies whole in an image from there")


def photograph(
    view: View, rng: np.random.Generator, options: TerrainOptions, zoom: int = 1
) -> tuple[Scene, Renderer]:
    """Take the part of an image that holds a view's crater; the renderer is that of a finer camera.

    Parameters
    ----------
    view : View
    rng : Generator
        Clutter and sensor noise.
    options : TerrainOptions
    zoom : int
        Pixels of the renderer's camera along one of the image's.
    """
    camera = window(view)
    gP = view.catalog.centres
    range_m = float(np.linalg.norm(view.gTb[:3, 3] - gP[0]))
    reach = 0.75 * np.hypot(camera.width_px, camera.height_px) / camera.focal_px
    field = CraterFieldOptions(min_apparent_px=10.0, focal_px=camera.focal_px, reach=reach)
    above = gP * (1.0 + range_m / MOON.radius_m)
    clutter = random_clutter(rng, MOON, above, field, view.catalog)
    terrain = Terrain(view.catalog, view.relief, options, clutter)
    one = taken(Renderer(camera, terrain, RenderOptions()), view.gTb, view.sun_g, rng)
    return one, Renderer(_zoomed(camera, zoom), terrain, RenderOptions())


def window(view: View) -> Camera:
    """Camera that takes the part of the paper's image around a view's crater."""
    _, charts = view.catalog.visible(CAMERA, view.gTb, min_semi_minor_px=0.0, margin_px=0.0)
    x, y, a, b, angle = axes_of_chart(pixel_chart(charts, CAMERA))[0]
    half = [np.hypot(a * np.cos(angle), b * np.sin(angle)), np.hypot(a * np.sin(angle), b * np.cos(angle))]
    reach = _WINDOW[0] * np.array(half) + _WINDOW[1]
    size = np.array([CAMERA.width_px, CAMERA.height_px])
    centre = np.array([x, y])
    low = np.maximum(np.floor(centre - reach), 0.0).astype(int)
    high = np.minimum(np.ceil(centre + reach).astype(int), size - 1)
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
