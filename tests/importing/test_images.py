"""Plain images with a table of times."""

from dataclasses import replace
from datetime import datetime
from pathlib import Path
from unicodedata import normalize

import cv2
import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import SPHERES_M
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.cli.app import app
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.errors import InputError
from craternav_fg.importing import bodies
from craternav_fg.importing.assemble import CameraState, Imported, ImportedFrame, in_order, write_imported
from craternav_fg.importing.bodies import with_gravity_and_spin
from craternav_fg.importing.images import grey_images, grey_levels, read_times, stamp_of, stamps_of
from craternav_fg.motion.coast import coast
from tests.dataset.samples import recording
from tests.importing.moon import moon_catalog


def _given(folder, sizes=((64, 48), (64, 48))):
    rng = np.random.default_rng(1)
    given = recording(rng)
    (folder / "sensor.yaml").write_text(camera_yaml(given.camera, 1.0))
    write_catalog(folder / "craters.csv", moon_catalog())
    paths = []
    for k, (width, height) in enumerate(sizes):
        paths.append(folder / f"{k}.png")
        cv2.imwrite(str(paths[-1]), rng.integers(0, 255, (height, width), dtype=np.uint8))
    rows = [f"{k}.png,1969-07-20T20:17:{40 + k}.25" for k in range(len(sizes))]
    (folder / "times.csv").write_text("filename,utc\n" + "\n".join(rows) + "\n")
    return paths


def _arguments(folder, paths):
    options = {"-o": "data", "--times": "times.csv", "--camera": "sensor.yaml", "--catalog": "craters.csv"}
    named = [part for name, value in options.items() for part in (name, str(folder / value))]
    return ["import", "images", *map(str, paths), *named, "--sun", "0,3,4"]


def test_images_become_a_data_set_in_the_order_of_time(tmp_path):
    paths = _given(tmp_path)
    densities = ("--acceleration-density-m-s2-sqrt-hz", "3e-4", "--rate-walk-rad-s2-sqrt-hz", "2e-4")
    app([*_arguments(tmp_path, paths[::-1]), *densities], standalone_mode=False)
    data = Dataset.open(tmp_path / "data")
    assert [path.name for path in data.image_paths] == ["0.png", "1.png"]
    assert np.diff(data.stamps_ns).tolist() == [1_000_000_000]
    np.testing.assert_allclose(data.sun.at(int(data.stamps_ns[0])), [0.0, 0.6, 0.8])
    np.testing.assert_array_equal(data.image(1), cv2.imread(str(paths[1]), cv2.IMREAD_GRAYSCALE))
    motion = data.motion
    assert motion.name == "coast"
    assert (motion.acceleration_density_m_s2_sqrt_hz, motion.rate_walk_rad_s2_sqrt_hz) == (3e-4, 2e-4)
    assert data.apriori is None


def test_wrong_images_and_times_are_refused(tmp_path):
    paths = _given(tmp_path, ((64, 48), (60, 48)))
    with pytest.raises(InputError, match=r"1.png: expected 64 x 48 px.*found 60 x 48"):
        app(_arguments(tmp_path, paths), standalone_mode=False)
    assert not (tmp_path / "data").exists()
    with pytest.raises(InputError, match=r"1.png: expected 64 x 48 px, as .*0.png, found 60 x 48"):
        list(grey_images(paths))
    colour = tmp_path / "colour.png"
    cv2.imwrite(str(colour), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match="expected a grey image of 8 or 16 bits, found 3 channels of uint8"):
        list(grey_images([colour]))
    with pytest.raises(InputError, match=r"times.csv: expected a row for colour.png, found 2 others"):
        stamps_of([colour], tmp_path / "times.csv")
    label = tmp_path / "detached.lbl"
    label.write_text('PDS_VERSION_ID = PDS3\n^IMAGE = "frame.img"\nEND\n')
    with pytest.raises(InputError, match=r"detached.lbl: cannot be read as an image: unknown format$"):
        list(grey_images([label]))
    deep = tmp_path / "deep.png"
    cv2.imwrite(str(deep), np.full((48, 64), 5000, np.uint16))
    assert next(grey_images([deep], bit_depth=13))[0, 0] == 5000
    for bit_depth in (8, 12):
        with pytest.raises(
            InputError, match=rf"deep.png: expected grey levels of {bit_depth} bits.*up to 5000"
        ):
            list(grey_images([deep], bit_depth=bit_depth))
    for line, problem in (
        ("a.png,noon", r":2: utc: expected a time"),
        ("a.png,2000-01-01\na.png,2000-01-02", ":3"),
        ("a.png,2016-12-31T23:59:60.5Z", r":2: utc: expected a time outside of leap seconds"),
    ):
        (tmp_path / "times.csv").write_text(f"filename,utc\n{line}\n")
        with pytest.raises(InputError, match=problem):
            read_times(tmp_path / "times.csv")


def test_states_that_do_not_open_leave_the_former_data_set(tmp_path):
    given = recording(np.random.default_rng(1))
    catalog = moon_catalog()

    def written(distance_m):
        gTc = np.eye(4)
        gTc[0, 3] = distance_m
        state = CameraState(gTc, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 1.0]))
        frames = [ImportedFrame(Path("a.png"), 5, state)]
        body = replace(catalog.body, mu_m3_s2=4.9e12)
        images = [np.full((48, 64), 99, np.uint8)]
        write_imported(tmp_path / "data", Imported(frames, given.camera, body, catalog, coast()), images)

    written(1800e3)
    with pytest.raises(InputError) as told:
        # Kilometres.
        written(1800.0)
    assert str(told.value).startswith(f"{tmp_path / 'data/mav0/state_apriori0/data.csv'}:2: ")
    assert Dataset.open(tmp_path / "data").apriori.states.gP[0, 0] == 1800e3
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_times_are_read_to_the_nanosecond(tmp_path):
    path = tmp_path / "times.csv"
    rows = ["00.123456789", "00.1234567", "00.123456", "00.123456789Z", "00.123456789+00:00", "00,123456789"]
    lines = [f'{k},"2000-01-01T00:00:{text}"' for k, text in enumerate(rows)]
    path.write_text("\n".join(["filename,utc", *lines, ""]))
    below = [stamp % 1_000_000_000 for stamp in read_times(path).values()]
    assert below == [123456789, 123456700, 123456000, *[123456789] * 3]


@pytest.mark.parametrize(
    ("begin", "end", "day"),
    [
        ("2016-12-31T23:59:59.9", "2017-01-01T00:00:00", "2016-12-31"),
        ("1972-06-01", "1999-01-01", "1972-06-30"),
        ("2017-01-01T00:00:00", "2026-11-01", None),
        ("2016-06-30T23:00:00", "2016-12-31T23:59:59.9", None),
    ],
)
def test_stamps_on_both_sides_of_a_leap_second_are_refused(begin, end, day):
    # They are a second less apart than the images: a kilometre and a half in a low orbit of the Moon.
    frames = [
        ImportedFrame(Path(f"{name}.png"), stamp_of(datetime.fromisoformat(utc)))
        for name, utc in (("b", end), ("a", begin))
    ]
    if day is None:
        assert [frame.path.stem for frame in in_order(frames)] == ["a", "b"]
        return
    with pytest.raises(InputError, match=f"b.png: the leap second at the end of {day} is between this image"):
        in_order(frames)


@pytest.mark.parametrize(("table", "folder"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_umlauts_may_be_one_character_or_two(tmp_path, table, folder):
    name = "Überflug 1.png"
    times = tmp_path / "times.csv"
    times.write_text(f"filename,utc\n{normalize(table, name)},1971-07-31T01:25:02\n", encoding="utf-8")
    assert stamps_of([tmp_path / normalize(folder, name)], times) == [49_771_502_000_000_000]


def test_grey_levels_share_one_scale():
    one, other = grey_levels([Path("a"), Path("b")], [np.array([[0.0, 1.0]]), np.array([[np.nan, 4.0]])], 8)
    assert one.tolist() == [[0, 64]]
    assert other.tolist() == [[0, 255]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("empty", [0, 1])
def test_an_image_without_values_is_named_wherever_it_stands(empty):
    images = [np.array([[0.0, 1.0]]), np.array([[2.0, 4.0]])]
    images[empty] = np.full((1, 2), np.nan)
    with pytest.raises(
        InputError, match=rf"^{empty}\.cub: expected values, found none but special constants"
    ):
        grey_levels([Path("0.cub"), Path("1.cub")], images, 8)


def test_gravity_and_spin_are_known_or_asked_for():
    still = (0.0, 0.0, 0.0)
    moon = with_gravity_and_spin(Body("Moon", 1.7e6, 1.0, still), None, None)
    assert (moon.mu_m3_s2, moon.spin_rad_s[2]) == pytest.approx((4.902800118e12, 2.6616995e-6))
    ceres = with_gravity_and_spin(Body("Ceres", 4.7e5, 1.0, still), None, None)
    # A turn in 9.074 hours.
    assert (ceres.mu_m3_s2, ceres.spin_rad_s[2]) == pytest.approx((6.2629e10, 1.9234e-4), rel=1e-4)
    turned = Body("Moon", 1.7e6, 1.0, (1e-9, 2e-9, 3e-6))
    assert with_gravity_and_spin(turned, None, None).spin_rad_s == turned.spin_rad_s
    assert with_gravity_and_spin(turned, None, 0.0).spin_rad_s == still
    with pytest.raises(InputError, match="--mu-m3-s2: expected it for Itokawa"):
        with_gravity_and_spin(Body("Itokawa", 165.0, 1.0, still), None, 4e-4)
    with pytest.raises(InputError, match="--spin-rad-s: expected it for Itokawa"):
        with_gravity_and_spin(Body("Itokawa", 165.0, 1.0, still), 4.9, None)


def test_what_is_known_of_a_body_agrees_with_its_size_and_orbit():
    """Densities are those of rock and ice; locked moons turn as they revolve."""
    for name, gm_km3_s2 in bodies._GM_KM3_S2.items():
        volume_m3 = 4.0 / 3.0 * np.pi * SPHERES_M[name] ** 3
        assert 900.0 < 1e9 * gm_km3_s2 / 6.6743e-11 / volume_m3 < 5600.0, name
    assert bodies._GM_KM3_S2.keys() <= bodies._ROTATION_DEG_DAY.keys() <= SPHERES_M.keys()
    for moon, planet, axis_km in (
        ("Moon", "Earth", 384400.0), ("Phobos", "Mars", 9378.0), ("Deimos", "Mars", 23459.0),
        ("Charon", "Pluto", 19596.0),
    ):  # fmt: skip
        gm = bodies._GM_KM3_S2[planet] + bodies._GM_KM3_S2[moon]
        assert np.radians(bodies._ROTATION_DEG_DAY[moon]) / 86400.0 == pytest.approx(
            np.sqrt(gm / axis_km**3), rel=0.01
        ), moon
