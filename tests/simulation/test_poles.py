"""Descents to the poles, where longitudes turn over."""

from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario


@pytest.mark.parametrize("latitude_deg", [-90.0, pytest.param(89.95, marks=pytest.mark.slow)])
def test_a_descent_to_a_pole_is_reconstructed_as_well_as_any(tmp_path: Path, latitude_deg: float) -> None:
    case = load_scenario("measured_descent")
    trajectory = case.trajectory.model_copy(update={"site_latitude_deg": latitude_deg})
    data = Dataset.open(simulate(case.model_copy(update={"trajectory": trajectory}), tmp_path / "data"))
    assert data.truth is not None
    # Craters lie on all sides of the pole.
    near = data.catalog.longitude_rad[np.abs(data.catalog.latitude_rad) > np.radians(89.5)]
    assert np.ptp(near) > np.radians(180.0)
    elsewhere = case.expected["smoother"]
    for name, estimate in reconstruct(data, ("smoother", "online", "ekf")).trajectories.items():
        assert estimate.pose_covariance is not None
        error = errors(estimate, data.truth)
        mean = nees(error.pose, estimate.pose_covariance).mean()
        assert abs(mean - elsewhere.anees.mean) < 3.0 * elsewhere.anees.sd
        if name == "smoother":
            rms_m = np.sqrt(np.mean(np.sum(error.position_m**2, axis=1)))
            assert rms_m < elsewhere.position_rms_m.mean + 3.0 * elsewhere.position_rms_m.sd
