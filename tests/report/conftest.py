"""A short run with overlays of its frames, as a reader of a report has it."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.runs.execute import execute_run
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario

ESTIMATORS = ("smoother", "ekf", "ekf_paper", "dead_reckoning")


@pytest.fixture(scope="session")
def made_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run; tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("report") / "run"
    folder.mkdir()
    data = simulate(scenario(duration_s=10.0), folder / "dataset")
    execute_run(Dataset.open(data), folder, ESTIMATORS, label="dataset", began_s=time.perf_counter())
    (folder / "overlays").mkdir()
    for number in range(3):
        picture = np.full((40, 1400, 3), 60 * number, np.uint8)
        cv2.imwrite(str(folder / "overlays" / f"frame_{number:04d}.png"), picture)
    return folder
