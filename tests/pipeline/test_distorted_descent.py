"""Rendered descents through a lens that distorts, reconstructed beside the same ones without."""

from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario, load_scenario

# Of a wide lens: the corners move by a tenth of their distance from the middle.
LENS = (-0.30, 0.08, 0.0012, -0.0008, 0.0)


def short() -> Scenario:
    """Five frames at the end of the demo's descent, with a smaller image."""
    demo = load_scenario("lunar_descent")
    start = demo.trajectory.start.model_copy(
        update={
            "altitude_m": 5e3,
            "downrange_m": -1300.0,
            "vertical_speed_m_s": -60.0,
            "ground_speed_m_s": 100.0,
        }
    )
    trajectory = demo.trajectory.model_copy(update={"start": start, "duration_s": 16.0})
    camera = demo.camera.model_copy(update={"width_px": 448, "height_px": 448})
    craters = demo.craters.model_copy(
        update={"min_apparent_px": 16.0, "max_apparent_px": 150.0, "density": 0.03}
    )
    error = demo.initial_error.model_copy(update={"position_m": 1000.0})
    parts = {"trajectory": trajectory, "camera": camera, "craters": craters, "initial_error": error}
    return demo.model_copy(update=parts)


def reconstructed(folder: Path, case: Scenario) -> tuple[float, int]:
    """Position error of the smoother, rms, m, and how many rims it had."""
    data = Dataset.open(simulate(case, folder))
    assert data.truth is not None
    result = reconstruct(data, ["smoother"])
    off_m = np.linalg.norm(result.trajectories["smoother"].gP - data.truth.gP, axis=1)
    return float(np.sqrt(np.mean(off_m**2))), sum(len(frame.rims) for frame in result.frames)


def compare(folder: Path, case: Scenario) -> None:
    bent = case.model_copy(update={"camera": case.camera.model_copy(update={"distortion": LENS})})
    straight_m, straight_rims = reconstructed(folder / "straight", case)
    bent_m, bent_rims = reconstructed(folder / "bent", bent)
    assert bent_rims >= 0.9 * straight_rims >= 25
    assert bent_m < 1.5 * straight_m + 1.0


def test_a_descent_through_a_lens_that_distorts(tmp_path: Path) -> None:
    compare(tmp_path, short())


@pytest.mark.slow
def test_the_demo_through_a_lens_that_distorts(tmp_path: Path) -> None:
    compare(tmp_path, load_scenario("lunar_descent"))
