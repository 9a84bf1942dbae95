"""The examples in the description of the format are what the readers read."""

import re
import textwrap

import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.catalogs.files import read_catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.description import description_toml, read_description
from craternav_fg.dataset.sensor_files import read_camera, read_imu_noise
from craternav_fg.tables import read_table


@pytest.fixture
def example(tmp_path):
    def write(name):
        match = re.search(rf"(?s)`{re.escape(name)}`[^`]*?::\n\n(.*?)(?=\n`|\n[A-Z]|\Z)", layout.__doc__)
        path = tmp_path / name.replace("/", "_")
        path.write_text(textwrap.dedent(match[1]))
        return path

    return write


def test_the_description(example):
    body, initial = read_description(example(layout.DESCRIPTION))
    assert body.name == "Moon"
    assert initial.velocity_sigma_m_s == 5.0


@pytest.mark.parametrize("name", ['"quoted" \\\\', "two\nlines\t\x01", "\N{LAST QUARTER MOON} 1"])
def test_any_name_of_a_body_is_kept(name, tmp_path):
    path = tmp_path / layout.DESCRIPTION
    body = Body(name, 1.0e6, 2.0e12, (0.0, 1e-7, 1.0 / 3.0))
    path.write_text(description_toml(body, None), encoding="utf-8")
    assert read_description(path) == (body, None)


def test_the_sensors(example):
    camera = read_camera(example(layout.CAMERA_SENSOR))
    # The camera of the example looks along z of b, the top of its image along x.
    np.testing.assert_array_equal(-camera.bTc[:3, 1], [1.0, 0.0, 0.0])
    assert read_imu_noise(example(layout.IMU_SENSOR)).gyro_density_rad_s_sqrt_hz == 2.04e-5


def test_the_tables(example):
    body, _ = read_description(example(layout.DESCRIPTION))
    assert read_catalog(example(layout.CRATERS), body).height_m[0] == 12.5
    sun = read_table(example(layout.SUN), layout.SUN_COLUMNS)
    assert np.linalg.norm(sun.numbers(*layout.SUN_VECTOR)[0]) == pytest.approx(1.0, abs=1e-15)
    assert len(read_table(example(layout.CAMERA_DATA), layout.CAMERA_COLUMNS)) == 2
    tilts = read_table(example(layout.TILTS), layout.TILT_COLUMNS)
    assert np.linalg.norm(tilts.numbers(*layout.TILT_DIRECTION)[0]) == pytest.approx(0.6)
