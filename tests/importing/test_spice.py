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
from tests.importing.moon import moon_catalog

spice = pytest.importorskip("spiceypy")

BEGIN, END = -1000.0, 1000.0
SPIN = 2.6617e-6
LSK = r"""KPL/LSK
\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT = ( 10, @1972-JAN-1 32, @1999-JAN-1 )
\begintext
"""
# A body-fixed frame that turns about z, a clock of whole seconds, and the frame of a camera with a C kernel.
TEXT = r"""KPL/FK
\begindata
FRAME_CAM = -999100
FRAME_-999100_NAME = 'CAM'
FRAME_-999100_CLASS = 3
FRAME_-999100_CLASS_ID = -999100
FRAME_-999100_CENTER = -999
CK_-999100_SCLK = -999
CK_-999100_SPK = -999
BODY301_POLE_RA = ( 0. 0. 0. )
BODY301_POLE_DEC = ( 90. 0. 0. )
BODY301_PM = ( -90. 13.17635 0. )
SCLK_KERNEL_ID = ( @2000-JAN-1 )
SCLK_DATA_TYPE_999 = ( 1 )
SCLK01_TIME_SYSTEM_999 = ( 1 )
SCLK01_N_FIELDS_999 = ( 1 )
SCLK01_MODULI_999 = ( 1000000000 )
SCLK01_OFFSETS_999 = ( 0 )
SCLK01_OUTPUT_DELIM_999 = ( 1 )
SCLK_PARTITION_START_999 = ( 0 )
SCLK_PARTITION_END_999 = ( 1000000000 )
SCLK01_COEFFICIENTS_999 = ( 0 -100000 1 )
\begintext
"""
RATE = np.array([1e-4, -9e-4, 2e-4])
R0 = frames.rotation_exp(np.array([0.3, -0.4, 0.5]))


def _attitude(et):
    """From the camera to J2000."""
    return R0 @ frames.rotation_exp(RATE * et)


@pytest.fixture
def kernels(tmp_path):
    (tmp_path / "naif.tls").write_text(LSK)
    (tmp_path / "frames.tf").write_text(TEXT)
    epochs = np.linspace(BEGIN, END, 401)
    handle = spice.spkopn(str(tmp_path / "orbit.bsp"), "test", 0)
    w, r = 9e-4, 1850.0
    states = np.stack(
        [r * np.cos(w * epochs), r * np.sin(w * epochs), 0 * epochs,
         -r * w * np.sin(w * epochs), r * w * np.cos(w * epochs), 0 * epochs], axis=1,
    )  # fmt: skip
    spice.spkw09(
        handle, -999, 301, "J2000", BEGIN, END, "orbit", 7, len(epochs), np.ascontiguousarray(states), epochs
    )
    sun = np.tile([1.0e8, 1.1e8, 2.0e6, 0.0, 0.0, 0.0], (len(epochs), 1))
    spice.spkw09(
        handle, 10, 301, "J2000", BEGIN, END, "sun", 7, len(epochs), np.ascontiguousarray(sun), epochs
    )
    spice.spkcls(handle)
    spice.furnsh(str(tmp_path / "naif.tls"))
    spice.furnsh(str(tmp_path / "frames.tf"))
    handle = spice.ckopn(str(tmp_path / "attitude.bc"), "test", 0)
    ticks = np.array([spice.sce2c(-999, et) for et in epochs])
    quats = np.array([spice.m2q(np.ascontiguousarray(_attitude(et).T)) for et in epochs])
    rates = np.array([_attitude(et) @ RATE for et in epochs])
    spice.ckw03(
        handle,
        ticks[0],
        ticks[-1],
        -999100,
        "J2000",
        True,
        "attitude",
        len(epochs),
        ticks,
        quats,
        rates,
        1,
        ticks[:1],
    )
    spice.ckcls(handle)
    spice.kclear()
    meta = tmp_path / "all.tm"
    names = ["naif.tls", "frames.tf", "orbit.bsp", "attitude.bc"]
    listed = " ".join(f"'$K/{name}'" for name in names)
    meta.write_text(
        f"KPL/MK\n\\begindata\nPATH_VALUES = ( '{tmp_path}' )\nPATH_SYMBOLS = ( 'K' )\n"
        f"KERNELS_TO_LOAD = ( {listed} )\n\\begintext\n"
    )
    return meta


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
        np.testing.assert_allclose(state.gTc[:3, :3], gRj @ _attitude(et), atol=1e-5)
        np.testing.assert_allclose(state.rate, RATE, atol=1e-8)
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
    with pytest.raises(InputError, match="kernel is missing"):
        camera_states(SpiceQuery((tmp_path / "none.tm",), "-999", "CAM", "MOON", "IAU_MOON"), [0])
    wrong = tmp_path / "wrong.bsp"
    wrong.write_text("no kernel")
    with pytest.raises(InputError, match=r"wrong.bsp: (cannot be loaded|expected kernels)"):
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
    app([*arguments, "--position-sigma-m", "50"], standalone_mode=False)
    data = Dataset.open(tmp_path / "data")
    states = data.apriori.states
    assert data.apriori.position_sigma_m == 50.0
    np.testing.assert_allclose(np.linalg.norm(states.gP, axis=1), 1850e3, rtol=1e-6)
    np.testing.assert_allclose(states.bias[:, :3], np.tile(-RATE, (2, 1)), atol=1e-8)
    assert np.linalg.norm(states.gP[1] - states.gP[0]) == pytest.approx(60.0 * 1850e3 * 9e-4, rel=0.01)
