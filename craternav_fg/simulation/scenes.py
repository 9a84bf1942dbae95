"""Rendered scenes with known truth: images of the Moon whose rims are known, for detectors and front end."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body, ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, chart_of_axes, half_sides, pixel_chart
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.flat_scenes import HALF_FIELD
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from craternav_fg.sun_in_image import sun_angle_in_image
from factors.arrays import FloatArray

# IAU mean radius, GRAIL's gravity, sidereal rotation.
MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))
ALTITUDE_M = 50e3
# Of 1024 px across 44 deg.
FOCAL_PX = 512.0 / HALF_FIELD
# A detector is expected to find rims of at least this semi-minor axis and this slope contrast.
MIN_SEMI_MINOR_PX = 12.0
MIN_SLOPE_CONTRAST = 0.5
# Rims that are known at all, also those too small to be expected.
_SMALLEST_KNOWN_PX = 3.0
# Catalogued craters of a scene, from the altitude of the scene.
_SMALLEST_CATALOGUED_PX = 10.0


@dataclass(frozen=True)
class Ground:
    """Terrain and camera of a rendered scene.

    Attributes
    ----------
    density, separation_ratio : float
        Density and separation of the craters, see `CraterFieldOptions`.
    slope : float
        Roughness of the terrain, see `ReliefOptions`.
    irregularity_share : float
        Irregularity of the outlines, see `TerrainOptions`.
    tilt_deg : tuple of float
        Smallest and largest tilt of the camera from nadir.
    size_px : int
        Side of the image; the field of view is 44 deg.
    lunar_lambert : float
        Law of reflection, see `RenderOptions`.
    """

    density: float = 0.005
    separation_ratio: float = 1.3
    slope: float = 0.012
    irregularity_share: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 30.0)
    size_px: int = 1024
    lunar_lambert: float = RenderOptions.lunar_lambert


# Outlines 3 % off their ellipses (RMS).
IRREGULAR = Ground(irregularity_share=0.03)
# Overlapping craters on rough terrain.
HARD = Ground(density=0.01, separation_ratio=0.75, slope=0.03)


@dataclass(frozen=True)
class Scene:
    """A rendered image and its rims.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W)
    camera : Camera
        At the body's origin, axes as the body's.
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        True pose.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    ellipses_px : ndarray, shape (n, 5)
        True rims as in `FoundRims`, those that are small or cut by the border included.
    craters : ndarray of int, shape (n,)
        Their rows in the catalogue.
    slope_contrast : ndarray, shape (n,)
        Relative change of brightness per unit slope of locally flat terrain at each rim, see `photometry`.
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.
    """

    image: npt.NDArray[np.uint8]
    camera: Camera
    catalog: Catalog
    gTb: FloatArray
    sun_g: FloatArray
    ellipses_px: FloatArray
    craters: npt.NDArray[np.int64]
    slope_contrast: FloatArray
    sun_angle_rad: float

    @property
    def range_m(self) -> float:
        """Distance along the optical axis to the sphere, m; the camera must look at it."""
        gTc = self.camera.gTc(self.gTb)
        foot, _ = ground_points(gTc[:3, :3], gTc[:3, 3], np.zeros((1, 2)), self.catalog.body.radius_m)
        return float(np.linalg.norm(foot[0] - gTc[:3, 3]))

    @property
    def wanted(self) -> npt.NDArray[np.bool_]:
        """Mask, shape (n,), of the rims a detector is expected to find: large, shaded, whole in the image."""
        x, y, _, b, _ = self.ellipses_px.T
        half_x, half_y = half_sides(chart_of_axes(self.ellipses_px)).T
        height, width = self.image.shape
        whole = (x > half_x) & (x + half_x < width - 1) & (y > half_y) & (y + half_y < height - 1)
        return np.asarray(whole & (b >= MIN_SEMI_MINOR_PX) & (self.slope_contrast > MIN_SLOPE_CONTRAST))


def scene(seed: int, ground: Ground | None = None) -> Scene:
    """Render the Moon from 50 km; the sun, 10 to 60 deg high, and the camera's tilt are random.

    Parameters
    ----------
    seed : int
    ground : Ground, optional

    Returns
    -------
    Scene
    """
    ground = ground or Ground()
    rng = np.random.default_rng(seed)
    focal = FOCAL_PX * ground.size_px / 1024
    middle = 0.5 * (ground.size_px - 1)
    camera = Camera(ground.size_px, ground.size_px, focal, focal, middle, middle)
    site = frames.east_north_up(np.array(0.2), np.array(0.1 * seed))
    foot = MOON.radius_m * site[:, 2]
    track = np.stack([(1.0 + share * ALTITUDE_M / MOON.radius_m) * foot for share in (1.0, 0.9)])
    relief = Relief(MOON, track[-1], ReliefOptions(seed=seed, slope=ground.slope))
    field = CraterFieldOptions(
        min_apparent_px=_SMALLEST_CATALOGUED_PX,
        density=ground.density,
        separation_ratio=ground.separation_ratio,
        focal_px=focal,
    )
    catalog = random_craters(rng, MOON, track, field, relief)
    clutter = random_clutter(rng, MOON, track, field, catalog)
    azimuth, toward, heading = rng.uniform(0.0, 2.0 * np.pi, 3)
    elevation, tilt = np.deg2rad([rng.uniform(10.0, 60.0), rng.uniform(*ground.tilt_deg)])
    axis = tilt * (site @ [np.cos(toward), np.sin(toward), 0.0])
    gRc = frames.rotation_exp(axis) @ site @ np.diag([1.0, -1.0, -1.0])
    gRc = gRc @ frames.rotation_exp(np.array([0.0, 0.0, heading]))
    gTb = frames.pose(gRc, foot - gRc[:, 2] * ALTITUDE_M / np.cos(tilt))
    options = TerrainOptions(irregularity_share=ground.irregularity_share)
    light = RenderOptions(lunar_lambert=ground.lunar_lambert)
    renderer = Renderer(camera, Terrain(catalog, relief, options, clutter), light)
    return photograph(renderer, gTb, sun_direction(site, elevation, azimuth), rng)


def sun_direction(site: FloatArray, elevation_rad: float, azimuth_rad: float) -> FloatArray:
    """Return the unit vector towards the sun.

    Parameters
    ----------
    site : ndarray, shape (3, 3)
        Rotation from local east, north and up to g.
    elevation_rad, azimuth_rad : float
        Above the local horizon, and from east towards north.

    Returns
    -------
    ndarray, shape (3,)
        In g.
    """
    flat = np.cos(elevation_rad)
    return np.asarray(site @ [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)])


def photograph(renderer: Renderer, gTb: FloatArray, sun_g: FloatArray, rng: np.random.Generator) -> Scene:
    """Render an image with the truth about its rims.

    Parameters
    ----------
    renderer : Renderer
        Its camera is at the body's origin, axes as the body's, and has 8 bits.
    gTb : ndarray, shape (4, 4)
        Pose of body and camera in g.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    rng : Generator
        Sensor noise.

    Returns
    -------
    Scene

    Raises
    ------
    ValueError
        When the image's centre shows no ground in the sun.
    """
    camera, catalog = renderer.camera, renderer.terrain.catalog
    around_px = float(max(camera.width_px, camera.height_px))
    rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=_SMALLEST_KNOWN_PX, margin_px=-around_px)
    view = gTb[:3, 3] - catalog.centres[rows]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    _, contrast = flat_terrain_brightness(catalog.normals[rows], sun_g, view)
    sun_angle_rad = sun_angle_in_image(camera, gTb, sun_g, catalog.body.radius_m)
    if sun_angle_rad is None:
        raise ValueError("expected ground in the sun at the image's centre")
    return Scene(
        renderer.render(gTb, sun_g, rng).astype(np.uint8, copy=False),
        camera,
        catalog,
        gTb,
        sun_g,
        axes_of_chart(pixel_chart(charts, camera)),
        rows,
        np.linalg.norm(contrast, axis=1),
        sun_angle_rad,
    )
