"""What a frame costs from the image to the new state, on the demo's descent."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.online import OnlineSession
from craternav_fg.estimators.start import find_start
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided import GuidedFrontEnd

FloatArray = npt.NDArray[np.float64]

SCENARIO = "lunar_descent"
# The demo's frames are 4 s apart; fewer are rendered here.
INTERVAL_S = 12.0
# Frames with other numbers of rims do not count as those with ten.
FEWEST, MOST = 7, 14
# Of the start, a standard deviation per axis.
START_RAD, START_M = 5e-3, 200.0


def pipeline_ms() -> dict[str, float]:
    """Fly the demo's descent, every third frame of it, frame by frame.

    Prediction, guided measurement with gates and sun tilt, and the online smoother's update, in processor
    time of all threads: one core would take as long. Reading the image and the first frame do not count.

    Returns
    -------
    dict
        `pipeline_ms`, the median over the frames with `FEWEST` to `MOST` rims; `pipeline_measure_ms`, the
        guided measurement's part of it; `pipeline_rims`, the mean number of rims in these frames.
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
    # The first ones warm up caches.
    counted = rows[2:][(rows[2:, 2] >= FEWEST) & (rows[2:, 2] <= MOST)]
    whole, measuring, _ = np.median(counted, axis=0)
    return {
        "pipeline_ms": 1e3 * float(whole),
        "pipeline_measure_ms": 1e3 * float(measuring),
        "pipeline_rims": float(np.mean(counted[:, 2])),
    }


def _fly(dataset: Dataset, images: list[ImageArray]) -> FloatArray:
    """Seconds of each frame but the first, of its measurement, and its rims: (n, 3)."""
    truth = dataset.truth
    assert truth is not None
    assert dataset.initial is not None
    # The demo's poor start is another matter: here it is known well.
    initial = replace(
        dataset.initial, gTb=truth.gTb[0], attitude_sigma_rad=START_RAD, position_sigma_m=START_M
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
