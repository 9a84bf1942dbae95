"""Trials behind table 1 and the front end's figures: sets of rendered images, their rims found and measured.

The seeds are used nowhere else, so the images are independent of those by which the front end was set up.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.evaluation.detection import match
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.reproduce.guided_accuracy import LARGE_ERROR, USUAL_ERROR, PredictionError, measure
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED, METHODS
from craternav_fg.simulation import scenes
from craternav_fg.simulation.crests import crest_offsets_px
from craternav_fg.simulation.paper_scenes import photograph_window, single_crater
from craternav_fg.simulation.scenes import MIN_SEMI_MINOR_PX, Ground, Scene, scene
from craternav_fg.simulation.terrain import TerrainOptions
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import FoundRims, find_rims
from craternav_fg.vision.guided_options import SINGLE_IMAGE
from factors.arrays import FloatArray
from factors.kernels.sun import sun_tilt, wrap

# Sets of images. Fine and irregular outlines, and overlapping craters on rough terrain, from a tilted camera;
# a camera at nadir and 30 deg from it, for sun tilts; single craters at 4x zoom, for the rim crests.
FINE, IRREGULAR, HARD, NADIR, TILTED, CREST = "fine", "irregular", "hard", "nadir", "tilted", "crest"
# Guided measurement from a prediction with the errors `LARGE_ERROR`.
GUIDED_FAR = "guided_far"
GROUNDS = {
    FINE: Ground(),
    IRREGULAR: scenes.IRREGULAR,
    HARD: scenes.HARD,
    NADIR: Ground(tilt_deg=(0.0, 0.0), size_px=512),
    TILTED: Ground(tilt_deg=(30.0, 30.0), size_px=512),
}
DETECTORS: Mapping[str, Mapping[str, Callable[[npt.NDArray[np.uint8]], FoundRims]]] = {
    FINE: {BLIND: find_rims, CANNY: find_rims_canny},
    IRREGULAR: {BLIND: find_rims, CANNY: find_rims_canny},
    HARD: {BLIND: find_rims},
    NADIR: {},
    TILTED: {},
}
PREDICTIONS: Mapping[str, Mapping[str, PredictionError]] = {
    FINE: {GUIDED: USUAL_ERROR, GUIDED_FAR: LARGE_ERROR},
    IRREGULAR: {GUIDED: USUAL_ERROR},
    HARD: {},
    NADIR: {GUIDED: USUAL_ERROR},
    TILTED: {GUIDED: USUAL_ERROR},
}
MEASURED = (*METHODS, GUIDED_FAR)
ERRORS = ("x_px", "y_px", "semi_major_px", "semi_minor_px")

# A set has `ReproduceOptions.images` over this number of images.
_IMAGES_OVER = {FINE: 4, IRREGULAR: 8, HARD: 12, NADIR: 4, TILTED: 4, CREST: 8}
KINDS = tuple(_IMAGES_OVER)
# Seeds below belong to set-up and tests.
_FIRST_SEED = 40_000
_ZOOM = 4
_CREST_ALTITUDES_KM = (50.0, 30.0, 10.0)
# Half length of the normals along which crests are sought, px of the zoomed camera.
_CREST_REACH_PX = 2.5


@dataclass(frozen=True)
class Image:
    """An image of a set: its kind, the seed of the options and its number."""

    kind: str
    seed: int
    number: int


@dataclass(frozen=True)
class Sets:
    """Measured rims, images and crests.

    Attributes
    ----------
    rims : pyarrow.Table
        A row per rim that should be found: `set`, `image`, true `semi_minor_px`, and for each of `MEASURED`
        its `ERRORS`, measured minus true, and `chi2`; NaN where the rim was not found.
    images : pyarrow.Table
        A row per image: `set`, `image`, the number of `false` rims of each of its `DETECTORS`; error and
        standard deviation of the sun tilt, deg, NaN where none was measured.
    crests : ndarray, shape (n,)
        Offsets of the rim crests from the projected rims along their normals, px.
    """

    rims: pa.Table
    images: pa.Table
    crests: FloatArray


def run_image(image: Image) -> tuple[list[dict[str, object]], list[dict[str, object]], list[float]]:
    """Return the rows of `Sets.rims` and of `Sets.images`, and the crest offsets of one image."""
    rng = np.random.default_rng([image.seed, 5, image.number])
    if image.kind == CREST:
        return [], [], _crests(image, rng)
    one = scene(_FIRST_SEED + 1000 * image.seed + image.number, GROUNDS[image.kind])
    wanted = np.flatnonzero(one.wanted)
    place = {int(row): k for k, row in enumerate(one.craters[wanted])}
    errors = {method: np.full((len(wanted), 4), np.nan) for method in MEASURED}
    chi2 = {method: np.full(len(wanted), np.nan) for method in MEASURED}
    record: dict[str, object] = {"set": image.kind, "image": image.number}
    record |= {f"{method}_false": np.nan for method in (CANNY, BLIND)}
    record |= {"sun_deg": np.nan, "sun_sigma_deg": np.nan}
    for method, find in DETECTORS[image.kind].items():
        found = find(one.image).ellipses_px
        result = match(found, one.ellipses_px, one.wanted, found[:, 3] >= MIN_SEMI_MINOR_PX)
        record[f"{method}_false"] = float(len(result.false))
        for detected, true in zip(result.detected, result.true, strict=True):
            k = place.get(int(one.craters[true]))
            if k is not None:
                errors[method][k] = (found[detected] - one.ellipses_px[true])[:4]
    for method, prediction in PREDICTIONS[image.kind].items():
        frame, e = measure(one, SINGLE_IMAGE, prediction, rng)
        measured = [place[int(row)] for row in e.craters]
        errors[method][measured] = np.hstack([e.centre_px, e.axes_px])
        chi2[method][measured] = e.chi2
        if method == GUIDED and frame.sun is not None:
            record["sun_deg"], record["sun_sigma_deg"] = _sun_deg(one, frame)
    rims = []
    for k, row in enumerate(wanted):
        rim: dict[str, object] = {"set": image.kind, "image": image.number}
        rim["semi_minor_px"] = float(one.ellipses_px[row, 3])
        for method in MEASURED:
            rim |= {f"{method}_{name}": float(v) for name, v in zip(ERRORS, errors[method][k], strict=True)}
            rim[f"{method}_chi2"] = float(chi2[method][k])
        rims.append(rim)
    return rims, [record], []


def _sun_deg(one: Scene, frame: FrameMeasurement) -> tuple[float, float]:
    """Error, at the true pose, and standard deviation of a measured sun tilt."""
    sun = frame.sun
    assert sun is not None
    true, _ = sun_tilt(one.gTb, one.camera.bTc, sun.direction, sun.point[0], sun.point[1], np.empty((1, 6)))
    return float(np.degrees(wrap(sun.tilt_rad - true))), float(np.degrees(sun.sigma_rad))


def _crests(image: Image, rng: np.random.Generator) -> list[float]:
    altitude_m = 1e3 * _CREST_ALTITUDES_KM[image.number % len(_CREST_ALTITUDES_KM)]
    view = single_crater(rng, altitude_m, int(rng.integers(2**31)))
    _, fine = photograph_window(view, rng, TerrainOptions(cells=1024), _ZOOM)
    offsets = crest_offsets_px(
        fine, view.catalog, view.gTb, np.zeros(1, dtype=np.int64), reach_px=_CREST_REACH_PX
    )
    return [float(px) for px in offsets.ravel() / _ZOOM]


def counts(options: ReproduceOptions) -> dict[str, int]:
    """Return the number of images of each set."""
    return {kind: max(options.images // over, 1) for kind, over in _IMAGES_OVER.items()}


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
    rims, records, crests = ([row for result in results for row in result[k]] for k in range(3))
    return Sets(pa.Table.from_pylist(rims), pa.Table.from_pylist(records), np.array(crests, dtype=np.float64))
