"""Trials behind table 2: errors of the conic coefficients A to F of single rims in rendered images."""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from craternav_fg.ellipse import axes_of_chart, normalised_chart, pixel_chart
from craternav_fg.evaluation.detection import match
from craternav_fg.reproduce.canny_rim import canny_rim
from craternav_fg.reproduce.guided_accuracy import USUAL_ERROR, measure
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED
from craternav_fg.simulation.paper_scenes import photograph_window, single_crater
from craternav_fg.simulation.scenes import Scene
from craternav_fg.simulation.terrain import TerrainOptions
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.guided_options import SINGLE_IMAGE
from factors.arrays import FloatArray
from factors.kernels.conic import chart_to_conic, project_rims

ALTITUDES_KM = (50, 40, 30, 20, 10)
COEFFICIENTS = "ABCDEF"
# Suffix of a column: the same rim moved to the optical axis.
CENTRAL = "_central"

# Images of a task for a process.
_BATCH = 8
# Windows are smaller than whole images: finer grids reach as far as they.
_TERRAIN = TerrainOptions(cells=1024)


@dataclass(frozen=True)
class Batch:
    """Images first to last - 1 from one altitude."""

    altitude_km: int
    seed: int
    first: int
    last: int


def run_batch(batch: Batch) -> list[dict[str, float]]:
    """Return the errors of every method in every image of a batch; NaN where it finds no rim."""
    return [_run_image(batch, image) for image in range(batch.first, batch.last)]


def _run_image(batch: Batch, image: int) -> dict[str, float]:
    rng = np.random.default_rng([batch.seed, 2, batch.altitude_km, image])
    view = single_crater(rng, 1e3 * batch.altitude_km, int(rng.integers(2**31)))
    one, _ = photograph_window(view, rng, _TERRAIN)
    true = project_rims(one.gTb, one.camera.bTc, view.catalog.centres, view.catalog.axes)[0]
    true_px = pixel_chart(true, one.camera)
    ellipse = axes_of_chart(true_px)[0]
    record = {
        "altitude_km": float(batch.altitude_km), "image": float(image),
        "slope_contrast": float(one.slope_contrast[0]),
        "semi_major_px": float(ellipse[2]), "semi_minor_px": float(ellipse[3]),
    }  # fmt: skip
    found = {CANNY: canny_rim(one, 0), BLIND: _blind(one, ellipse), GUIDED: _guided(one, rng)}
    for method, chart_px in found.items():
        error, central, difference = np.full(6, np.nan), np.full(6, np.nan), np.full(5, np.nan)
        # An ellipse further off follows other edges than this rim.
        if chart_px is not None and len(match(axes_of_chart(chart_px[None]), ellipse[None]).true):
            chart, _ = normalised_chart(chart_px, one.camera)
            error = chart_to_conic(chart) - chart_to_conic(true[0])
            to_axis = np.append(true[0, :2], np.zeros(3))
            central = chart_to_conic(chart - to_axis) - chart_to_conic(true[0] - to_axis)
            difference = axes_of_chart(chart_px[None])[0] - ellipse
        for name, e, e0 in zip(COEFFICIENTS, error, central, strict=True):
            record |= {f"{method}_{name}": float(e), f"{method}_{name}{CENTRAL}": float(e0)}
        record[f"{method}_centre_px"] = float(np.hypot(*difference[:2]))
        record[f"{method}_semi_major_px"], record[f"{method}_semi_minor_px"] = map(float, difference[2:4])
    return record


def _blind(one: Scene, ellipse: FloatArray) -> FloatArray | None:
    """Chart (5,), px, that the blind detector finds for the true rim."""
    # A whole image has many craters that give the direction towards the sun; a window has one.
    rims = find_rims(one.image, one.sun_angle_rad)
    if rims.sun_contradicted:
        # Small features around a lone crater can contradict the given direction.
        return None
    hit = match(rims.ellipses_px, ellipse[None]).detected
    return rims.charts_px[hit[0]] if len(hit) else None


def _guided(one: Scene, rng: np.random.Generator) -> FloatArray | None:
    frame, _ = measure(one, SINGLE_IMAGE, USUAL_ERROR, rng)
    return pixel_chart(frame.rims.chart, one.camera)[0] if len(frame.rims) else None


def simulate(options: ReproduceOptions, progress: Progress | None = None) -> pa.Table:
    """Run the trials of table 2.

    Returns
    -------
    pyarrow.Table
        A row per image.
    """
    batches = [
        Batch(km, options.seed, first, min(first + _BATCH, options.images))
        for km in ALTITUDES_KM
        for first in range(0, options.images, _BATCH)
    ]
    results = run_all(run_batch, batches, options.workers, "rims of table 2", progress)
    return pa.Table.from_pylist([record for result in results for record in result])
