"""Simulated views of a crater catalogue, and what identifying their craters costs.

Identification never sees the truth in them.
"""

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import centre_and_matrix_px
from craternav_fg.matching.identify.search import Identification, identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.scenes import MOON

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SIDE_PX = 1024
# Craters larger than a diameter in km, in the 21,433 of a thinned global catalogue of Robbins (2018).
_DIAMETERS_KM = np.array([3.9, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0])
_LARGER = np.array([21433.0, 14477.0, 10855.0, 7164.0, 5150.0, 2604.0, 1504.0, 695.0, 249.0, 11.0, 0.5])
# Median and spread of ln(a / b), as of that catalogue.
_FLATTENING, _FLATTENING_SPREAD = 0.0725, 0.79


@dataclass(frozen=True)
class SceneOptions:
    """What is seen, and how well.

    Attributes
    ----------
    altitudes_m : tuple of float
        Least and largest, logarithmically uniform.
    field_deg : float
        Of view, across the square image.
    largest_tilt_deg : float
        Of the optical axis from nadir, uniform.
    sigma_px : float
        Noise of each coordinate of a centre. That of each semi-axis is half of it, and no more than a
        tenth of the axis.
    missing, false : float
        Share of the visible rims that are not found, and of the found that are none.
    least_px : float
        Smallest semi-minor axis that is found.
    """

    altitudes_m: tuple[float, float] = (100e3, 600e3)
    field_deg: float = 60.0
    largest_tilt_deg: float = 30.0
    sigma_px: float = 1.0
    missing: float = 0.25
    false: float = 0.2
    least_px: float = 5.0


@dataclass(frozen=True)
class Scene:
    """One view.

    Attributes
    ----------
    camera : Camera
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first from x towards y.
    gTb : ndarray, shape (4, 4)
        Truth.
    craters : ndarray of int, shape (n,)
        Truth: row in the catalogue, -1 of a false rim.
    """

    camera: Camera
    ellipses_px: FloatArray
    gTb: FloatArray
    craters: IntArray

    @property
    def true(self) -> int:
        """Rims that are craters."""
        return int(np.sum(self.craters >= 0))

    def mirrored(self) -> FloatArray:
        """Ellipses (n, 5) of the mirror image: no pose shows these craters so."""
        out = self.ellipses_px.copy()
        out[:, 0] = self.camera.width_px - 1 - out[:, 0]
        out[:, 4] = -out[:, 4]
        return out


def identify_scalars(views: int = 100) -> dict[str, float]:
    """Measure identification on one core, position and attitude unknown, six true craters or more.

    Parameters
    ----------
    views : int
        At 100 to 600 km, of 44 and 60 deg, with noise of 0, 1, 3 and 6 px, of a synthetic catalogue.

    Returns
    -------
    dict
        `identify_ms_median`, `identify_ms_p95`; `identify_solved` and `identify_wrong`, shares of the views;
        `identify_no_answer_ms`, the median of mirrored views; `identify_index_s`.
    """
    rng = np.random.default_rng(7)
    TripleIndex.build(synthetic_catalog(MOON, rng, count=500))
    catalog = synthetic_catalog(MOON, rng)
    began = time.perf_counter()
    index = TripleIndex.build(catalog)
    index_s = time.perf_counter() - began
    noises, fields = (0.0, 1.0, 3.0, 6.0), (44.0, 60.0)
    answers, none = [], []
    for k in range(-1, views):
        options = SceneOptions(field_deg=fields[k % 2], sigma_px=noises[k // 2 % 4])
        scene = random_scene(catalog, options, rng, true_rims=(6, 10_000))
        answers.append((scene, identify(scene.ellipses_px, scene.camera, index)))
        if k % 10 == 0:
            none.append(identify(scene.mirrored(), scene.camera, index).seconds)
    # The first pays for what is compiled and first put together.
    del answers[0]
    ms = [1e3 * found.seconds for _, found in answers]
    return {
        "identify_ms_median": float(np.median(ms)),
        "identify_ms_p95": float(np.percentile(ms, 95.0)),
        "identify_solved": float(np.mean([right(scene, found) for scene, found in answers])),
        "identify_wrong": float(
            np.mean([found.identified and not right(scene, found) for scene, found in answers])
        ),
        "identify_no_answer_ms": 1e3 * float(np.median(none)),
        "identify_index_s": index_s,
    }


def right(scene: Scene, found: Identification) -> bool:
    """Whether an answer names the true craters: two thirds or more of what it names, three at the least."""
    if not found.identified:
        return False
    named = found.rows >= 0
    agree = found.rows[named] == scene.craters[named]
    return bool(agree.sum() >= 3 and agree.mean() > 2.0 / 3.0)


def scene_camera(field_deg: float, bTc: FloatArray | None = None) -> Camera:
    """Square camera of a field of view."""
    focal = 0.5 * SIDE_PX / np.tan(np.radians(0.5 * field_deg))
    middle = 0.5 * (SIDE_PX - 1)
    return Camera(SIDE_PX, SIDE_PX, focal, focal, middle, middle, bTc=np.eye(4) if bTc is None else bTc)


def random_scene(
    catalog: Catalog,
    options: SceneOptions,
    rng: np.random.Generator,
    *,
    true_rims: tuple[int, int] = (3, 10_000),
) -> Scene:
    """View from anywhere above the body.

    Parameters
    ----------
    catalog : Catalog
    options : SceneOptions
    rng : Generator
    true_rims : tuple of int
        Least and largest number of craters that are found; other views are passed over.
    """
    camera = scene_camera(options.field_deg)
    while True:
        gTb = _pose(catalog.body.radius_m, options, rng)
        rows, charts = _visible(catalog, camera, gTb, options.least_px)
        kept = rng.random(len(rows)) >= options.missing
        if true_rims[0] <= kept.sum() <= true_rims[1]:
            break
    rows, charts = rows[kept], charts[kept]
    ellipses = _parameters(camera, charts)
    wrong = round(len(rows) * options.false / (1.0 - options.false))
    like = rng.integers(len(rows), size=wrong)
    false = ellipses[like]
    false[:, :2] = rng.uniform(0.0, SIDE_PX - 1.0, (wrong, 2))
    false[:, 2:4] *= np.exp(rng.normal(0.0, 0.2, (wrong, 1)))
    ellipses = np.concatenate([ellipses, false])
    craters = np.concatenate([rows, np.full(wrong, -1)])
    ellipses[:, :2] += rng.normal(0.0, options.sigma_px, (len(ellipses), 2))
    spread = np.minimum(0.5 * options.sigma_px, 0.1 * ellipses[:, 2:4])
    ellipses[:, 2:4] += spread * rng.normal(size=(len(ellipses), 2))
    # An error across the axes turns a nearly round rim far.
    lean = spread.mean(axis=1) * rng.normal(size=len(ellipses)) / np.sqrt(2.0)
    a, b = ellipses[:, 2], ellipses[:, 3]
    ellipses[:, 4] += 0.5 * np.arctan2(2.0 * lean, np.abs(a - b))
    order = rng.permutation(len(ellipses))
    return Scene(camera, ellipses[order], gTb, craters[order])


def synthetic_catalog(body: Body, rng: np.random.Generator, *, count: int = 21_433) -> Catalog:
    """Uniformly scattered craters with the sizes and flattenings of the real ones of 4 km and more.

    Parameters
    ----------
    body : Body
    rng : Generator
    count : int
    """
    share = rng.random(count)
    diameter_km = np.exp(
        np.interp(np.log(share), np.log(_LARGER / _LARGER[0])[::-1], np.log(_DIAMETERS_KM)[::-1])
    )
    return _scattered(body, rng, diameter_km)


def _scattered(body: Body, rng: np.random.Generator, diameter_km: FloatArray) -> Catalog:
    n = len(diameter_km)
    flattening = np.minimum(_FLATTENING * np.exp(_FLATTENING_SPREAD * rng.normal(size=n)), 0.6)
    mean_m = 500.0 * diameter_km
    return Catalog(
        tuple(f"S{k}" for k in range(n)),
        np.arcsin(rng.uniform(-1.0, 1.0, n)),
        rng.uniform(-np.pi, np.pi, n),
        mean_m * np.exp(0.5 * flattening),
        mean_m * np.exp(-0.5 * flattening),
        rng.uniform(0.0, np.pi, n),
        np.zeros(n),
        body,
    )


def _pose(radius_m: float, options: SceneOptions, rng: np.random.Generator) -> FloatArray:
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    aside = np.cross(up, rng.normal(size=3))
    aside /= np.linalg.norm(aside)
    tilt = np.radians(rng.uniform(0.0, options.largest_tilt_deg))
    forward = -np.cos(tilt) * up + np.sin(tilt) * aside
    x = np.cross(forward, rng.normal(size=3))
    x /= np.linalg.norm(x)
    altitude = np.exp(rng.uniform(*np.log(options.altitudes_m)))
    return frames.pose(np.stack([x, np.cross(forward, x), forward], axis=-1), (radius_m + altitude) * up)


def _visible(
    catalog: Catalog, camera: Camera, gTb: FloatArray, least_px: float
) -> tuple[IntArray, FloatArray]:
    """Rows and charts of the craters in view."""
    P = gTb[:3, 3]
    above = np.linalg.norm(P)
    near = np.flatnonzero(catalog.normals @ (P / above) > catalog.body.radius_m / above)
    rows, charts = catalog.take(near).visible(camera, gTb, min_semi_minor_px=least_px)
    return near[rows], charts


def _parameters(camera: Camera, charts: FloatArray) -> FloatArray:
    centres, S = centre_and_matrix_px(charts, camera)
    values, vectors = np.linalg.eigh(S)
    angle = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
    return np.column_stack([centres, np.sqrt(values[:, 1]), np.sqrt(values[:, 0]), angle])
