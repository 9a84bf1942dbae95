"""Cost of a frame from the image to the new state, on the demo's descent."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.start import find_start
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.arrays import FloatArray

SCENARIO = "lunar_descent"
# The demo's frames are 4 s apart; fewer are rendered here.
INTERVAL_S = 12.0
# Frames with about ten rims count; the time grows with their number.
MIN_RIMS, MAX_RIMS = 7, 14
# Standard deviations of the initial state, per axis.
START_SIGMA_RAD, START_SIGMA_M = 5e-3, 200.0
# The first frames fill caches.
WARM_UP_FRAMES = 2


def pipeline_ms() -> dict[str, float]:
    """Process every third frame of the demo's descent, frame by frame.

    The time is that of prediction, guided measurement with gates and sun tilt, and the online smoother's
    update: processor time of all threads, as on one core. Reading the image and the first frame do not count.

    Returns
    -------
    dict of str to float
        `pipeline_ms`, the median over the frames with `MIN_RIMS` to `MAX_RIMS` rims; `pipeline_measure_ms`,
        the guided measurement's part of it; `pipeline_rims`, the mean number of rims in these frames.
    """
    scenario = load_scenario(SCENARIO)
    timing = scenario.trajectory.model_copy(update={"frame_interval_s": INTERVAL_S})
    with tempfile.TemporaryDirectory() as folder:
        path = simulate(scenario.model_copy(update={"trajectory": timing}), Path(folder) / "dataset")
        dataset = Dataset.open(path)
        images = [dataset.image(k) for k in range(len(dataset.stamps_ns))]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rows = _fly(dataset, images)
    finally:
        cv2.setNumThreads(threads)
    rows = rows[WARM_UP_FRAMES:]
    counted = rows[(rows[:, 2] >= MIN_RIMS) & (rows[:, 2] <= MAX_RIMS)]
    whole, measuring, _ = np.median(counted, axis=0)
    return {
        "pipeline_ms": 1e3 * float(whole),
        "pipeline_measure_ms": 1e3 * float(measuring),
        "pipeline_rims": float(np.mean(counted[:, 2])),
    }


def _fly(dataset: Dataset, images: list[ImageArray]) -> FloatArray:
    """Seconds of each frame but the first, seconds of its measurement, and its number of rims: (n, 3)."""
    truth = dataset.truth
    assert truth is not None
    assert dataset.initial is not None
    # The demo begins with a poor initial state; here it is known well, as tracking is measured.
    initial = replace(
        dataset.initial, gTb=truth.gTb[0], attitude_sigma_rad=START_SIGMA_RAD, position_sigma_m=START_SIGMA_M
    )
    descent = Descent.of(dataset, initial)
    front_end = GuidedFrontEnd(dataset.camera, dataset.catalog)
    session = OnlineSession(descent)
    rows = []
    for k, stamp in enumerate(int(s) for s in dataset.stamps_ns):
        began = time.process_time()
        predicted = filter_state.prior(descent) if k == 0 else session.predict(stamp)
        covariance = predicted.covariance[filter_state.POSE, filter_state.POSE]
        measuring = time.process_time()
        frame = front_end.measure(images[k], stamp, predicted.gTb, covariance, dataset.sun.at(stamp))
        measured = time.process_time()
        if k == 0:
            session.begin(frame, find_start(descent, [frame]))
        else:
            session.update(frame)
        rows.append((time.process_time() - began, measured - measuring, len(frame.rims)))
    return np.array(rows[1:])
