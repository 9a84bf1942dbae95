import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import kstest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset, ground_sun_direction
from craternav_fg.ellipse import chart_covariance, matrix_of_chart, pixel_chart
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.imu import ImuLog
from craternav_fg.simulation import sensors
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.scenario_tables import CraterFile

CASE3 = load_scenario("paper_case3")


def shortened(scenario, duration_s):
    """The first seconds of a scenario's flight, or nearly so: the boundary states stay."""
    trajectory = scenario.trajectory.model_copy(update={"duration_s": duration_s, "frame_interval_s": 10.0})
    return scenario.model_copy(update={"trajectory": trajectory})


@pytest.fixture(scope="module")
def case3(tmp_path_factory):
    return Dataset.open(simulate(CASE3, tmp_path_factory.mktemp("case3") / "data"))


def test_stamps_cover_the_flight():
    stamps = sensors.imu_stamps(CASE3.imu, 7, 1_000_000_008)
    assert stamps[0] == 10_000_007
    assert stamps[-2] < 1_000_000_008 <= stamps[-1]


def test_imu_errors_have_the_densities_of_the_options():
    n = 200_000
    zero = ImuLog(np.arange(1, n + 1) * 25_000_000, np.zeros((n, 3)), np.zeros((n, 3)))
    options = CASE3.imu.model_copy(
        update={"gyro_bias_walk_deg_h_sqrt_h": 50.0, "accelerometer_bias_walk_ug_sqrt_h": 9000.0}
    )
    log, bias = sensors.corrupt_imu(zero, options, np.random.default_rng(1))
    dt, T = 0.025, n * 0.025
    white = np.hstack([log.gyro_rad_s, log.accelerometer_m_s2]) - bias
    # Angle random walk: the white noise summed over T spreads as its density times sqrt(T).
    spread = white.std(axis=0) * dt * math.sqrt(n) / math.sqrt(T)
    assert spread[:3] == pytest.approx(np.full(3, np.radians(0.07) / 60.0), rel=0.01)
    assert spread[3:] == pytest.approx(np.full(3, 35e-6 * 9.80665), rel=0.01)
    steps = np.diff(bias, axis=0).std(axis=0) * math.sqrt(3600.0 / dt)
    assert np.degrees(steps[:3]) * 3600.0 == pytest.approx(np.full(3, 50.0), rel=0.01)
    assert steps[3:] == pytest.approx(np.full(3, 9000e-6 * 9.80665), rel=0.01)
    turn_on = np.array(
        [sensors.corrupt_imu(cut(zero, 2), options, np.random.default_rng(k))[1][0] for k in range(400)]
    )
    assert np.degrees(turn_on[:, :3].std()) * 3600.0 == pytest.approx(1.0, rel=0.1)
    assert turn_on[:, 3:].std() == pytest.approx(300e-6 * 9.80665, rel=0.1)


def cut(log, n):
    return ImuLog(log.stamps_ns[:n], log.gyro_rad_s[:n], log.accelerometer_m_s2[:n])


def test_initial_errors_have_the_sigmas_they_tell():
    rng = np.random.default_rng(2)
    gTb = frames.pose(frames.rotation_exp(np.array([0.3, -1.0, 2.0])), np.array([1.8e6, 1e5, -2e5]))
    gV = np.array([100.0, -900.0, 30.0])
    errors = CASE3.initial_error.model_copy(update={"attitude_deg": 5.0})
    found = []
    for _ in range(1000):
        biases = CASE3.imu.gyro_bias_rad_s, CASE3.imu.accelerometer_bias_m_s2
        state = sensors.initial_state(gTb, gV, 0, errors, biases, rng)
        phi = frames.rotation_log(state.gTb[:3, :3].T @ gTb[:3, :3]) / state.attitude_sigma_rad
        p = (gTb[:3, 3] - state.gTb[:3, 3]) / state.position_sigma_m
        found.append(np.concatenate([phi, p, (gV - state.gV) / state.velocity_sigma_m_s]))
    covariance = np.cov(np.array(found).T)
    assert np.abs(covariance - np.eye(9)).max() < 0.15
    assert state.attitude_sigma_rad == pytest.approx(math.radians(5.0))
    assert state.position_sigma_m == 4000.0
    assert state.velocity_sigma_m_s == 5.0
    assert state.angular_velocity_sigma_rad_s == pytest.approx(math.radians(5.0))


def test_the_covariance_of_a_chart_is_that_of_fits_to_noisy_points():
    """Fit ellipses to noisy rim points by least squares on their distances, and compare the spread."""
    camera = Camera(1024, 1024, 700.0, 1500.0, 511.5, 511.5)
    chart = np.array([0.05, -0.1, math.log(0.06), 0.4, math.log(0.03)])
    points, sigma_px = 40, 0.5
    phase = 2.0 * np.pi * np.arange(points) / points
    rng = np.random.default_rng(3)

    def rim_px(y, phase):
        y_px = pixel_chart(y, camera)
        centre, S = y_px[:2], matrix_of_chart(y_px)
        L = np.linalg.cholesky(S)
        return centre + np.stack([np.cos(phase), np.sin(phase)], axis=-1) @ L.T

    def distances(y, observed):
        """Sampson distances, px: to first order the distance to the ellipse."""
        y_px = pixel_chart(y, camera)
        centre, S = y_px[:2], matrix_of_chart(y_px)
        d = observed - centre
        M = np.linalg.inv(S)
        f = np.einsum("ni,ij,nj->n", d, M, d) - 1.0
        return f / (2.0 * np.linalg.norm(d @ M, axis=1))

    fits = []
    for _ in range(400):
        observed = rim_px(chart, phase) + sigma_px * rng.standard_normal((points, 2))
        fits.append(least_squares(distances, chart, args=(observed,), x_scale=[0.01, 0.01, 0.1, 0.1, 0.1]).x)
    expected = chart_covariance(chart, camera, sigma_px, points)
    root = np.linalg.inv(np.linalg.cholesky(expected))
    whitened = root @ np.cov(np.array(fits).T) @ root.T
    assert np.abs(whitened - np.eye(5)).max() < 0.25


def test_measured_rims_scatter_about_the_truth_as_they_say(case3):
    errors, tilts = [], []
    for frame, gTb in zip(case3.measurements, case3.truth.gTb, strict=True):
        rows, charts = case3.catalog.visible(case3.camera, gTb, min_semi_minor_px=4.0)
        np.testing.assert_array_equal(rows, frame.rims.craters)
        root = np.linalg.inv(np.linalg.cholesky(frame.rims.covariance))
        errors.append(np.einsum("nij,nj->ni", root, frame.rims.chart - charts))
        camera = case3.camera.gTc(gTb)
        x, y, z = frame.sun.direction @ camera[:3, :3]
        u, v = frame.sun.point
        expected = math.atan2(y - v * z, x - u * z)
        tilts.append(math.remainder(frame.sun.tilt_rad - expected, 2.0 * math.pi) / frame.sun.sigma_rad)
    white = np.concatenate(errors).ravel()
    assert len(white) > 3000
    assert kstest(white, "norm").pvalue > 1e-3
    assert white.std() == pytest.approx(1.0, abs=0.05)
    assert kstest(tilts, "norm").pvalue > 1e-3
    assert frame.sun.sigma_rad == pytest.approx(math.radians(10.0))


def test_paper_case3_shows_three_craters_then_one(case3):
    altitude = case3.body.altitude_m(case3.truth.gP)
    assert altitude[0] == pytest.approx(100e3)
    assert altitude[-1] == pytest.approx(10e3)
    assert len(case3) == 301
    seen = np.array([len(frame.rims) for frame in case3.measurements])
    assert set(seen[altitude > 26.1e3]) == {3}
    assert set(seen[altitude < 26.0e3]) == {1}
    assert not (case3.path / "mav0/cam0/data").exists()


def test_a_tilt_tells_nothing_of_the_true_position(case3):
    """The direction of a tilt follows from sun, catalogue and initial estimate alone."""
    prior = case3.initial.gTb[:3, 3]
    for frame in case3.measurements[::50]:
        expected = ground_sun_direction(
            case3.sun.at(frame.stamp_ns), case3.catalog, frame.rims.craters, prior
        )
        np.testing.assert_array_equal(frame.sun.direction, expected)


def test_a_trial_determines_its_data(tmp_path):
    scenario = shortened(CASE3, 100.0)
    first, again, other = (
        Dataset.open(simulate(scenario, tmp_path / name, trial=trial))
        for name, trial in (("a", 4), ("b", 4), ("c", 5))
    )
    np.testing.assert_array_equal(first.imu.gyro_rad_s, again.imu.gyro_rad_s)
    np.testing.assert_array_equal(first.initial.gTb, again.initial.gTb)
    np.testing.assert_array_equal(first.measurements[-1].rims.chart, again.measurements[-1].rims.chart)
    assert not np.array_equal(first.imu.gyro_rad_s, other.imu.gyro_rad_s)
    assert not np.array_equal(first.initial.gTb, other.initial.gTb)
    assert not np.array_equal(first.measurements[-1].rims.chart, other.measurements[-1].rims.chart)
    # Truth does not depend on the errors.
    np.testing.assert_array_equal(first.truth.gTb, other.truth.gTb)


def test_the_sun_stays_where_it_is_while_the_body_turns(case3):
    begin, end = case3.stamps_ns[[0, -1]]
    site = frames.up(np.radians(0.67), np.radians(23.47))
    assert np.degrees(np.arcsin(case3.sun.at(begin) @ site)) == pytest.approx(30.0)
    turned = np.degrees(np.arccos(case3.sun.at(begin) @ case3.sun.at(end)))
    assert 0.0 < turned <= np.degrees(2.6616995e-6 * 600.0)
    # In the frame that does not turn.
    spin = np.array(case3.body.spin_rad_s) * (end - begin) * 1e-9
    np.testing.assert_allclose(
        frames.rotation_exp(spin) @ case3.sun.at(end), case3.sun.at(begin), rtol=0.0, atol=1e-15
    )
    middle = int(begin + 15_000_000_000)
    spin = np.array(case3.body.spin_rad_s) * 15.0
    np.testing.assert_allclose(
        frames.rotation_exp(spin) @ case3.sun.at(middle), case3.sun.at(begin), rtol=0.0, atol=1e-9
    )


def test_images_are_rendered_into_the_data_set(tmp_path):
    demo = load_scenario("lunar_descent")
    camera = demo.camera.model_copy(update={"width_px": 128, "height_px": 96})
    craters = demo.craters.model_copy(update={"min_apparent_px": 5.0, "max_apparent_px": 40.0})
    scenario = shortened(demo, 300.0).model_copy(update={"camera": camera, "craters": craters})
    trajectory = scenario.trajectory.model_copy(update={"frame_interval_s": 150.0})
    scenario = scenario.model_copy(update={"trajectory": trajectory})
    done = []
    data = Dataset.open(simulate(scenario, tmp_path / "data", progress=lambda k, n: done.append((k, n))))
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert data.measurements is None
    assert len(data) == 3
    for k in range(3):
        image = data.image(k)
        assert image.shape == (96, 128)
        assert 50 < image.mean() < 150
        assert image.std() > 2.0
    altitude = data.body.altitude_m(data.truth.gP)
    assert altitude[[0, -1]] == pytest.approx([50e3, 4e3])


def test_craters_from_a_file(tmp_path):
    (tmp_path / "craters.csv").write_text(
        "CRATER_ID,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_ELLI_MAJOR_IMG,DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG\n"
        "near,0.67,23.47,4.0,3.0,10.0\nnone,0.7,23.4,,,\n"
    )
    file = CraterFile(source="file", path=str(tmp_path / "craters.csv"))
    scenario = shortened(CASE3, 600.0).model_copy(update={"craters": file})
    data = Dataset.open(simulate(scenario, tmp_path / "data"))
    assert data.catalog.identifiers == ("near",)
    assert len(data.measurements[0].rims) == 1
    (tmp_path / "craters.csv").write_text("id,lat,lon,diam_km,Target\nnear,0.67,23.47,4.0,Dione\n")
    with pytest.raises(InputError, match=r"\(Moon\), found one of Dione on 561400 m, as Target says"):
        simulate(scenario, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_flight_into_the_ground_is_a_clear_error(tmp_path):
    end = CASE3.trajectory.end.model_copy(update={"vertical_speed_m_s": 2000.0})
    trajectory = CASE3.trajectory.model_copy(update={"end": end})
    with pytest.raises(CraternavError, match="altitude of -"):
        simulate(CASE3.model_copy(update={"trajectory": trajectory}), tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_a_foreign_folder_is_kept(tmp_path):
    (tmp_path / "x").write_text("")
    with pytest.raises(InputError, match=r"holds no dataset\.toml"):
        simulate(shortened(CASE3, 600.0), tmp_path)
