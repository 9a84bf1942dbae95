"""Offsets from a-priori states, and leaving frames out."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.offsets import leave_one_out, offsets
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.trajectory import InitialState, Trajectory


def test_offsets_are_along_east_north_and_up_of_the_reference():
    R = 1.8e6
    places = frames.up(np.array([0.3, -0.2]), np.array([1.0, 2.0]))
    enu = frames.east_north_up(np.array([0.3, -0.2]), np.array([1.0, 2.0]))
    stamps = np.array([0, 1])
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = R * places
    reference = Trajectory(stamps, poses, np.zeros((2, 3)), np.zeros((2, 6)))
    moved = poses.copy()
    moved[:, :3, 3] += np.einsum("kij,j->ki", enu, [100.0, -200.0, 300.0])
    moved[1, :3, :3] = frames.rotation_exp([0.0, 0.01, 0.0])
    covariance = np.zeros((2, 6, 6))
    covariance[:, 3:, 3:] = enu @ np.diag([1.0, 4.0, 9.0]) @ np.swapaxes(enu, 1, 2)
    covariance[:, :3, :3] = np.eye(3)
    estimate = Trajectory(stamps, moved, np.zeros((2, 3)), np.zeros((2, 6)), covariance)
    found = offsets(estimate, reference)
    np.testing.assert_allclose(found.enu_m, [[100.0, -200.0, 300.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(found.sigma_m, [[1.0, 2.0, 3.0]] * 2)
    np.testing.assert_allclose(found.attitude_rad, [[0, 0, 0], [0.0, 0.01, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found.scatter_m, 0.0, atol=1e-6)
    with pytest.raises(EstimationError, match="same stamps"):
        offsets(estimate, replace(reference, stamps_ns=np.array([0, 2])))
    with pytest.raises(EstimationError, match="covariances"):
        offsets(reference, reference)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eight frames of a coasting orbiter."""
    case = load_scenario("orbit_coast")
    short = case.trajectory.model_copy(update={"duration_s": 140.0})
    folder = tmp_path_factory.mktemp("coast") / "data"
    return Dataset.open(simulate(case.model_copy(update={"trajectory": short}), folder, trial=0))


def test_frames_are_predicted_from_the_others(data: Dataset):
    problem = make_problem(Descent.of(data), data.measurements)
    found = leave_one_out([problem], BatchSmoother(), data.stamps_ns)
    assert found.frames.tolist() == list(range(8))
    ratio2 = (found.enu_m / found.sigma_m) ** 2
    assert 0.2 < ratio2.mean() < 2.5
    # A frame with the rims of the next one is off by the way of 20 s.
    frame = data.measurements[4]
    spoiled = list(problem.frames)
    spoiled[4] = replace(data.measurements[5], stamp_ns=frame.stamp_ns)
    worse = leave_one_out([replace(problem, frames=spoiled)], BatchSmoother(), data.stamps_ns)
    assert np.abs(worse.enu_m / worse.sigma_m)[4].max() > 10.0
    few = [replace(frame, rims=frame.rims.take(np.arange(5))) for frame in problem.frames]
    with pytest.raises(EstimationError, match="no frame has 6 rims"):
        leave_one_out([replace(problem, frames=few)], BatchSmoother(), data.stamps_ns)


def test_frames_of_every_segment_are_left_out(data: Dataset):
    """Before, those of the last segment alone, with indices in its problem in place of the data set's."""
    descent = Descent.of(data)
    # An epoch at which another sensor measured, and a last segment of a single frame.
    epoch = FrameMeasurement(data.measurements[2].stamp_ns, RimSet.empty(), None)
    parts = [
        [*data.measurements[:2], epoch, data.measurements[3]],
        data.measurements[4:7],
        data.measurements[7:],
    ]
    problems = [
        make_problem(replace(descent, initial=initial_at(data, part[0].stamp_ns)), part) for part in parts
    ]
    found = leave_one_out(problems, BatchSmoother(), np.delete(data.stamps_ns, 2))
    assert found.frames.tolist() == [0, 1, 2, 3, 4, 5]
    assert 0.2 < np.mean((found.enu_m / found.sigma_m) ** 2) < 2.5


def initial_at(data: Dataset, stamp_ns: int) -> InitialState:
    """Return the prior of a segment: the truth at its first frame, with the data set's sigmas."""
    assert data.initial is not None
    assert data.truth is not None
    k = data.stamps_ns.tolist().index(stamp_ns)
    return replace(data.initial, stamp_ns=stamp_ns, gTb=data.truth.gTb[k], gV=data.truth.gV[k])
