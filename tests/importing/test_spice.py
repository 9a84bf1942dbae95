"""States from kernels that the test writes through spiceypy."""

import cv2
import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.cli.app import app
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.errors import InputError
from craternav_fg.importing.images import stamp_of
from craternav_fg.importing.spice import SpiceQuery, camera_states
from tests.dataset.samples import recording
from tests.importing.kernels import RATE, attitude_of, write_kernels
from tests.importing.moon import moon_catalog

spice = pytest.importorskip("spiceypy")


@pytest.fixture
def kernels(tmp_path):
    return write_kernels(tmp_path)


def _query(meta):
    return SpiceQuery((meta,), "-999", "CAM", "MOON", "IAU_MOON")


# ET is TT to 2 ms: TAI + 32.184 s, and TAI - UTC is 32 s in 2000.
def _stamp(et):
    return stamp_of(np.datetime64("2000-01-01T12:00:00").astype(object)) + round((et - 64.184) * 1e9)


def test_states_are_those_of_the_kernels(kernels):
    for et in (-500.0, 100.0):
        (state,), spin = camera_states(_query(kernels), [_stamp(et)])
        turn = np.radians(-90.0 + 13.17635 * et / 86400.0)
        # The prime meridian is counted from the node, 90 deg east of the pole's right ascension.
        gRj = frames.rotation_exp([0.0, 0.0, -(turn + np.pi / 2)])
        inertial = 1850e3 * np.array([np.cos(9e-4 * et), np.sin(9e-4 * et), 0.0])
        np.testing.assert_allclose(state.gTc[:3, 3], gRj @ inertial, atol=10.0)
        np.testing.assert_allclose(state.gTc[:3, :3], gRj @ attitude_of(et), atol=1e-5)
        np.testing.assert_allclose(state.rate_rad_s, RATE, atol=1e-8)
        assert spin == pytest.approx((0.0, 0.0, np.radians(13.17635) / 86400.0), abs=1e-12)
        speed = 1850e3 * 9e-4 * np.array([-np.sin(9e-4 * et), np.cos(9e-4 * et), 0.0])
        relative = gRj @ speed - np.cross(spin, state.gTc[:3, 3])
        np.testing.assert_allclose(state.gV, relative, atol=0.01)
        sun = gRj @ np.array([1.0e8, 1.1e8, 2.0e6])
        np.testing.assert_allclose(state.sun, sun / np.linalg.norm(sun), atol=1e-7)


def test_what_kernels_do_not_cover_is_refused(kernels, tmp_path):
    with pytest.raises(InputError, match=r"all.tm: expected kernels that cover 2000-01-01T12:31") as found:
        camera_states(_query(kernels), [_stamp(0.0), _stamp(1975.0)])
    assert "\n" not in str(found.value)
    other = SpiceQuery((kernels,), "-999", "NO_SUCH_FRAME", "MOON", "IAU_MOON")
    with pytest.raises(InputError, match="NO_SUCH_FRAME"):
        camera_states(other, [_stamp(0.0)])
    with pytest.raises(InputError, match="file is missing"):
        camera_states(SpiceQuery((tmp_path / "none.tm",), "-999", "CAM", "MOON", "IAU_MOON"), [0])
    wrong = tmp_path / "wrong.bsp"
    wrong.write_text("no kernel")
    with pytest.raises(InputError, match=r"wrong.bsp: (cannot be loaded|expected kernels)"):
        camera_states(SpiceQuery((wrong,), "-999", "CAM", "MOON", "IAU_MOON"), [0])
    # SPICE would read it for minutes.
    with wrong.open("wb") as stream:
        stream.truncate(1 << 34)
    with pytest.raises(InputError, match=r"wrong.bsp: expected at most 64 MiB, found 16384"):
        camera_states(SpiceQuery((wrong,), "-999", "CAM", "MOON", "IAU_MOON"), [0])
    # The pool is left empty.
    assert spice.ktotal("ALL") == 0


def test_the_command_imports_images_with_their_states(kernels, tmp_path):
    given = recording(np.random.default_rng(1))
    (tmp_path / "sensor.yaml").write_text(camera_yaml(given.camera, 1.0))
    write_catalog(tmp_path / "craters.csv", moon_catalog())
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    for path in paths:
        cv2.imwrite(str(path), np.full((48, 64), 99, np.uint8))
    (tmp_path / "times.csv").write_text(
        "filename,utc\na.png,2000-01-01T12:00:00\nb.png,2000-01-01T12:01:00\n"
    )
    options = {
        "-o": "data", "--times": "times.csv", "--camera": "sensor.yaml", "--catalog": "craters.csv",
        "--meta-kernel": "all.tm",
    }  # fmt: skip
    named = [part for name, value in options.items() for part in (name, str(tmp_path / value))]
    arguments = [
        "import",
        "spice",
        *map(str, paths),
        *named,
        "--spacecraft",
        "-999",
        "--instrument-frame",
        "CAM",
    ]
    more = ["--position-sigma-m", "50", "--rate-walk-rad-s2-sqrt-hz", "2e-4"]
    app([*arguments, *more], standalone_mode=False)
    data = Dataset.open(tmp_path / "data")
    assert data.motion.rate_walk_rad_s2_sqrt_hz == 2e-4
    states = data.apriori.states
    assert data.apriori.position_sigma_m == 50.0
    np.testing.assert_allclose(np.linalg.norm(states.gP, axis=1), 1850e3, rtol=1e-6)
    np.testing.assert_allclose(states.bias[:, :3], np.tile(-RATE, (2, 1)), atol=1e-8)
    assert np.linalg.norm(states.gP[1] - states.gP[0]) == pytest.approx(60.0 * 1850e3 * 9e-4, rel=0.01)
