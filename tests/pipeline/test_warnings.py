"""Warnings: what is wrong is named, and nothing is said when all is as it should be."""

import dataclasses

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.evaluation.innovations import Innovations
from craternav_fg.evaluation.sensor_consistency import ResidualSummary
from craternav_fg.imu import ImuLog
from craternav_fg.pipeline import catalog_warnings, input_warnings, warnings
from craternav_fg.pipeline.displacement import displacement
from craternav_fg.simulation.scenes import MOON


def innovations(**nis: float) -> Innovations:
    """A hundred innovations of one dimension of each sensor."""
    count = 100 * len(nis)
    return Innovations(
        tuple(np.repeat(list(nis), 100)), np.arange(count), np.repeat(list(nis.values()), 100),
        np.ones(count, dtype=np.int64),
    )  # fmt: skip


def test_nothing_is_said_of_a_sound_run() -> None:
    assert warnings.failed_estimators({}) == []
    assert warnings.inconsistent_trajectories({"smoother": 0.1, "online": None, "dead_reckoning": 1.0}) == []
    assert warnings.inconsistent_sensors("ekf", innovations(imu=1.0, rims=1.3), {}, images=False) == []
    assert warnings.inconsistent_sensors("ekf", None, {}, images=False) == []
    assert warnings.replaced_states("given", ()) == []
    assert warnings.replaced_states("found", ()) == []
    assert warnings.frames_without_rims([3, 1, 2], [4, 1, 0]) == []
    assert warnings.frames_without_rims([3, 1, 2], None) == []


def test_estimators_whose_poses_the_rims_do_not_fit_are_named() -> None:
    (text,) = warnings.inconsistent_trajectories({"smoother": 0.2, "ekf": 0.514, "online": 1.0})
    assert "ekf (51 %), online (100 %)" in text
    assert "smoother" not in text


def test_the_sensor_that_contradicts_the_rest_is_named() -> None:
    (text,) = warnings.inconsistent_sensors(
        "ekf", innovations(imu=1.0, rims=1.4, sun=12.34), {}, images=False
    )
    assert text.startswith("sun: ")
    assert "NIS per dimension 12.3, expected 1" in text
    assert "sun.csv" in text


@pytest.mark.parametrize(("first", "said"), [(30, True), (2, False)])
def test_the_stamp_from_which_a_sensor_contradicts_the_rest_is_named(first: int, said: bool) -> None:
    """A frozen or spiking IMU is sound before; wrong units or axes are wrong from the start."""
    nis = np.where(np.arange(100) < first, 6.0, 90.0)
    stamps_ns = 10**9 * np.arange(100)
    imu = Innovations(("imu",) * 100, stamps_ns, nis, np.full(100, 6))
    (text,) = warnings.inconsistent_sensors("ekf", imu, {}, images=False)
    assert ("expected 1, but only from 30000000000 ns on)" in text) == said
    assert ("from" in text.split(";")[0].replace("from the other", "")) == said


def test_a_known_body_with_another_sphere_gravity_or_spin_is_told() -> None:
    """Images do not show heights above 1738 km for 1737.4 km: all positions were 600 m off, unsaid."""

    def told(stated: bool = False, **of_body: object) -> list[str]:
        body = dataclasses.replace(MOON, **of_body)
        nothing = np.zeros(0)
        catalog = Catalog((), *(nothing,) * 6, body, sphere_stated=stated)
        return catalog_warnings.unusual_body(catalog)

    assert told() == []
    (text,) = told(name="moon", radius_m=1738000.0)
    assert "radius_m of [body] is 1738000, but that of maps and heights of Moon 1737400" in text
    assert told(stated=True, radius_m=1738000.0) == []
    (text,) = told(mu_m3_s2=1.01 * MOON.mu_m3_s2)
    assert text == "mu_m3_s2 of [body] is 4.95183e+12, but that of Moon 4.9028e+12"
    for spin in ((0.0, 0.0, 0.0), (0.0, 0.0, -2.6617e-6), (2.6617e-6, 0.0, 0.0)):
        (text,) = told(spin_rad_s=spin)
        assert text.startswith("spin_rad_s of [body] is [")
    assert told(name="Planet Nine", radius_m=1.0, spin_rad_s=(0.0, 0.0, 0.0)) == []


def craters(heights_m: list[float], errors: MapErrors | None = None) -> Catalog:
    n = len(heights_m)
    place, size = np.linspace(0.0, 0.01, n), np.full(n, 500.0)
    names = tuple(f"C{k}" for k in range(n))
    return Catalog(names, place, place, size, size, np.zeros(n), np.array(heights_m), MOON, errors=errors)


def imu_log(count: int = 400, noise: float = 1e-3) -> ImuLog:
    rng = np.random.default_rng(2)
    gyro, force = noise * rng.normal(size=(2, count, 3))
    return ImuLog(10_000_000 * np.arange(count), 0.01 + gyro, 1.5 + force)


def test_an_imu_that_measured_nothing_is_told() -> None:
    log = imu_log()
    assert input_warnings.dead_imu(log) == input_warnings.dead_imu(None) == []
    (text,) = input_warnings.dead_imu(dataclasses.replace(log, gyro_rad_s=0.0 * log.gyro_rad_s))
    assert text == "imu: all its angular velocities are zero"
    (text,) = input_warnings.dead_imu(dataclasses.replace(log, accelerometer_m_s2=np.zeros((400, 3))))
    assert text == "imu: all its specific forces are zero"


def test_an_imu_that_stopped_is_told() -> None:
    log = imu_log()
    gyro, force = log.gyro_rad_s.copy(), log.accelerometer_m_s2.copy()
    gyro[250:], force[250:] = gyro[250], force[250]
    (text,) = input_warnings.dead_imu(ImuLog(log.stamps_ns, gyro, force))
    assert "from 2.5 s after its first row on, 150 rows repeat the same values" in text
    # Only the gyro repeats itself; and a simulated log without noise.
    assert input_warnings.dead_imu(ImuLog(log.stamps_ns, gyro, log.accelerometer_m_s2)) == []
    steps = np.repeat(np.arange(1.0, 9.0), 50)[:, None] * np.ones(3)
    assert input_warnings.dead_imu(ImuLog(log.stamps_ns, steps, steps)) == []


@pytest.mark.parametrize("digit", [1e-9, 5e-4])
def test_a_saturated_imu_is_told(digit: float) -> None:
    """Also one whose digits are as coarse as half of its noise."""
    log = imu_log(2000)
    time_s = 1e-9 * log.stamps_ns
    pulse = 2.0 * np.exp(-0.5 * ((time_s - 8.0) / 0.5) ** 2)
    force = log.accelerometer_m_s2 + pulse[:, None] * [1.0, -2.0, 0.1]
    rounded = dataclasses.replace(log, accelerometer_m_s2=digit * np.round(force / digit))
    assert input_warnings.saturated_imu(rounded) == input_warnings.saturated_imu(None) == []
    clipped = dataclasses.replace(log, accelerometer_m_s2=np.clip(rounded.accelerometer_m_s2, -1.0, 2.5))
    above, below = input_warnings.saturated_imu(clipped)
    rows = int(np.sum(force[:, 0] >= 2.5))
    assert f"a_RS_S_x is at its largest value, 2.5 m/s^2, in {rows} rows, {rows} of them in a row" in above
    assert "a_RS_S_y is at its smallest value, -1 m/s^2" in below
    # At both ends, as in a tumble.
    swing = np.clip(2.0 * np.sin(1.5 * time_s) + log.gyro_rad_s[:, 0], -1.0, 1.0)
    tumbling = dataclasses.replace(log, gyro_rad_s=swing[:, None] * [1.0, 0.1, 0.0])
    found = [text.split(" is ")[0] for text in input_warnings.saturated_imu(tumbling)]
    assert found == 2 * ["imu: w_RS_S_x"] + 2 * ["imu: w_RS_S_y"]
    # Two digits, of which one is rare; a coast before a burn; no rows.
    rare = np.where(np.arange(2000) % 300 == 0, 1e-3, 0.0)[:, None] * np.ones(3)
    burn = np.where(time_s < 6.0, 0.0, 1.5 + 0.01 * time_s)[:, None] * np.ones(3)
    for rows in (rare, rare - 1e-3, burn):
        assert input_warnings.saturated_imu(dataclasses.replace(log, accelerometer_m_s2=rows)) == []
    assert (
        input_warnings.saturated_imu(ImuLog(log.stamps_ns[:0], swing[:0, None] * np.ones(3), rare[:0])) == []
    )
    # Thrust without noise, on and off, and an axis that measures nothing.
    steps = np.where((time_s > 5.0) & (time_s < 9.0), 2.5, 0.0)[:, None] * [1.0, 1.0, 0.0]
    assert input_warnings.saturated_imu(dataclasses.replace(log, accelerometer_m_s2=steps)) == []


def test_places_in_radians_are_told() -> None:
    rng = np.random.default_rng(4)
    n = 200
    latitude, longitude = np.arcsin(rng.uniform(-1.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    names, size = tuple(f"C{k}" for k in range(n)), np.full(n, 500.0)

    def told(north: np.ndarray, east: np.ndarray) -> list[str]:
        placed = Catalog(names, np.radians(north), np.radians(east), size, size, 0.0 * size, 0.0 * size, MOON)
        return catalog_warnings.angles_in_radians(placed)

    for east in (longitude, longitude - np.pi):
        (text,) = told(latitude, east)
        assert text.endswith("deg: expected degrees, are they in radians?")
    assert told(np.degrees(latitude), np.degrees(longitude)) == []
    # A region of a few degrees, and one around the whole body near its equator.
    assert told(0.5 * latitude, longitude) == told(latitude + 0.2, longitude) == []
    assert told(latitude, 0.5 * longitude) == told(latitude, np.degrees(longitude)) == []
    # Regions of even density, elsewhere and where radians would be.
    even = rng.uniform(-1.55, 1.55, n)
    for begin in (24.0, 0.0, -3.1, 177.0):
        assert told(even, begin + longitude) == []


def test_craters_that_the_catalogue_has_twice_are_told() -> None:
    assert catalog_warnings.repeated_craters(()) == []
    (text,) = catalog_warnings.repeated_craters(("C7b", "C9b"))
    assert "C7b, C9b are left out" in text


def test_heights_in_kilometres_are_told() -> None:
    (text,) = catalog_warnings.heights_in_km(craters([-2.1, 0.3, 1.9, 3.2, -0.6, 0.7, 1.1, 2.2]))
    assert "at most 3.2 m" in text
    assert catalog_warnings.heights_in_km(craters([-2100.0, 0.3, 1.9, 3.2, -0.6, 0.7, 1.1, 2.2])) == []
    # A catalogue on the sphere, and few craters of one place.
    assert catalog_warnings.heights_in_km(craters(8 * [0.0])) == []
    assert catalog_warnings.heights_in_km(craters([-2.1, 0.3])) == []


def test_a_map_that_counts_as_exact_is_told_where_something_contradicts_it() -> None:
    exact, stated = craters([1.0, 2.0]), craters([1.0, 2.0], MapErrors.zeros(2))
    (text,) = catalog_warnings.unstated_map_errors(exact, True, 0.63)
    assert "known to 0.6 m" in text
    assert "PLACE_SIGMA_M" in text
    assert catalog_warnings.unstated_map_errors(exact, False, 0.63) == []
    assert catalog_warnings.unstated_map_errors(stated, True, 0.63) == []


def test_camera_and_stamps_are_among_the_things_to_check() -> None:
    """A focal length that is 1 % off, or half a second between the clocks, contradicts the IMU first."""
    texts = [
        *warnings.inconsistent_sensors("ekf", innovations(imu=3.0, rims=3.0), {}, images=True),
        *warnings.contradicted_prior({"accelerometer bias": 7.0, "velocity": 7.0}, np.inf),
    ]
    assert len(texts) == 4
    for text in texts:
        assert "intrinsics" in text
        assert "lens" in text
        assert "time offset between camera and IMU" in text


def test_a_motion_model_is_among_the_things_to_check() -> None:
    """Its densities are guesses: they may be wrong where no IMU is, and too wide beside a sound sensor."""
    texts = warnings.inconsistent_sensors(
        "ekf", innovations(imu=3.0, star_tracker=0.4), {}, images=False, motion=True
    )
    assert len(texts) == 2
    for text in texts:
        assert "[motion] in dataset.toml" in text
    assert "units and noise" not in texts[0]


def test_replaced_initial_states_and_new_segments_are_told() -> None:
    replaced, lost = warnings.replaced_states("replaced", (12, 40))
    assert "initial state" in replaced
    assert lost.endswith("re-initialised at frame 12, 40")


@pytest.mark.parametrize(
    ("rims", "expected", "said"),
    [
        (
            [0, 2, 0, 0],
            [0, 3, 4, 5],
            ["no rim was found in 2 of 4 frames (the first: 2)", "in view in 1 of 4 frames (the first: 0)"],
        ),
        ([0, 0], [0, 3], ["in any frame, although 1 should show some"]),
        ([0, 0], [0, 0], ["no crater of the catalogue is in view"]),
        # Three rims in one of ten frames may be matched wrongly: nothing confirms them.
        ([0, 3] + 8 * [0], 10 * [4], ["no trajectory can be trusted, whatever its covariance: 1 of 10"]),
        # No front end ran: what should be seen is not known.
        ([2, 0, 0], None, ["no rim was measured in 2 of 3 frames (the first: 1)"]),
        ([0, 0], None, ["no rim was measured in 2 of 2 frames (the first: 0)"]),
    ],
)
def test_frames_without_rims_are_counted(
    rims: list[int], expected: list[int] | None, said: list[str]
) -> None:
    found = warnings.frames_without_rims(rims, expected)
    assert len(found) == len(said)
    for text, part in zip(found, said, strict=True):
        assert part in text


def samples(nis: np.ndarray, dimension: int = 1) -> Innovations:
    """Innovations of an altimeter."""
    n = len(nis)
    return Innovations(("altimeter",) * n, np.arange(n), nis, np.full(n, dimension))


@pytest.mark.parametrize(
    ("nis", "dimension", "images", "said"),
    [
        (np.full(3000, 1.3), 1, False, "contradicts what ekf predicts from the other sensors (NIS per dim"),
        (np.full(3000, 1.3), 1, True, ""),
        (np.full(3000, 1.6), 1, True, "NIS per dimension 1.6, expected 1"),
        # Chance makes twenty samples this large.
        (np.full(20, 1.3), 1, False, ""),
        (np.full(200, 0.9), 3, False, "the stated noise is too large or in another unit"),
        (np.full(200, 0.9), 3, True, ""),
        # Improbable, but nothing to worry about.
        (np.full(30000, 0.9), 1, False, ""),
        (np.repeat([1.0, 100.0], [190, 10]), 1, False, "5 % of its samples are outliers (beyond 7 sigma)"),
        # So many are no outliers.
        (np.repeat([1.0, 100.0], [120, 80]), 1, False, "contradicts what ekf predicts"),
        (np.zeros(5), 0, False, "100 % of its samples cannot be from where ekf predicts the lander"),
    ],
)
def test_what_innovations_say_of_a_sensor(nis: np.ndarray, dimension: int, images: bool, said: str) -> None:
    found = warnings.inconsistent_sensors("ekf", samples(nis, dimension), {}, images=images)
    assert len(found) == (said != "")
    for text in found:
        assert text.startswith("altimeter: ")
        assert said in text
        assert text.endswith("check its units, T_BS and noise in sensor.yaml")


@pytest.mark.parametrize(
    ("sensor", "summary", "images", "said"),
    [
        ("rims", ResidualSummary(200, np.array([0.1, -0.6, 0.0]), 1.0), False, "a mean of 0.6 sigma"),
        # The errors of rims in images have a mean; those of other sensors have none there, either.
        ("rims", ResidualSummary(200, np.array([0.1, -0.6, 0.0]), 1.0), True, ""),
        ("altimeter", ResidualSummary(200, np.array([0.6]), 1.0), True, "a mean of 0.6 sigma"),
        ("altimeter", ResidualSummary(64, np.array([0.7]), 1.0), False, ""),
        ("altimeter", ResidualSummary(200, np.array([0.0]), 4.0), False, "are 2 times their noise"),
        ("rims", ResidualSummary(2000, np.zeros(5), 1.3), True, ""),
        ("rims", ResidualSummary(2000, np.zeros(5), 1.3), False, "are 1.1 times their noise"),
        ("altimeter", ResidualSummary(3000, np.zeros(3), 1.3), True, "are 1.1 times their noise"),
    ],
)
def test_what_residuals_say_of_a_sensor(
    sensor: str, summary: ResidualSummary, images: bool, said: str
) -> None:
    found = warnings.inconsistent_sensors("ekf", None, {sensor: summary}, images=images)
    assert len(found) == (said != "")
    for text in found:
        assert text.startswith(f"{sensor}: its residuals at the smoothed trajectory ")
        assert said in text


def test_a_sensor_is_told_once() -> None:
    residuals = {"altimeter": ResidualSummary(200, np.array([2.0]), 9.0)}
    (text,) = warnings.inconsistent_sensors("ekf", samples(np.full(3000, 1.3)), residuals, images=False)
    assert "NIS per dimension" in text


def test_without_rims_sensors_that_contradict_each_other_are_not_trusted() -> None:
    assert warnings.contradicted_without_rims("ekf", None) == []
    assert warnings.contradicted_without_rims("ekf", samples(np.ones(3000))) == []
    (text,) = warnings.contradicted_without_rims("ekf", samples(np.full(3000, 1.3)))
    assert "ekf does not predict altimeter (NIS per dimension 1.3, expected 1)" in text


def test_a_prior_that_the_data_contradict_is_told_with_what_to_check() -> None:
    assert warnings.contradicted_prior({"attitude": 4.9, "gyro bias": 5.0}, 0.1) == []
    assert warnings.contradicted_prior({"position": 3.9}, 0.1) == []
    # Nothing else contradicts a catalogue in another frame.
    assert len(warnings.contradicted_prior({"position": 4.1}, 0.1)) == 1
    attitude, bias = warnings.contradicted_prior({"attitude": 40.0, "gyro bias": 6.0}, 50.0)
    assert attitude.startswith("the smoothed trajectory is 40 sigma from the initial attitude; check")
    assert "T_BS" in attitude
    assert bias.startswith("the smoothed trajectory is 6 sigma from the prior of the gyro bias; check")
    for as_xyzw, blamed in ((4.0, True), (6.0, False)):
        (text,) = warnings.contradicted_prior({"attitude": 40.0}, as_xyzw)
        assert ("read as x, y, z, w it agrees" in text) == blamed
    (text,) = warnings.contradicted_prior({"attitude": 6.0}, 4.0)
    assert "it agrees" not in text


def test_a_position_elsewhere_is_told_in_degrees_and_metres() -> None:
    """A map in another frame moves all positions by the same angles."""

    def position(latitude_deg: float, longitude_deg: float, radius_m: float) -> np.ndarray:
        return radius_m * frames.up(*np.radians([latitude_deg, longitude_deg]))

    before = position(10.0, 179.9, 1.8e6)
    said = displacement(before, position(9.75, -179.6, 1.80002e6))
    assert said == (
        "17.4 km from it (0.500 deg of longitude to the east, 0.250 deg of latitude to the south, "
        "20 m higher)"
    )
    assert displacement(before, 0.999 * before).startswith("1800 m from it (0.000 deg")
    (text,) = warnings.contradicted_prior({"position": 9.0}, np.inf, said)
    assert text.startswith(
        f"the smoothed trajectory is 9 sigma from the initial position: {said}; check long"
    )
    (text,) = warnings.replaced_states("replaced", (), "", said)
    assert f"one from identified craters, {said}; check longitudes and latitudes in the catalogue" in text


def test_singular_covariances_are_counted() -> None:
    sound = np.tile(np.eye(6), (4, 1, 1))
    flat = sound.copy()
    flat[[1, 3]] = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    (text,) = warnings.singular_covariances({"smoother": sound, "online": None, "ekf": flat})
    assert text == "ekf: the covariance of its pose is singular in 2 of 4 frames, so it has no ANEES"


def test_what_else_was_found_is_told() -> None:
    assert warnings.contradicted_intrinsics(False) == warnings.lowered_rims(False) == []
    (text,) = warnings.contradicted_intrinsics(True)
    assert "intrinsics" in text
    (text,) = warnings.lowered_rims(True)
    assert "RIM_HEIGHT_M" in text
    bTs = np.eye(4)
    bTs[:3, 3] = 40.0
    near = np.eye(4)
    near[2, 3] = -49.0
    (text,) = input_warnings.long_lever_arms({"camera": bTs, "altimeter": near})
    assert text.startswith("camera: its lever arm in T_BS is 69.28 m; expected metres")
    (text,) = warnings.replaced_states("replaced", (), "the camera is upside down")
    assert text.endswith("; the camera is upside down")
    (text,) = warnings.failed_estimators({"ekf": "ekf: singular"})
    assert text == "no trajectory from ekf: singular"


def test_what_a_data_set_holds_is_told() -> None:
    assert input_warnings.unknown_sensors(()) == input_warnings.colour_images(0) == []
    assert input_warnings.repeated_images({}) == input_warnings.disbelieved_frames({}) == []
    (text,) = input_warnings.unknown_sensors(("radar0", "sonar0"))
    assert text.startswith("not used: mav0/radar0, mav0/sonar0: unknown sensor")
    assert input_warnings.empty_logs({"altimeter": 3}) == []
    (text,) = input_warnings.empty_logs({"altimeter": 0, "velocity": 9})
    assert "altimeter" in text
    assert "velocity" not in text
    (text,) = input_warnings.colour_images(7)
    assert text.startswith("7 images")
    for count, listed in ((5, "e.png (same pixels as 0.png);"), (7, "(same pixels as 0.png) and 2 more;")):
        repeated = {f"{letter}.png": "0.png" for letter in "abcdefg"[:count]}
        (text,) = input_warnings.repeated_images(repeated)
        assert listed in text
    (text,) = input_warnings.disbelieved_frames({3: "x.png", 8: "y.png"})
    assert "in frame 3 (x.png), 8 (y.png) contradict" in text
