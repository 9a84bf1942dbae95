"""Errors, detection rates and consistency of the front end in rendered images with known truth."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.reproduce import image_plots, table1_trials
from craternav_fg.reproduce.guided_accuracy import SMALL_PX
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import Reproduction, Row, known
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED, image_row, judged
from craternav_fg.reproduce.table1 import DETECTION_RATE, TABLE1, errors_px, share_found
from craternav_fg.reproduce.table1_trials import (
    FINE,
    GUIDED_FAR,
    HARD,
    IRREGULAR,
    NADIR,
    TILTED,
    Sets,
)
from craternav_fg.simulation.empty_images import gradient_images, noise_images
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import find_rims
from factors.arrays import FloatArray

# A rim is recovered from a wrong prediction when its centre and axes are within this.
RECOVERED_PX = 2.0
# Degrees of freedom of a rim.
_DOF = 5.0
# A sun tilt with a larger error points to the wrong side.
_REVERSED_DEG = 90.0
_EMPTY_SEED = 77
_AXES = ("centre", "semi-major", "semi-minor")


def front_end(measured: Sets, options: ReproduceOptions) -> Reproduction:
    """Measure the front end in rendered images; the paper's numbers, where there are any, stand beside.

    Parameters
    ----------
    measured : Sets
        All kinds of sets.
    options : ReproduceOptions

    Returns
    -------
    Reproduction
    """
    rows = [
        *_crest_rows(measured.crests),
        *_guided_rows(measured.rims, FINE),
        *_guided_rows(measured.rims, IRREGULAR),
        _recovered_row(measured.rims),
        *_blind_rows(measured, FINE, "plain terrain"),
        *_blind_rows(measured, HARD, "hard terrain"),
        *_sun_rows(measured.images),
        *_empty_rows(),
    ]
    counted = ", ".join(f"{n} {kind}" for kind, n in table1_trials.counts(options).items())
    note = (
        f"Rendered images with seeds of their own ({counted}; 512 px for the sun tilt, else 1024) of the "
        "Moon from 50 km, rims with a semi-minor axis of at least 12 px and a slope contrast above 0.5. Hard "
        "terrain is rough and its craters overlap. As printed: Canny edges, the paper's method; corrected: "
        "the blind detector; efficient: measured from a predicted pose with errors of 1.5 px and 0.1 % of "
        "the range. The paper's numbers are of other images. The images contain neither albedo variations "
        "nor map errors, and their reflectance is nearly the one that the front end assumes."
    )
    return Reproduction(
        "front_end",
        "Front end in rendered images: errors, detection rates, consistency",
        rows,
        note,
        image_plots.draw_rows(rows),
        pa.Table.from_pylist([row.as_dict() for row in rows]),
    )


def _row(
    quantity: str,
    condition: str,
    unit: str,
    values: Mapping[str, float],
    paper: float | None = None,
) -> Row:
    """Row of numbers by method; NaN of what no image shows becomes None."""
    finite = {method: known(value) for method, value in values.items()}
    ours = finite.get(GUIDED, finite.get(BLIND))
    verdict = judged(paper, finite.get(CANNY), ours)
    return image_row("front_end", quantity, condition, unit, finite, verdict=verdict, paper=paper)


def _crest_rows(crests: FloatArray) -> list[Row]:
    offsets = crests[np.isfinite(crests)]
    quantity = "rim crest against projected rim, 4x zoom"
    return [
        _row(quantity, "absolute mean", "px", {GUIDED: abs(_mean(offsets))}),
        _row(quantity, "mean absolute", "px", {GUIDED: _mean(np.abs(offsets))}),
    ]


def _guided_rows(rims: pa.Table, kind: str) -> list[Row]:
    errors = errors_px(rims, kind, GUIDED)
    here = np.array(rims["set"].to_pylist()) == kind
    quantity = f"guided, {kind} rims"
    rows = [
        _row(quantity, f"{name}, mean absolute", "px", {GUIDED: _mean(values)})
        for name, values in zip(_AXES, errors, strict=True)
    ]
    if kind == FINE:
        small = here & (rims["semi_minor_px"].to_numpy() < SMALL_PX)
        for name in ("semi_major_px", "semi_minor_px"):
            signed = rims[f"{GUIDED}_{name}"].to_numpy()[small]
            what = f"{name[:-3].replace('_', '-')}, absolute mean, below {SMALL_PX:g} px"
            rows.append(_row(quantity, what, "px", {GUIDED: abs(_mean(signed[np.isfinite(signed)]))}))
        rows.append(_row(quantity, "measured", "1", {GUIDED: share_found(rims, (kind,), GUIDED)}))
    chi2 = rims[f"{GUIDED}_chi2"].to_numpy()[here]
    rows.append(_row(quantity, "chi-square / 5", "1", {GUIDED: _mean(chi2[np.isfinite(chi2)]) / _DOF}))
    return rows


def _recovered_row(rims: pa.Table) -> Row:
    here = np.array(rims["set"].to_pylist()) == FINE
    errors = np.abs([rims[f"{GUIDED_FAR}_{name}"].to_numpy()[here] for name in table1_trials.ERRORS])
    good = np.all(errors < RECOVERED_PX, axis=0)
    return _row("prediction wrong by 30 px and 3 %", "recovered", "1", {GUIDED: _mean(good)})


def _blind_rows(measured: Sets, kind: str, name: str) -> list[Row]:
    quantity = f"blind, {name}"
    # Only plain terrain is comparable with the paper's images, and only there Canny edges are tried.
    plain = kind == FINE
    methods = (CANNY, BLIND) if plain else (BLIND,)
    recall = {method: share_found(measured.rims, (kind,), method) for method in methods}
    precision = {method: _precision(measured, kind, method) for method in methods}
    rows = [
        _row(quantity, "recall", "1", recall, DETECTION_RATE if plain else None),
        _row(quantity, "precision", "1", precision),
    ]
    if plain:
        errors = {method: errors_px(measured.rims, kind, method) for method in methods}
        for k, (what, (printed, _)) in enumerate(zip(_AXES, TABLE1[FINE], strict=True)):
            values = {method: _mean(e[k]) for method, e in errors.items()}
            rows.append(_row(quantity, f"{what}, mean absolute", "px", values, printed))
    return rows


def _precision(measured: Sets, kind: str, method: str) -> float:
    hits = errors_px(measured.rims, kind, method).shape[1]
    here = np.array(measured.images["set"].to_pylist()) == kind
    false = np.nansum(measured.images[f"{method}_false"].to_numpy()[here])
    return float(hits / max(hits + false, 1.0))


def _sun_rows(images: pa.Table) -> list[Row]:
    kinds = np.array(images["set"].to_pylist())
    error = images["sun_deg"].to_numpy()
    told = np.isfinite(error) & np.isin(kinds, (NADIR, TILTED))
    reversed_ = float(np.sum(np.abs(error[told]) > _REVERSED_DEG)) if told.any() else np.nan
    rows = [_row("sun tilt", f"reversed, of {told.sum()} frames", "1", {GUIDED: reversed_})]
    for kind, name in ((NADIR, "at nadir"), (TILTED, "30 deg off nadir")):
        values = error[told & (kinds == kind)]
        rows.append(_row("sun tilt", f"RMS error, {name}", "deg", {GUIDED: float(np.sqrt(_mean(values**2)))}))
        share = len(values) / max(np.sum(kinds == kind), 1)
        rows.append(_row("sun tilt", f"share of frames with a tilt, {name}", "1", {GUIDED: share}))
    return rows


def _empty_rows() -> list[Row]:
    rows = []
    for k, (name, make) in enumerate((("noise", noise_images), ("gradient", gradient_images))):
        images = list(make(np.random.default_rng([_EMPTY_SEED, k])))
        found = {
            method: float(sum(len(find(image)) for image in images))
            for method, find in ((CANNY, find_rims_canny), (BLIND, find_rims))
        }
        rows.append(_row("images without craters", f"rims in {len(images)} {name} images", "1", found))
    return rows


def _mean(values: FloatArray | npt.NDArray[np.bool_]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
