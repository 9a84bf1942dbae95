"""Orbits without an IMU: the scenario, its truth, and estimators that reach their bound on it."""

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.estimators.base import Descent
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import built_in_scenarios, load_scenario


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return Dataset.open(simulate("orbit_coast", tmp_path_factory.mktemp("orbit") / "data", trial=1))


def test_the_truth_is_an_orbit_that_its_noise_disturbs(data):
    assert data.imu is None
    assert len(data) == 40
    truth = data.truth
    spin = np.array(data.body.spin_rad_s)
    inertial = truth.gV + np.cross(spin, truth.gP)
    # Energy and angular momentum of free fall, but for 1e-4 m/s^2/sqrt(Hz) over 780 s: 3 mm/s.
    energy = 0.5 * np.sum(inertial**2, axis=1) - data.body.mu_m3_s2 / np.linalg.norm(truth.gP, axis=1)
    assert np.ptp(energy) / (1633.0 * 3e-3) < 5.0
    assert np.ptp(energy) > 0.0
    altitude = data.body.altitude_m(truth.gP)
    assert np.all(np.abs(altitude - 100e3) < 3e3)
    # The camera keeps its nadir to some degrees.
    down = -truth.gP / np.linalg.norm(truth.gP, axis=1, keepdims=True)
    assert np.all(np.sum(truth.gRb[:, :, 2] * down, axis=1) > np.cos(np.radians(5.0)))


def test_estimators_are_consistent_without_an_imu(data):
    names = ["smoother", "online", "ekf", "fixed_lag"]
    result = reconstruct(data, names)
    bound = posterior_bound(Descent.of(data), result.frames, data.truth)
    assert not result.failures
    for name in names:
        found = result.trajectories[name]
        turn = frames.rotation_log(np.swapaxes(found.gRb, 1, 2) @ data.truth.gRb)
        error = np.hstack([turn, data.truth.gP - found.gP])
        least = bound.smoothed if name == "smoother" else bound.filtered
        rms = np.sqrt(np.mean(np.sum(error[:, 3:] ** 2, axis=1)))
        # One trial; the errors of neighbouring frames are alike.
        assert rms < 1.6 * np.sqrt(np.mean(position_rms_m(least) ** 2))
        nees = np.einsum("ki,ki->k", error, np.linalg.solve(found.pose_covariance, error[..., None])[..., 0])
        assert nees.mean() < chi2.ppf(0.999, 6)
        claimed = np.mean(position_rms_m(found.pose_covariance)) / np.mean(position_rms_m(least))
        assert claimed == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("add", "problem"),
    [
        ('[trajectory.end]\naltitude_m = 1.0\ndownrange_m = 0.0\nvertical_speed_m_s = 0.0\n'
         'ground_speed_m_s = 0.0\nvertical_acceleration_m_s2 = 0.0\nground_acceleration_m_s2 = 0.0\n',
         "trajectory.end"),
        ("[imu]\nrate_hz = 100.0\ngyro_arw_deg_sqrt_h = 1.0\ngyro_bias_deg_h = 1.0\n"
         "gyro_bias_walk_deg_h_sqrt_h = 1.0\naccelerometer_noise_ug_sqrt_hz = 1.0\n"
         "accelerometer_bias_ug = 1.0\naccelerometer_bias_walk_ug_sqrt_h = 1.0\n", "either a table"),
    ],
    ids=["end", "imu"],
)  # fmt: skip
def test_a_motion_model_excludes_an_imu_and_an_end(tmp_path, add, problem):
    path = tmp_path / "case.toml"
    path.write_text('base = "orbit_coast"\n' + add)
    with pytest.raises(InputError, match=problem):
        load_scenario(path)


@pytest.mark.parametrize("model", ["white_acceleration", "white_jerk"])
def test_other_motion_models_are_consistent_on_orbits_of_their_own(tmp_path, model):
    path = tmp_path / "case.toml"
    text = {
        "white_acceleration": "acceleration_density_m_s2_sqrt_hz = 0.02",
        "white_jerk": "jerk_density_m_s3_sqrt_hz = 0.001\nacceleration_sigma_m_s2 = 0.01",
    }[model]
    base = built_in_scenarios()["orbit_coast"].read_text()
    head, rest = base.split("[motion]\n")
    path.write_text(
        f'{head}[motion]\nmodel = "{model}"\n{text}\nrate_walk = 1e-6\n\n{rest[rest.index("[trajectory]") :]}'
    )
    trials, nees = 4, {}
    for trial in range(trials):
        data = Dataset.open(simulate(path, tmp_path / f"{trial}", trial=trial))
        assert data.motion.name == model
        result = reconstruct(data, ["smoother", "online", "ekf"])
        assert not result.failures
        for name, found in result.trajectories.items():
            # Far enough apart to share hardly a rim.
            for frame in (0, 19, 39):
                turn = found.gTb[frame, :3, :3].T @ data.truth.gTb[frame, :3, :3]
                error = np.append(frames.rotation_log(turn), data.truth.gP[frame] - found.gP[frame])
                one = error @ np.linalg.solve(found.pose_covariance[frame], error)
                nees.setdefault((name, frame), []).append(one)
    low, high = chi2.ppf([0.005, 0.995], 6 * trials) / trials
    assert len(nees) == 9
    for place, values in nees.items():
        assert low < np.mean(values) < high, place
