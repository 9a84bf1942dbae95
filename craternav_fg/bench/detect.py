"""How well and how fast craters are found without a prior, on rendered ground whose rims are known."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.bench.problems import ALTITUDE_M, FOCAL_PX, MOON
from craternav_fg.camera import Camera, pixel_chart
from craternav_fg.evaluation.matching import match
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import FoundRims, ellipse_parameters, find_rims
from craternav_fg.vision.photometry import level_ground

FloatArray = npt.NDArray[np.float64]
Detector = Callable[[npt.NDArray[np.uint8]], FoundRims]

# Rims that must be found: at least this semi-minor axis and this gain, whole in the image.
LEAST_PX = 12.0
LEAST_GAIN = 0.5
REPETITIONS = 3


@dataclass(frozen=True)
class Ground:
    """What is rendered.

    Attributes
    ----------
    density, separation : float
        Of the craters, see `CraterFieldOptions`.
    slope : float
        Roughness, see `ReliefOptions`.
    size_px : int
        Side of the image; the field of view is 44 deg.
    """

    density: float = 0.005
    separation: float = 1.3
    slope: float = 0.012
    size_px: int = 1024


# Craters cut one another's rims, on rough ground.
HARD = Ground(density=0.01, separation=0.75, slope=0.03)


@dataclass(frozen=True)
class Scene:
    """A rendered image and its rims.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W)
    ellipses_px : ndarray, shape (n, 5)
        As in `FoundRims`; also those that are small or cut by the border.
    gain : ndarray, shape (n,)
        Shading gain at each.
    light_rad : float
        Direction in the image, from x towards y, from which the light comes.
    """

    image: npt.NDArray[np.uint8]
    ellipses_px: FloatArray
    gain: FloatArray
    light_rad: float

    @property
    def wanted(self) -> npt.NDArray[np.bool_]:
        """Which rims must be found."""
        x, y, a, b, angle = self.ellipses_px.T
        half_x = np.hypot(a * np.cos(angle), b * np.sin(angle))
        half_y = np.hypot(a * np.sin(angle), b * np.cos(angle))
        height, width = self.image.shape
        whole = (x > half_x) & (x + half_x < width - 1) & (y > half_y) & (y + half_y < height - 1)
        return np.asarray(whole & (b >= LEAST_PX) & (self.gain > LEAST_GAIN))


def scene(seed: int, ground: Ground | None = None) -> Scene:
    """Render the Moon from 50 km: sun 10 to 60 deg high, camera tilted by up to 30 deg, at random.

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
    options = CraterFieldOptions(
        min_apparent_px=10.0, density=ground.density, separation=ground.separation, focal_px=focal
    )
    catalog = random_craters(rng, MOON, track, options, relief)
    clutter = random_clutter(rng, MOON, track, options, catalog)
    azimuth, toward, heading = rng.uniform(0.0, 2.0 * np.pi, 3)
    elevation, tilt = np.deg2rad([rng.uniform(10.0, 60.0), rng.uniform(0.0, 30.0)])
    axis = tilt * (site @ [np.cos(toward), np.sin(toward), 0.0])
    gRc = frames.rotation_exp(axis) @ site @ np.diag([1.0, -1.0, -1.0])
    gRc = gRc @ frames.rotation_exp(np.array([0.0, 0.0, heading]))
    gTb = frames.pose(gRc, foot - gRc[:, 2] * ALTITUDE_M / np.cos(tilt))
    flat = np.cos(elevation)
    sun_g = site @ [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
    renderer = Renderer(camera, Terrain(catalog, relief, TerrainOptions(), clutter), RenderOptions())
    rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=3.0, margin_px=-float(ground.size_px))
    normals = np.concatenate([catalog.normals[rows], site[:, 2][None]])
    points = np.concatenate([catalog.centres[rows], foot[None]])
    view = gTb[:3, 3] - points
    _, gain = level_ground(normals, sun_g, view / np.linalg.norm(view, axis=1, keepdims=True))
    along = gain[-1] / np.linalg.norm(gain[-1])
    ends = camera.project((foot + np.outer([0.0, 100.0], along) - gTb[:3, 3]) @ gRc)
    return Scene(
        renderer.render(gTb, sun_g, rng).astype(np.uint8, copy=False),
        ellipse_parameters(pixel_chart(charts, camera)),
        np.linalg.norm(gain[:-1], axis=1),
        float(np.arctan2(*(ends[1] - ends[0])[::-1])),
    )


def accuracy(scenes: list[Scene], detector: Detector) -> dict[str, float]:
    """Recall, precision and mean absolute errors, px, over all scenes.

    A detection below `LEAST_PX` that matches nothing does not count: uncatalogued craters are as small.
    """
    hits, missed, false = 0, 0, 0
    errors = []
    for one in scenes:
        found = detector(one.image).ellipses_px
        result = match(found, one.ellipses_px, one.wanted, found[:, 3] >= LEAST_PX)
        hits += len(result.centre_px)
        missed += len(result.missed)
        false += len(result.false)
        errors.append(np.stack([result.centre_px, result.semi_major_px, result.semi_minor_px]))
    centre, major, minor = np.abs(np.concatenate(errors, axis=1)).mean(axis=1)
    return {
        "rims": hits + missed,
        "recall": hits / max(hits + missed, 1),
        "precision": hits / max(hits + false, 1),
        "centre_px": float(centre),
        "semi_major_px": float(major),
        "semi_minor_px": float(minor),
    }


def detect_ms(images: int = 6) -> dict[str, float]:
    """Measure both detectors on plain ground, and the better one on hard ground.

    Parameters
    ----------
    images : int
        Of each kind, 1024 x 1024 px.

    Returns
    -------
    dict
        `detect_ms`, the median duration on plain ground, and the figures of `accuracy` under the prefixes
        `detect_`, `detect_hard_` and `detect_canny_`.
    """
    plain = [scene(seed) for seed in range(images)]
    hard = [scene(seed, HARD) for seed in range(images)]
    cases = (("", plain, find_rims), ("hard_", hard, find_rims), ("canny_", plain, find_rims_canny))
    figures = {
        f"detect_{prefix}{name}": value
        for prefix, scenes, detector in cases
        for name, value in accuracy(scenes, detector).items()
    }
    return {"detect_ms": float(np.median([_duration_ms(one.image) for one in plain])), **figures}


def _duration_ms(image: npt.NDArray[np.uint8]) -> float:
    """Duration of one detection: the shortest of a few, the others were disturbed."""
    durations = []
    for _ in range(REPETITIONS):
        began_s = time.perf_counter()
        find_rims(image)
        durations.append(time.perf_counter() - began_s)
    return 1e3 * min(durations)
