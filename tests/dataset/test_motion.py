"""Data sets without an IMU: the table [motion] is written, read and demanded."""

import dataclasses
import shutil

import numpy as np
import pytest

from craternav_fg.dataset import Dataset, Recording, write_dataset
from craternav_fg.errors import InputError
from craternav_fg.estimators.base import Descent
from craternav_fg.motion.coast import coast
from craternav_fg.motion.gravity import degree_two
from craternav_fg.motion.white_acceleration import white_acceleration
from craternav_fg.motion.white_jerk import white_jerk
from tests.dataset.samples import random_measurements, recording

MODELS = {
    "coast": coast(2e-5, rate_rad_s=(1e-3, 0.0, -2e-4), rate_walk_rad_s2_sqrt_hz=3e-6),
    "coast in a field": coast(gravity=degree_two(1738000.0, 2.03e-4, 2.2e-5)),
    "white_acceleration": white_acceleration(0.5, rate_sigma_rad_s=0.02),
    "white_jerk": white_jerk(1e-3, acceleration_sigma_m_s2=0.3),
}


def _given() -> Recording:
    rng = np.random.default_rng(1)
    return dataclasses.replace(recording(rng), measurements=random_measurements(rng))


@pytest.mark.parametrize("name", MODELS)
def test_a_data_set_without_an_imu_is_read_as_it_was_written(tmp_path, name):
    motion = MODELS[name]
    given = dataclasses.replace(_given(), imu=None, imu_noise=None, motion=motion)
    data = Dataset.open(write_dataset(tmp_path / "data", given))
    assert data.imu is None
    assert not (tmp_path / "data" / "mav0" / "imu0").exists()
    for field in dataclasses.fields(motion):
        if field.name != "gravity":
            assert getattr(data.motion, field.name) == getattr(motion, field.name)
    np.testing.assert_allclose(data.motion.gravity.C, motion.gravity.C, rtol=1e-14)
    assert data.motion.gravity.radius_m == motion.gravity.radius_m


def test_estimators_take_the_rate_of_the_initial_state(tmp_path):
    given = _given()
    initial = dataclasses.replace(given.initial, angular_velocity_rad_s=(1e-3, 2e-3, 3e-3))
    given = dataclasses.replace(given, imu=None, imu_noise=None, motion=coast(4e-5), initial=initial)
    data = Dataset.open(write_dataset(tmp_path / "data", given))
    descent = Descent.of(data)
    dt_s, gyro, _ = descent.imu.between(int(data.stamps_ns[0]), int(data.stamps_ns[-1]))
    assert sum(dt_s) == pytest.approx(1e-9 * (data.stamps_ns[-1] - data.stamps_ns[0]))
    np.testing.assert_allclose(gyro, [[1e-3, 2e-3, 3e-3]] * len(gyro))
    assert descent.imu_noise.accelerometer_density_m_s2_sqrt_hz == 4e-5


def test_an_imu_keeps_the_attitude_of_a_motion_model(tmp_path):
    given = dataclasses.replace(_given(), motion=coast(4e-5))
    data = Dataset.open(write_dataset(tmp_path / "data", given))
    descent = Descent.of(data)
    assert descent.imu_noise.gyro_density_rad_s_sqrt_hz == given.imu_noise.gyro_density_rad_s_sqrt_hz
    assert descent.imu_noise.accelerometer_density_m_s2_sqrt_hz == 4e-5
    np.testing.assert_array_equal(descent.imu.gyro_rad_s, given.imu.gyro_rad_s)


def test_a_data_set_without_imu_and_motion_is_refused(tmp_path):
    folder = write_dataset(tmp_path / "data", _given())
    shutil.rmtree(folder / "mav0" / "imu0")
    with pytest.raises(InputError, match=r"dataset.toml: motion: expected a table \[motion\]"):
        Dataset.open(folder)


def test_an_unknown_motion_model_is_refused(tmp_path):
    folder = write_dataset(tmp_path / "data", _given())
    with (folder / "dataset.toml").open("a") as stream:
        stream.write('\n[motion]\nmodel = "ballistic"\n')
    with pytest.raises(InputError, match=r"dataset.toml:\d+: motion"):
        Dataset.open(folder)


@pytest.mark.parametrize("stated", [None, (1e-3, 2e-3, 3e-3)])
def test_without_a_gyro_its_bias_is_not_the_prior_of_the_rate(tmp_path, stated):
    given = _given()
    initial = dataclasses.replace(given.initial, angular_velocity_rad_s=stated, gyro_bias_sigma_rad_s=5e-6)
    motion = white_jerk(1e-3, acceleration_sigma_m_s2=0.3, rate_sigma_rad_s=0.02)
    given = dataclasses.replace(given, imu=None, imu_noise=None, motion=motion, initial=initial)
    found = Dataset.open(write_dataset(tmp_path / "data", given)).initial
    sigma = 0.02 if stated is None else initial.angular_velocity_sigma_rad_s
    assert found.gyro_bias_sigma_rad_s == found.angular_velocity_sigma_rad_s == sigma
    assert found.accelerometer_bias_sigma_m_s2 == 0.3


def test_a_gyro_keeps_its_bias_under_a_motion_model(tmp_path):
    given = dataclasses.replace(_given(), motion=coast(4e-5))
    found = Dataset.open(write_dataset(tmp_path / "data", given)).initial
    assert found.gyro_bias_sigma_rad_s == given.initial.gyro_bias_sigma_rad_s
    assert found.accelerometer_bias_sigma_m_s2 == given.motion.acceleration_sigma_m_s2
