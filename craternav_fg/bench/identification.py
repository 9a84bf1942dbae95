"""Cost and success of identifying craters with position and attitude unknown."""

import time

import numpy as np

from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.catalog_views import View, ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON

# Noise of the rims' centres, and fields of view, from the narrow to the wide.
NOISES_PX = (0.0, 1.0, 3.0, 6.0)
FIELDS_DEG = (44.0, 60.0)
# Views with fewer true craters are not timed.
MIN_TRUE_RIMS = 6
# False rims as detectors find them, larger than most craters: their radii, px, and their share.
LARGE_PX, LARGE_SHARE = (20.0, 50.0), 0.5
# Every tenth view is also tried mirrored, where no answer is right.
MIRRORED_EVERY = 10


def identify_scalars(views: int = 100) -> dict[str, float]:
    """Measure identification on one core, position and attitude unknown, six true craters or more.

    Parameters
    ----------
    views : int
        At 100 to 600 km, of 44 and 60 deg, with noise of 0, 1, 3 and 6 px, of a synthetic catalogue.

    Returns
    -------
    dict of str to float
        `identify_ms_median`, `identify_ms_p95`; `identify_solved` and `identify_wrong`, shares of the views;
        `identify_no_answer_ms`, the median of mirrored views; `identify_index_s`;
        `identify_large_false_ms`, `identify_large_false_solved` and `identify_large_false_wrong`, the same of
        views half of whose rims are false and large, with noise of 1 px.
    """
    rng = np.random.default_rng(7)
    # Compiles.
    TripleIndex.build(synthetic_catalog(MOON, rng, count=500))
    catalog = synthetic_catalog(MOON, rng)
    began = time.perf_counter()
    index = TripleIndex.build(catalog)
    index_s = time.perf_counter() - began
    answers, mirrored_s = [], []
    for k in range(-1, views):
        options = ViewOptions(field_deg=FIELDS_DEG[k % 2], sigma_px=NOISES_PX[k // 2 % 4])
        view, *answer = _answer(index, options, rng)
        answers.append(answer)
        if k % MIRRORED_EVERY == 0:
            mirrored_s.append(identify(view.mirrored(), view.camera, index).seconds)
    # The first view pays for compilation and for caches.
    seconds, identified, right = np.array(answers[1:]).T
    large = []
    for k in range(views):
        options = ViewOptions(field_deg=FIELDS_DEG[k % 2], false=LARGE_SHARE, false_radius_px=LARGE_PX)
        large.append(_answer(index, options, rng)[1:])
    large_seconds, large_identified, large_right = np.array(large).T
    return {
        "identify_ms_median": 1e3 * float(np.median(seconds)),
        "identify_ms_p95": 1e3 * float(np.percentile(seconds, 95.0)),
        "identify_solved": float(np.mean(right)),
        "identify_wrong": float(np.mean(identified - right)),
        "identify_no_answer_ms": 1e3 * float(np.median(mirrored_s)),
        "identify_large_false_ms": 1e3 * float(np.median(large_seconds)),
        "identify_large_false_solved": float(np.mean(large_right)),
        "identify_large_false_wrong": float(np.mean(large_identified - large_right)),
        "identify_index_s": index_s,
    }


def _answer(
    index: TripleIndex, options: ViewOptions, rng: np.random.Generator
) -> tuple[View, float, bool, bool]:
    """Draw and identify a view: the view, seconds, whether there is an answer, and whether a right one."""
    view = random_view(index.catalog, options, rng, true_rims=(MIN_TRUE_RIMS, 10_000))
    found = identify(view.ellipses_px, view.camera, index)
    return view, found.seconds, found.identified, found.identified and view.agrees(found.rows)
