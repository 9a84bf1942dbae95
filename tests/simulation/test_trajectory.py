import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.simulation import sensors
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.trajectory import Descent

# Ten times the Moon's spin about a slanted axis: an error in a Coriolis term cannot hide.
BODY = Body("test", 1737400.0, 4.902800118e12, (1.2e-5, -0.8e-5, 2.2e-5))


@pytest.fixture(scope="module")
def descent():
    return Descent(BODY, load_scenario("lunar_descent").trajectory)


def test_boundary_states_are_met(descent):
    options = descent.options
    motion = descent.evaluate(np.array([0.0, descent.duration_s]))
    altitude = BODY.altitude_m(motion.gP)
    assert altitude == pytest.approx([options.start.altitude_m, options.end.altitude_m], abs=1e-6)
    up = motion.gP / np.linalg.norm(motion.gP, axis=1, keepdims=True)
    vertical = np.einsum("ni,ni->n", motion.gV, up)
    assert vertical == pytest.approx([options.start.vertical_speed_m_s, options.end.vertical_speed_m_s])
    site = frames.up(np.radians(options.site_latitude_deg), np.radians(options.site_longitude_deg))
    assert up[1] == pytest.approx(site, abs=1e-12)
    along = np.arccos(up[0] @ site) * BODY.radius_m
    assert along == pytest.approx(-options.start.downrange_m)


def test_flight_follows_the_heading(descent):
    motion = descent.evaluate(np.array([descent.duration_s]))
    lat, lon = frames.latitude_longitude(motion.gP[0])
    east, north, _ = (motion.gV[0] @ frames.east_north_up(lat, lon)).tolist()
    found = np.degrees(np.arctan2(east, north)) - descent.options.heading_deg
    assert found % 360.0 == pytest.approx(0.0, abs=1e-9) or found % 360.0 == pytest.approx(360.0, abs=1e-9)


def test_camera_looks_down_and_ahead_by_the_pitch(descent):
    motion = descent.evaluate(np.array([0.0]))
    down = -motion.gP[0] / np.linalg.norm(motion.gP[0])
    z = motion.gRb[0, :, 2]
    options = descent.options.attitude
    off_nadir_deg = np.degrees(np.arccos(z @ down))
    assert abs(off_nadir_deg - options.start_pitch_deg) <= sum(options.oscillation_deg)
    assert z @ motion.gV[0] > 0.2 * np.linalg.norm(motion.gV[0])


def test_motion_obeys_the_equations_of_motion(descent):
    """Integrate (26) and (27), in the inertial frame, from the specific force and the gyro's rate."""
    spin = np.array(BODY.spin_rad_s)
    start = descent.evaluate(np.array([0.0]))

    def derivative(t, state):
        P, V, q = state[:3], state[3:6], state[6:]
        motion = descent.evaluate(np.array([t]))
        R = Rotation.from_quat(q)
        gravity = -BODY.mu_m3_s2 * P / np.linalg.norm(P) ** 3
        wx, wy, wz = motion.angular_velocity_rad_s[0]
        rate = 0.5 * np.array([[0, wz, -wy, wx], [-wz, 0, wx, wy], [wy, -wx, 0, wz], [-wx, -wy, -wz, 0]])
        return np.concatenate([V, R.apply(motion.specific_force_m_s2[0]) + gravity, rate @ q])

    # At t = 0 the inertial frame is g.
    q = Rotation.from_matrix(start.gRb[0]).as_quat()
    state = np.concatenate([start.gP[0], start.gV[0] + np.cross(spin, start.gP[0]), q])
    T = descent.duration_s
    flown = solve_ivp(derivative, (0.0, T), state, method="DOP853", rtol=1e-12, atol=1e-9, max_step=5.0)
    assert flown.success
    end = descent.evaluate(np.array([T]))
    back = Rotation.from_rotvec(-spin * T)
    P = back.apply(flown.y[:3, -1])
    V = back.apply(flown.y[3:6, -1]) - np.cross(spin, P)
    R = (back * Rotation.from_quat(flown.y[6:, -1])).as_matrix()
    assert np.linalg.norm(P - end.gP[0]) < 1e-3
    assert np.linalg.norm(V - end.gV[0]) < 1e-5
    assert np.linalg.norm(frames.rotation_log(R.T @ end.gRb[0])) < 1e-9


def test_descent_into_the_ground_is_refused():
    options = load_scenario("lunar_descent").trajectory
    start = options.start.model_copy(update={"vertical_speed_m_s": -2000.0})
    with pytest.raises(ValueError, match="altitude of -"):
        Descent(BODY, options.model_copy(update={"start": start}))


def test_imu_means_lead_back_to_the_trajectory(descent):
    """The log's rotations, chained, give the attitude; its forces, turned and summed, the velocity."""
    stamps = np.arange(1, 6001, dtype=np.int64) * 10_000_000
    log = sensors.ideal_imu(descent, stamps, 0)
    spin = np.array(BODY.spin_rad_s)
    dt = 0.01
    t = np.concatenate([[0], stamps]) * 1e-9
    motion = descent.evaluate(t)
    R = Rotation.from_matrix(motion.gRb[0])
    V = motion.gV[0] + np.cross(spin, motion.gP[0])
    middle = descent.evaluate(t[:-1] + 0.5 * dt)
    gravity = BODY.gravity(middle.gP)
    for k in range(len(stamps)):
        half = R * Rotation.from_rotvec(0.5 * dt * log.gyro_rad_s[k])
        inertial = Rotation.from_rotvec(spin * (t[k] + 0.5 * dt))
        V = V + dt * (half.apply(log.accelerometer_m_s2[k]) + inertial.apply(gravity[k]))
        R = R * Rotation.from_rotvec(dt * log.gyro_rad_s[k])
    back = Rotation.from_rotvec(-spin * t[-1])
    assert np.linalg.norm((back * R).inv().as_matrix() @ motion.gRb[-1] - np.eye(3)) < 1e-10
    expected = motion.gV[-1] + np.cross(spin, motion.gP[-1])
    assert np.linalg.norm(back.apply(V) - expected) < 1e-5


def test_a_slow_imu_gives_the_means_of_a_fast_one(descent):
    fine = sensors.ideal_imu(descent, np.arange(1, 60_001, dtype=np.int64) * 1_000_000, 0)
    coarse = sensors.ideal_imu(descent, np.arange(1, 61, dtype=np.int64) * 1_000_000_000, 0)
    means = fine.accelerometer_m_s2.reshape(60, 1000, 3).mean(axis=1)
    np.testing.assert_allclose(coarse.accelerometer_m_s2, means, rtol=0.0, atol=1e-10)
