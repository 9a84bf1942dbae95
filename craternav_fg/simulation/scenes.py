"""Rendered ground whose rims are known: what the front end and the detectors are measured on."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body, ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.photometry import level_ground
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions

FloatArray = npt.NDArray[np.float64]

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))
ALTITUDE_M = 50e3
FOCAL_PX = 512 / np.tan(np.radians(22))
# Rims that must be found: at least this semi-minor axis and this slope contrast, whole in the image.
LEAST_PX = 12.0
LEAST_SLOPE_CONTRAST = 0.5


@dataclass(frozen=True)
class Ground:
    """What is rendered.

    Attributes
    ----------
    density, separation : float
        Of the craters, see `CraterFieldOptions`.
    slope : float
        Roughness, see `ReliefOptions`.
    irregularity : float
        Of the outlines, see `TerrainOptions`.
    tilt_deg : tuple of float
        Least and largest tilt of the camera.
    size_px : int
        Side of the image; the field of view is 44 deg.
    """

    density: float = 0.005
    separation: float = 1.3
    slope: float = 0.012
    irregularity: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 30.0)
    size_px: int = 1024


# Outlines 3 % off their ellipses; craters that cut one another's rims, on rough ground.
IRREGULAR = Ground(irregularity=0.03)
HARD = Ground(density=0.01, separation=0.75, slope=0.03)


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
    sun_g : ndarray, shape (3,)
    ellipses_px : ndarray, shape (n, 5)
        As in `FoundRims`; also those that are small or cut by the border.
    craters : ndarray of int, shape (n,)
        Their rows in the catalogue.
    slope_contrast : ndarray, shape (n,)
        Relative change of brightness per unit slope at each, see `photometry`.
    sun_angle_rad : float
        Direction in the image, from x towards y, from which the light comes.
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
        """Which rims must be found."""
        x, y, a, b, angle = self.ellipses_px.T
        half_x = np.hypot(a * np.cos(angle), b * np.sin(angle))
        half_y = np.hypot(a * np.sin(angle), b * np.cos(angle))
        height, width = self.image.shape
        whole = (x > half_x) & (x + half_x < width - 1) & (y > half_y) & (y + half_y < height - 1)
        return np.asarray(whole & (b >= LEAST_PX) & (self.slope_contrast > LEAST_SLOPE_CONTRAST))


def scene(seed: int, ground: Ground | None = None) -> Scene:
    """Render the Moon from 50 km: sun 10 to 60 deg high, camera tilted, all at random.

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
        min_apparent_px=10.0, density=ground.density, separation=ground.separation, focal_px=focal
    )
    catalog = random_craters(rng, MOON, track, field, relief)
    clutter = random_clutter(rng, MOON, track, field, catalog)
    azimuth, toward, heading = rng.uniform(0.0, 2.0 * np.pi, 3)
    elevation, tilt = np.deg2rad([rng.uniform(10.0, 60.0), rng.uniform(*ground.tilt_deg)])
    axis = tilt * (site @ [np.cos(toward), np.sin(toward), 0.0])
    gRc = frames.rotation_exp(axis) @ site @ np.diag([1.0, -1.0, -1.0])
    gRc = gRc @ frames.rotation_exp(np.array([0.0, 0.0, heading]))
    gTb = frames.pose(gRc, foot - gRc[:, 2] * ALTITUDE_M / np.cos(tilt))
    flat = np.cos(elevation)
    sun_g = site @ [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
    options = TerrainOptions(irregularity=ground.irregularity)
    renderer = Renderer(camera, Terrain(catalog, relief, options, clutter), RenderOptions())
    return taken(renderer, gTb, sun_g, rng)


def taken(renderer: Renderer, gTb: FloatArray, sun_g: FloatArray, rng: np.random.Generator) -> Scene:
    """Take an image, and note what it shows.

    Parameters
    ----------
    renderer : Renderer
        Its camera is at the body's origin, axes as the body's, and has 8 bits.
    gTb : ndarray, shape (4, 4)
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun.
    rng : Generator
        Sensor noise.
    """
    camera, catalog = renderer.camera, renderer.terrain.catalog
    around_px = float(max(camera.width_px, camera.height_px))
    rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=3.0, margin_px=-around_px)
    centre_px = np.array([[0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)]])
    middle, _ = ground_points(gTb[:3, :3], gTb[:3, 3], camera.normalised(centre_px), catalog.body.radius_m)
    normals = np.concatenate([catalog.normals[rows], middle / np.linalg.norm(middle)])
    points = np.concatenate([catalog.centres[rows], middle])
    view = gTb[:3, 3] - points
    _, gain = level_ground(normals, sun_g, view / np.linalg.norm(view, axis=1, keepdims=True))
    along = gain[-1] / np.linalg.norm(gain[-1])
    ends = camera.project((middle + np.outer([0.0, 100.0], along) - gTb[:3, 3]) @ gTb[:3, :3])
    return Scene(
        renderer.render(gTb, sun_g, rng).astype(np.uint8, copy=False),
        camera,
        catalog,
        gTb,
        sun_g,
        axes_of_chart(pixel_chart(charts, camera)),
        rows,
        np.linalg.norm(gain[:-1], axis=1),
        float(np.arctan2(*(ends[1] - ends[0])[::-1])),
    )
