"""Sets of rendered images whose rims are known, and what the front end makes of them.

Behind table 1 and the figures that the front end must hold. Their seeds are used nowhere else.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.evaluation.detection import match
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.reproduce.guided_accuracy import FAR, NEAR, Prior, measure
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED, METHODS
from craternav_fg.simulation.crests import crest_offsets_px
from craternav_fg.simulation.paper_scenes import photograph_window, single_crater
from craternav_fg.simulation.scenes import HARD, IRREGULAR, MIN_SEMI_MINOR_PX, Ground, Scene, scene
from craternav_fg.simulation.terrain import TerrainOptions
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import FoundRims, find_rims
from craternav_fg.vision.guided_options import SINGLE_IMAGE
from factors.kernels.sun import sun_tilt, wrap

FloatArray = npt.NDArray[np.float64]

FINE, ROUGH, CUT, NADIR, TILTED, CREST = "fine", "irregular", "hard", "nadir", "tilted", "crest"
# From a prediction that is far off.
LOST = "lost"
GROUNDS = {
    FINE: Ground(),
    ROUGH: IRREGULAR,
    CUT: HARD,
    NADIR: Ground(tilt_deg=(0.0, 0.0), size_px=512),
    TILTED: Ground(tilt_deg=(30.0, 30.0), size_px=512),
}
# How each set is measured.
BLIND_METHODS: Mapping[str, Mapping[str, Callable[[npt.NDArray[np.uint8]], FoundRims]]] = {
    FINE: {BLIND: find_rims, CANNY: find_rims_canny},
    ROUGH: {BLIND: find_rims, CANNY: find_rims_canny},
    CUT: {BLIND: find_rims},
    NADIR: {},
    TILTED: {},
}
PRIORS: Mapping[str, Mapping[str, Prior]] = {
    FINE: {GUIDED: NEAR, LOST: FAR},
    ROUGH: {GUIDED: NEAR},
    CUT: {},
    NADIR: {GUIDED: NEAR},
    TILTED: {GUIDED: NEAR},
}
MEASURED = (*METHODS, LOST)
ERRORS = ("x_px", "y_px", "semi_major_px", "semi_minor_px")

# Images of each set, of so many of `ReproduceOptions.images`.
_SHARES = {FINE: 4, ROUGH: 8, CUT: 12, NADIR: 4, TILTED: 4, CREST: 8}
KINDS = tuple(_SHARES)
# Far from the seeds by which the front end was set up and is tested.
_FIRST_SEED = 40_000
_ZOOM = 4
_CREST_KM = (50.0, 30.0, 10.0)


@dataclass(frozen=True)
class Image:
    """An image of a set, by its number."""

    kind: str
    seed: int
    number: int


@dataclass(frozen=True)
class Sets:
    """What was measured.

    Attributes
    ----------
    rims : pyarrow.Table
        A row per rim that must be found: `set`, `image`, true `semi_minor_px`, and for each of `MEASURED` its
        `ERRORS`, measured minus true, and `chi2`; NaN where the rim was not found.
    images : pyarrow.Table
        A row per image: `set`, `image`, for each way of `BLIND_METHODS` the rims that are `false`; error and
        standard deviation of the sun's tilt, deg, NaN where the image has none to tell.
    crests : ndarray, shape (n,)
        Offsets of crests from the projected rims, px, along normals all round.
    """

    rims: pa.Table
    images: pa.Table
    crests: FloatArray


def run_image(image: Image) -> tuple[list[dict[str, object]], list[dict[str, object]], list[float]]:
    """Rows of `Sets.rims`, of `Sets.images`, and crests of one image."""
    rng = np.random.default_rng([image.seed, 5, image.number])
    if image.kind == CREST:
        return [], [], _crests(image, rng)
    one = scene(_FIRST_SEED + 1000 * image.seed + image.number, GROUNDS[image.kind])
    wanted = np.flatnonzero(one.wanted)
    place = {int(row): k for k, row in enumerate(one.craters[wanted])}
    errors = {way: np.full((len(wanted), 4), np.nan) for way in MEASURED}
    chi2 = {way: np.full(len(wanted), np.nan) for way in MEASURED}
    tells: dict[str, object] = {"set": image.kind, "image": image.number}
    tells |= {f"{way}_false": np.nan for way in (CANNY, BLIND)} | {"sun_deg": np.nan, "sun_sigma_deg": np.nan}
    for way, find in BLIND_METHODS[image.kind].items():
        found = find(one.image).ellipses_px
        result = match(found, one.ellipses_px, one.wanted, found[:, 3] >= MIN_SEMI_MINOR_PX)
        tells[f"{way}_false"] = float(len(result.false))
        for detected, true in zip(result.detected, result.true, strict=True):
            k = place.get(int(one.craters[true]))
            if k is not None:
                errors[way][k] = (found[detected] - one.ellipses_px[true])[:4]
    for way, prior in PRIORS[image.kind].items():
        frame, e = measure(one, SINGLE_IMAGE, prior, rng)
        measured = [k for row in frame.rims.craters if (k := place.get(int(row))) is not None]
        errors[way][measured] = np.hstack([e.centre_px, e.axes_px])
        chi2[way][measured] = e.chi2
        if way == GUIDED and frame.sun is not None:
            tells["sun_deg"], tells["sun_sigma_deg"] = _sun_deg(one, frame)
    rims = []
    for k, row in enumerate(wanted):
        rim: dict[str, object] = {"set": image.kind, "image": image.number}
        rim["semi_minor_px"] = float(one.ellipses_px[row, 3])
        for way in MEASURED:
            rim |= {f"{way}_{name}": float(v) for name, v in zip(ERRORS, errors[way][k], strict=True)}
            rim[f"{way}_chi2"] = float(chi2[way][k])
        rims.append(rim)
    return rims, [tells], []


def _sun_deg(one: Scene, frame: FrameMeasurement) -> tuple[float, float]:
    """Error and standard deviation of a measured tilt, against the true pose."""
    sun = frame.sun
    assert sun is not None
    true, _ = sun_tilt(one.gTb, one.camera.bTc, sun.direction, sun.point[0], sun.point[1], np.empty((1, 6)))
    return float(np.degrees(wrap(sun.tilt_rad - true))), float(np.degrees(sun.sigma_rad))


def _crests(image: Image, rng: np.random.Generator) -> list[float]:
    altitude_m = 1e3 * _CREST_KM[image.number % len(_CREST_KM)]
    view = single_crater(rng, altitude_m, int(rng.integers(2**31)))
    _, fine = photograph_window(view, rng, TerrainOptions(cells=1024), _ZOOM)
    offsets = crest_offsets_px(fine, view.catalog, view.gTb, np.zeros(1, dtype=np.int64), reach_px=2.5)
    return [float(px) for px in offsets.ravel() / _ZOOM]


def counts(options: ReproduceOptions) -> dict[str, int]:
    """Images of each set."""
    return {kind: max(options.images // share, 1) for kind, share in _SHARES.items()}


def simulate(
    options: ReproduceOptions, kinds: tuple[str, ...] = KINDS, progress: Progress | None = None
) -> Sets:
    """Render and measure some of the sets."""
    images = [
        Image(kind, options.seed, 100 * k + number)
        for k, (kind, count) in enumerate(counts(options).items())
        for number in range(count)
        if kind in kinds
    ]
    results = run_all(run_image, images, options.workers, "images of the front end", progress)
    rims, tells, crests = ([row for result in results for row in result[k]] for k in range(3))
    return Sets(pa.Table.from_pylist(rims), pa.Table.from_pylist(tells), np.array(crests, dtype=np.float64))
