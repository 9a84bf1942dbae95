"""ISIS cubes: those of Apollo 15 against their decoded states, and cubes that the tests write."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from craternav_fg.catalogs.files import write_catalog
from craternav_fg.cli.app import app
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.importing.cubes import of_cubes, of_photographs
from craternav_fg.importing.isis import read_cube
from tests.importing.cubes import ROWS, TYPES, write_cube
from tests.importing.moon import moon_catalog
from tests.shared_data import shared

pytest.importorskip("pvl")

FRAMES = (297, 298, 299, 300)


def _truth():
    return json.loads(shared("apollo15/spice_truth_297_300.json").read_text())


def _cubes():
    return [shared(f"apollo15/AS15-M-0{k}_crop.cub") for k in FRAMES]


@pytest.mark.parametrize("frame", FRAMES)
def test_apollo_cubes_give_the_decoded_states(frame):
    cube = read_cube(shared(f"apollo15/AS15-M-0{frame}_crop.cub"))
    known = _truth()["frames"][str(frame)]
    state = cube.state
    np.testing.assert_allclose(state.gTc[:3, 3], known["position_m"], atol=1e-6)
    # The camera's axes here are OpenCV's: diag(-1, 1, -1) of ISIS's.
    np.testing.assert_allclose(state.gTc[:3, :3].T, known["cRg"], atol=1e-12)
    np.testing.assert_allclose(state.sun, known["sun_g"], atol=1e-12)
    inertial = state.gV + np.cross(cube.body.spin_rad_s, state.gTc[:3, 3])
    np.testing.assert_allclose(inertial, known["velocity_inertial_m_s"], atol=1e-9)
    utc = np.datetime64(known["utc"]).astype("datetime64[ns]").astype(np.int64)
    assert cube.stamp_ns == utc
    assert cube.body.radius_m == 1737400.0
    assert cube.body.spin_rad_s[2] == pytest.approx(2.6617e-6, rel=1e-4)


def test_the_attitudes_of_the_cubes_turn_as_their_angular_velocities_say():
    one, other = (read_cube(path) for path in _cubes()[1:3])
    seconds = 1e-9 * (other.stamp_ns - one.stamp_ns)
    spin = cv2.Rodrigues(seconds * np.array(one.body.spin_rad_s))[0]
    turned = one.state.gTc[:3, :3].T @ spin @ other.state.gTc[:3, :3]
    rate = cv2.Rodrigues(turned)[0].ravel() / seconds
    np.testing.assert_allclose(rate, 0.5 * (one.state.rate_rad_s + other.state.rate_rad_s), atol=3e-4)
    assert rate[1] == pytest.approx(9e-4, rel=0.2)


def test_whole_photographs_scale_the_camera(tmp_path):
    images = [shared(f"apollo15/AS15-M-0{k}_SML.png") for k in range(295, 301)]
    camera, frames, pixels = of_photographs([read_cube(p) for p in _cubes()], images, _times(tmp_path))
    np.testing.assert_allclose(camera.matrix, _truth()["camera"]["K"], atol=1e-9)
    assert [frame.path.name for frame in frames] == [path.name for path in images]
    assert [frame.state is not None for frame in frames] == [False, False, True, True, True, True]
    assert pixels[0].shape == (1012, 1012)


@pytest.mark.parametrize("frame", FRAMES)
def test_crops_lie_where_the_label_says_in_the_photographs(frame):
    cube = read_cube(shared(f"apollo15/AS15-M-0{frame}_crop.cub"))
    scan = cv2.imread(str(shared(f"apollo15/AS15-M-0{frame}_SML.png")), cv2.IMREAD_GRAYSCALE)
    scale = 1012 / cube.parent.width_px
    fx, cx = scale * cube.parent.fx_px, scale * (cube.parent.cx_px + 0.5) - 0.5
    cy = scale * (cube.parent.cy_px + 0.5) - 0.5
    # Pixels of the scan on the crop's grid, through the two cameras.
    v, u = np.mgrid[: cube.camera.height_px, : cube.camera.width_px].astype(np.float32)
    x = (u - cube.camera.cx_px) / cube.camera.fx_px * fx + cx
    y = (v - cube.camera.cy_px) / cube.camera.fy_px * fx + cy
    # The cubes are sharper than the scans.
    crop = cv2.GaussianBlur(cube.pixels(), (0, 0), 0.8)
    inside = np.isfinite(crop)

    def correlation(dx, dy):
        seen = cv2.remap(scan, (x + dx).astype(np.float32), (y + dy).astype(np.float32), cv2.INTER_LINEAR)
        return np.corrcoef(seen[inside], crop[inside])[0, 1]

    assert correlation(0.0, 0.0) > 0.99
    # A pixel of the scan aside it is worse; each scan has a shift of its own of up to half a pixel.
    shifted = [correlation(dx, dy) for dx, dy in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))]
    assert correlation(0.0, 0.0) > max(shifted)


def test_crops_of_other_places_are_no_data_set():
    with pytest.raises(InputError, match=r"shows another part of the photograph than .*: give --photographs"):
        of_cubes([read_cube(path) for path in _cubes()])


def _times(folder: Path) -> Path:
    utc = {295: "01:24:11.754", 296: "01:24:36.970", 297: "01:25:02.243"}
    utc |= {298: "01:25:27.457", 299: "01:25:52.669", 300: "01:26:17.923"}
    path = folder / "times.csv"
    rows = [f"AS15-M-0{k}_SML.png,1971-07-31T{at}" for k, at in utc.items()]
    path.write_text("filename,utc\n" + "\n".join(rows) + "\n")
    return path


def test_the_command_imports_the_six_photographs(tmp_path):
    catalog = tmp_path / "craters.csv"
    write_catalog(catalog, moon_catalog())
    arguments = [
        "import",
        "isis",
        *map(str, _cubes()),
        "-o",
        str(tmp_path / "data"),
        "--catalog",
        str(catalog),
    ]
    for k in range(295, 301):
        arguments += ["--photographs", str(shared(f"apollo15/AS15-M-0{k}_SML.png"))]
    app([*arguments, "--times", str(_times(tmp_path))], standalone_mode=False)
    data = Dataset.open(tmp_path / "data")
    assert data.imu is None
    assert data.motion.name == "coast"
    assert len(data) == 6
    assert data.image_paths[0].name == "AS15-M-0295_SML.png"
    assert data.apriori.position_sigma_m == 1000.0
    # 298 to 300 follow each other in free fall to some metres, so 295 and 296 lie on one orbit with them.
    altitude = data.body.altitude_m(data.apriori.states.gP)
    assert np.all(np.abs(altitude - 119.2e3) < 1e3)
    known = _truth()["frames"]["299"]
    np.testing.assert_allclose(data.apriori.states.gP[4], known["position_m"], atol=1e-6)
    np.testing.assert_allclose(data.sun.at(int(data.stamps_ns[4])), known["sun_g"], atol=1e-12)


# --- cubes of the tests' own ---


@pytest.mark.parametrize("kind", TYPES)
def test_pixels_of_any_depth_are_read(tmp_path, kind):
    cube = read_cube(write_cube(tmp_path / "a.cub", kind=kind))
    expected = (np.arange(480).reshape(20, 24) % 200).astype(float)
    levels = cube.pixels()
    # Some of the least values of a byte or a word are special pixels.
    good = np.isfinite(levels)
    assert good.sum() > 470
    np.testing.assert_array_equal(levels[good], expected[good])


def test_a_camera_without_axes_reversed_looks_along_z(tmp_path):
    cube = read_cube(write_cube(tmp_path / "a.cub"))
    np.testing.assert_allclose(cube.state.gTc[:3, :3], np.eye(3), atol=1e-15)
    assert cube.camera.fx_px == 5000.0
    # The boresight at half the size in ISIS's pixels, which count from 1.
    assert (cube.camera.cx_px, cube.camera.cy_px) == (11.0, 9.0)
    np.testing.assert_allclose(cube.state.gTc[:3, 3], [1.9e6, 1e3, 2e3])
    np.testing.assert_allclose(cube.state.rate_rad_s, [0.0, 0.0, 1e-3])


def test_cubes_of_one_camera_are_a_data_set(tmp_path):
    paths = [write_cube(tmp_path / f"{k}.cub", start=f"2000-01-01T12:00:{10 * k:02d}") for k in range(3)]
    camera, frames, images = of_cubes([read_cube(path) for path in reversed(paths)])
    assert [frame.path.stem for frame in frames] == ["0", "1", "2"]
    assert camera.bit_depth == 12
    assert images[0].dtype == np.uint16
    assert images[0].max() == 4095


def test_wrong_cubes_are_refused_by_one_line(tmp_path):
    def refused(path: Path, problem: str) -> None:
        with pytest.raises(InputError, match=problem) as found:
            read_cube(path)
        assert "\n" not in str(found.value)
        assert str(path) in str(found.value)

    refused(tmp_path / "none.cub", "file is missing")
    text = tmp_path / "text.cub"
    text.write_text("no cube at all\n")
    refused(text, "expected an ISIS cube with an attached label")
    refused(
        write_cube(tmp_path / "a.cub", tables=()), "expected a table InstrumentPointing .*spiceinit.*no table"
    )
    missing = [name for name in ROWS if name != "SunPosition"]
    refused(write_cube(tmp_path / "b.cub", tables=tuple(missing)), "expected a table SunPosition")
    whole = write_cube(tmp_path / "c.cub").read_bytes()
    for cut in (9000, len(whole) - 100):
        short = tmp_path / f"short{cut}.cub"
        short.write_bytes(whole[:cut])
        refused(short, "is truncated: expected [0-9]+ bytes")
    detached = tmp_path / "d.lbl"
    detached.write_bytes(
        whole[:8192]
        .rstrip(b"\0")
        .replace(b"    StartByte = 8193\n", b"    StartByte = 1\n    ^Core = d.img\n")
    )
    refused(detached, "found a detached label of d.img")
    refused(write_cube(tmp_path / "e.cub", rows=3), "found one over 20.0 s: a line scan")
    refused(write_cube(tmp_path / "f.cub", extra="INS-1_OD_K = (0.0, 1.0)"), "OD_K: expected a lens")
    huge = tmp_path / "huge.cub"
    huge.write_bytes(whole[: 8192 + 4 * 480] + struct.pack("<d", 1e300) + whole[8200 + 4 * 480 :])
    refused(huge, "InstrumentPointing: expected unit quaternions, found .*1e.300")
    no_focal = tmp_path / "g.cub"
    no_focal.write_bytes(whole.replace(b"INS-1_FOCAL_LENGTH", b"INS-1_FOCAL_WIDTHS"))
    refused(no_focal, "INS-1_FOCAL_LENGTH: expected 1 numbers, found None")


def test_a_body_without_its_rotation_rate_is_refused(tmp_path):
    """Velocities relative to the body would be inertial ones: 4.6 m/s more on the Moon's equator."""
    path = write_cube(tmp_path / "a.cub", without_rates=("BodyRotation",))
    with pytest.raises(InputError, match=r"a.cub: BodyRotation: expected the body's angular velocity"):
        read_cube(path)


def test_a_camera_without_rates_keeps_its_attitude_among_the_stars(tmp_path):
    whole, cube = (
        read_cube(write_cube(tmp_path / "a.cub", without_rates=names))
        for names in ((), ("InstrumentPointing",))
    )
    assert cube.state.rate_rad_s.tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(cube.state.gV, whole.state.gV)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Type = Real", "Kind = Real", "Type: expected pixels of .*, found None"),
        ("Samples = 24", "Samples = many", "Samples: expected a number in the label, found 'many'"),
        ("Lines = 20", "", "Lines: expected a number in the label, found none"),
        (
            "    StartByte = 8193",
            "    Offset = 8193",
            "StartByte: expected a number in the label, found none",
        ),
        ("  Records = 1\n", "", "Records: expected a number in the label, found none"),
        ("Group = Pixels\n", "Pixels = 3\n", "expected"),
        # pvl by itself never ends here.
        ("StartByte = 8193\n    Format = BandSequential\n    Group =", "StartByte = 81 =", "an ISIS label"),
    ],
)
def test_a_damaged_label_is_refused_in_one_line(tmp_path, old, new, problem):
    path = write_cube(tmp_path / "a.cub")
    content = path.read_bytes()
    assert old.encode() in content
    changed = content.replace(old.encode(), new.encode(), 1)
    # Bytes keep their places.
    end = changed.index(b"End\n\0") + 4
    pad = len(content) - len(changed)
    path.write_bytes(
        changed[:end] + b"\0" * pad + changed[end:] if pad >= 0 else changed[:end] + changed[end - pad :]
    )
    with pytest.raises(InputError, match=problem) as caught:
        read_cube(path)
    assert "\n" not in str(caught.value)


# rasterio's own log of it fails, too.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_pixels_behind_a_label_of_odd_bytes_are_refused_in_one_line(tmp_path):
    path = write_cube(tmp_path / "a.cub")
    path.write_bytes(path.read_bytes().replace(b"Format = Band", b"Format = B\xa5nd", 1))
    with pytest.raises(InputError, match="pixels cannot be read") as caught:
        read_cube(path).pixels()
    assert "\n" not in str(caught.value)


def test_cubes_of_other_sizes_are_refused(tmp_path):
    one = write_cube(tmp_path / "a.cub")
    other = write_cube(tmp_path / "b.cub", size=(20, 20), start="2000-01-01T12:00:10")
    with pytest.raises(InputError, match=r"b.cub: expected 24 x 20 px, as .*a.cub, found 20 x 20"):
        of_cubes([read_cube(one), read_cube(other)])


def test_a_cube_without_a_photograph_of_its_time_is_refused(tmp_path):
    cube = read_cube(write_cube(tmp_path / "a.cub"))
    image = tmp_path / "a.png"
    cv2.imwrite(str(image), np.zeros((20, 24), np.uint8))
    times = tmp_path / "times.csv"
    times.write_text("filename,utc\na.png,2001-01-01T12:00:00\n")
    with pytest.raises(InputError, match=r"a.cub: expected an image of its time among 1, found none"):
        of_photographs([cube], [image], times)


def test_a_camera_that_could_not_be_read_again_is_not_written(tmp_path):
    write_catalog(tmp_path / "craters.csv", moon_catalog())
    cube = write_cube(tmp_path / "a.cub", focal_mm=100.0)
    data = tmp_path / "data"
    with pytest.raises(InputError, match=r"sensor.yaml: .*expected focal lengths in px that fit the 24 x 20"):
        app(
            ["import", "isis", str(cube), "--catalog", str(tmp_path / "craters.csv"), "-o", str(data)],
            standalone_mode=False,
        )
    assert not data.exists()


@pytest.mark.parametrize(
    ("exposure", "half_ms"),
    [("", 0), ("20.0", 10), ("20 <ms>", 10), ("20 <MilliSeconds>", 10), ("0.02 <seconds>", 10)],
)
def test_the_stamp_is_the_middle_of_the_exposure(tmp_path, exposure, half_ms):
    line = f"\n    ExposureDuration = {exposure}" if exposure else ""
    cube = read_cube(write_cube(tmp_path / "a.cub", exposure=line))
    assert np.datetime64(cube.stamp_ns, "ns") == np.datetime64("2000-01-01T12:00:00") + np.timedelta64(
        half_ms, "ms"
    )


@pytest.mark.parametrize("exposure", ["-3 <ms>", "2 <s>", "4 <ticks>", "N/A", "(1, 2)"])
def test_a_wrong_exposure_is_refused(tmp_path, exposure):
    line = f"\n    ExposureDuration = {exposure}"
    with pytest.raises(
        InputError, match=r"a.cub: ExposureDuration: expected an exposure of at most 1 s, fou"
    ):
        read_cube(write_cube(tmp_path / "a.cub", exposure=line))
