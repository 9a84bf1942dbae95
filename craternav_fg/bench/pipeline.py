"""Cost of a frame from the image to the new state, on the demo's descent."""

import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.estimators.base import Descent
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.pipeline.tracking import Tracker
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.arrays import FloatArray

SCENARIO = "lunar_descent"
# As in the scenario: between frames further apart, the IMU takes a larger part than it has in the demo.
INTERVAL_S = 4.0
# Frames with about ten rims count; the time grows with their number.
MIN_RIMS, MAX_RIMS = 7, 14
# Standard deviations of the initial state, per axis.
START_SIGMA_RAD, START_SIGMA_M = 5e-3, 200.0
# The first frames fill caches.
WARM_UP_FRAMES = 2


@dataclass(frozen=True, kw_only=True)
class _InMemory(Dataset):
    """A data set whose images have been read."""

    images: tuple[ImageArray, ...]

    def image(self, frame: int) -> ImageArray:
        """Return the image of a frame."""
        return self.images[frame]


class _Timed(GuidedFrontEnd):
    """A front end that notes how long it took, s, by the stamps of the frames."""

    def __init__(self, dataset: Dataset) -> None:
        super().__init__(dataset.camera, dataset.catalog)
        self.seconds: defaultdict[int, float] = defaultdict(float)

    def measure(
        self,
        image: ImageArray,
        stamp_ns: int,
        gTb: FloatArray,
        pose_covariance: FloatArray,
        sun_g: FloatArray,
    ) -> FrameMeasurement:
        """Measure an image as the front end does."""
        began = time.process_time()
        frame = super().measure(image, stamp_ns, gTb, pose_covariance, sun_g)
        self.seconds[stamp_ns] += time.process_time() - began
        return frame


def pipeline_ms() -> dict[str, float]:
    """Process the frames of the demo's descent, one by one.

    The time is that of the tracker: prediction, guided measurement with the sun tilt, the joint gate, pooled
    errors, and the online smoother's update. It is processor time of all threads, as on one core. Reading the
    image and the first frame do not count.

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
        images = tuple(dataset.image(k) for k in range(len(dataset.stamps_ns)))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rows = frame_costs(_InMemory(**vars(dataset), images=images))
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


def frame_costs(dataset: Dataset) -> FloatArray:
    """Track the frames of a data set from a well-known start.

    Parameters
    ----------
    dataset : Dataset
        With images, truth and an initial state.

    Returns
    -------
    ndarray, shape (n - 1, 3)
        Of each frame but the first: processor time, s, its part for the guided measurement, s, and number of
        rims.
    """
    truth = dataset.truth
    assert truth is not None
    assert dataset.initial is not None
    # The demo begins with a poor initial state; here it is known well, as tracking is measured.
    initial = replace(
        dataset.initial, gTb=truth.gTb[0], attitude_sigma_rad=START_SIGMA_RAD, position_sigma_m=START_SIGMA_M
    )
    front_end = _Timed(dataset)
    tracker = Tracker(dataset, Descent.of(dataset, initial), front_end, Relocaliser(dataset))
    done_s = []
    tracked = tracker.run(lambda *_: done_s.append(time.process_time()))
    # Told before the first frame, too.
    frames_s = np.diff(done_s)
    measured_s = [front_end.seconds[int(stamp)] for stamp in dataset.stamps_ns]
    rims = [len(frame.rims) for frame in tracked.frames]
    return np.column_stack([frames_s, measured_s, rims])[1:]
