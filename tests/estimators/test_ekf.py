"""The distributed filter: fusion rules, agreement with a central update, consistency."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalog import Catalog
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem, Start
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.ekf import DistributedEkf, EkfOptions, ekf, ekf_paper
from craternav_fg.estimators.ekf_fusion import Update, combine, fuse_updates
from craternav_fg.estimators.ekf_measurement import inflation, linearise_rims, linearise_sun
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.trajectory import InitialState
from factors.kernels import conic, sun

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))
FOCAL_PX = 512 / np.tan(np.radians(22))
NOISE = ImuNoise(2.0e-5, 3.4e-4, 1e-8, 1e-7)
RATE_HZ = 50
SIGMAS = {"attitude": np.radians(1.0), "position": 300.0, "velocity": 5.0, "gyro": 4.8e-6, "acc": 2.9e-3}
MOUNTING = frames.pose(np.eye(3), np.array([1.0, 0.0, 0.5]))
SUN_SIGMA_RAD = np.radians(10.0)
PLAIN = EkfOptions(iterations=1, limit_sigmas=None, gate_sigmas=None)


@dataclasses.dataclass(frozen=True)
class World:
    """A descent of 100 s from 50 km, known exactly, above random craters."""

    camera: Camera
    catalog: Catalog
    stamps_ns: np.ndarray
    gTb: np.ndarray
    gV: np.ndarray
    imu: ImuLog
    seen: tuple
    sun: np.ndarray


def motion(t):
    """Poses, velocities, accelerations in g and gyro rates in b, at times (n,)."""
    R0 = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # nadir at lon 0: z down
    w = np.array([0.0006, -0.0009, 0.002])
    R = R0 @ Rotation.from_rotvec(t[:, None] * w).as_matrix()
    P0 = np.array([MOON.radius_m + 50e3, -20e3, 5e3])
    V0, A = np.array([-500.0, 500.0, -100.0]), np.array([2.0, -3.0, 0.5])
    P = P0 + t[:, None] * V0 + 0.5 * t[:, None] ** 2 * A
    V = V0 + t[:, None] * A
    spin = np.array(MOON.spin_rad_s)
    acc = A - MOON.gravity(P) + 2 * np.cross(spin, V) + np.cross(spin, np.cross(spin, P))
    f = np.einsum("nji,nj->ni", R, acc)
    return R, P, V, f, w + np.einsum("nji,j->ni", R, spin)


def make_world(seed=0, duration_s=100.0, period_s=2.0, craters=60):
    rng = np.random.default_rng(seed)
    b = rng.uniform(500.0, 2000.0, craters)
    catalog = Catalog(
        tuple(f"C{i}" for i in range(craters)),
        rng.uniform(-40e3, 40e3, craters) / MOON.radius_m,
        rng.uniform(-40e3, 40e3, craters) / MOON.radius_m,
        b * rng.uniform(1.05, 1.4, craters),
        b,
        rng.uniform(-np.pi, np.pi, craters),
        rng.uniform(-300.0, 300.0, craters),
        MOON,
    )
    camera = Camera(
        1024, 1024, FOCAL_PX, FOCAL_PX, 511.5, 511.5, frames.pose(np.eye(3), np.array([1.0, 0, 0.5]))
    )
    n = round(duration_s * RATE_HZ)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    t = ((np.arange(n)[:, None] + 0.5 + 0.5 * nodes) / RATE_HZ).ravel()
    _, _, _, f, w = motion(t)
    means = [np.einsum("nkj,k->nj", v.reshape(n, 3, 3), 0.5 * weights) for v in (w, f)]
    stamps = (np.arange(1, n + 1) * (10**9 // RATE_HZ)).astype(np.int64)
    at = np.arange(0.0, duration_s + 1e-9, period_s)
    R, P, V, _, _ = motion(at)
    gTb = np.array([frames.pose(*pair) for pair in zip(R, P, strict=True)])
    seen = tuple(catalog.visible(camera, T, min_semi_minor_px=8.0) for T in gTb)
    return World(
        camera,
        catalog,
        np.round(at * 1e9).astype(np.int64),
        gTb,
        V,
        ImuLog(stamps, *means),
        seen,
        np.array([0.5, 0.6, 0.6245]),
    )


def rim_covariance(y, sigma_px=0.4):
    """Chart covariance of a rim measured by evenly spread edge points; correlated, as fits are."""
    size = np.exp(np.array([0.0, 0.0, -y[2], -y[2], -y[2]]))
    root = np.tril(np.full((5, 5), 0.2)) + 0.8 * np.eye(5)
    root = size[:, None] * sigma_px / FOCAL_PX * root
    return root @ root.T


def drawn(charts, S, rng):
    """Charts (n, 5) with Gaussian errors of covariances (n, 5, 5)."""
    return charts + np.einsum("nij,nj->ni", np.linalg.cholesky(S), rng.normal(size=charts.shape))


def draw(world, rng, *, start_scale=1.0):
    """One problem: measurements and start drawn about the truth from their own covariances."""
    measured = []
    for stamp, T, (rows, charts) in zip(world.stamps_ns, world.gTb, world.seen, strict=True):
        S = np.array([rim_covariance(y) for y in charts]).reshape(-1, 5, 5)
        y = drawn(charts, S, rng)
        tilt, _ = sun.sun_tilt(T, world.camera.bTc, world.sun, 0.0, 0.0, np.zeros((1, 6)))
        tilt = sun.wrap(tilt + SUN_SIGMA_RAD * rng.normal())
        measured.append(
            FrameMeasurement(
                int(stamp), RimSet(rows, y, S), SunTilt(tilt, SUN_SIGMA_RAD, np.zeros(2), world.sun)
            )
        )
    sigma = start_scale * np.repeat([SIGMAS["attitude"], SIGMAS["position"]], 3)
    # Correlated, as a start from rims is: a turn and a shift look alike.
    root = np.diag(sigma) @ np.linalg.cholesky(0.5 * np.eye(6) + 0.5 * np.ones((6, 6)))
    error = root @ rng.normal(size=6)
    start = world.gTb[0].copy()
    start[:3, :3] = start[:3, :3] @ frames.rotation_exp(-error[:3])
    start[:3, 3] -= error[3:]
    dt = 1.0 / RATE_HZ
    bias = np.repeat([SIGMAS["gyro"], SIGMAS["acc"]], 3) * rng.normal(size=6)
    n = len(world.imu.stamps_ns)
    walk = np.cumsum(rng.normal(size=(n, 6)) * np.sqrt(dt), axis=0)
    walk *= np.repeat([NOISE.gyro_walk, NOISE.accelerometer_walk], 3)
    white = rng.normal(size=(n, 6)) / np.sqrt(dt)
    white *= np.repeat([NOISE.gyro_density, NOISE.accelerometer_density], 3)
    added = bias + walk + white
    return Problem(
        body=MOON,
        camera=world.camera,
        catalog=world.catalog,
        imu=ImuLog(
            world.imu.stamps_ns, world.imu.gyro + added[:, :3], world.imu.accelerometer + added[:, 3:]
        ),
        imu_noise=NOISE,
        initial=InitialState(
            stamp_ns=int(world.stamps_ns[0]),
            gTb=start,
            gV=world.gV[0] + SIGMAS["velocity"] * rng.normal(size=3),
            attitude_sigma_rad=SIGMAS["attitude"],
            position_sigma_m=SIGMAS["position"],
            velocity_sigma_m_s=SIGMAS["velocity"],
            angular_velocity_sigma_rad_s=np.radians(5.0),
            gyro_bias_sigma_rad_s=SIGMAS["gyro"],
            accelerometer_bias_sigma_m_s2=SIGMAS["acc"],
        ),
        start=Start(start, root @ root.T),
        frames=measured,
    )


def pose_errors(trajectory, world):
    """Errors (k, 6) of attitude (in b) and position, truth minus estimate."""
    phi = frames.rotation_log(np.swapaxes(trajectory.gRb, 1, 2) @ world.gTb[:, :3, :3])
    return np.concatenate([phi, world.gTb[:, :3, 3] - trajectory.gP], axis=1)


def nees(trajectory, world):
    e = pose_errors(trajectory, world)
    return np.einsum("ki,ki->k", e, np.linalg.solve(trajectory.pose_covariance, e[:, :, None])[:, :, 0])


@pytest.fixture(scope="module")
def world():
    return make_world()


@pytest.fixture(scope="module")
def problem(world):
    return draw(world, np.random.default_rng(11))


# ---------------------------------------------------------------- fusion of linear sub-filters


def linear_toy(rule, runs=100, steps=15, filters=3, seed=0):
    """NEES per step of three sub-filters on one linear, observable system of 6 states."""
    rng = np.random.default_rng(seed)
    F = np.eye(6)
    F[:3, 3:] = 0.1 * np.eye(3)
    Q = np.diag(np.repeat([1e-4, 1e-2], 3))
    H = [rng.normal(size=(2, 6)) * np.repeat([1.0, 0.2], 3) for _ in range(filters)]
    out = np.zeros((runs, steps))
    for run in range(runs):
        x, P = np.zeros(6), np.eye(6)
        truth = rng.normal(size=6)
        own = [(x, P)] * filters
        for step in range(steps):
            truth = F @ truth + np.sqrt(np.diag(Q)) * rng.normal(size=6)
            z = [h @ truth + rng.normal(size=2) for h in H]
            if rule == "paper":
                own = [(F @ a, F @ p @ F.T + Q) for a, p in own]
                updated = []
                for (a, p), h, zi in zip(own, H, z, strict=True):
                    d, p1 = fuse_updates(p, [Update(h, zi - h @ a)], "exact")
                    updated.append((a + d, p1))
                own = updated
                x, P = combine(np.array([a for a, _ in own]), np.array([p for _, p in own]))
            else:
                x, P = F @ x, F @ P @ F.T + Q
                d, P = fuse_updates(P, [Update(h, zi - h @ x) for h, zi in zip(H, z, strict=True)], rule)
                x = x + d
            e = truth - x
            out[run, step] = e @ np.linalg.solve(P, e)
    return out.mean(axis=0)


def test_only_the_exact_rule_is_consistent_on_a_linear_system():
    anees = {
        rule: linear_toy(rule) for rule in ("exact", "paper", "paper-fed-back", "covariance-intersection")
    }
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * 100) / 100
    assert low < anees["exact"][0] < high
    assert low < anees["exact"][-1] < high
    # Eq. (29) on the output counts three priors in every step, and stays there.
    assert 8.0 < anees["paper"][0] < 20.0
    assert 8.0 < anees["paper"][-1] < 20.0
    # Fed back, it trusts itself more in every step.
    assert anees["paper-fed-back"][0] > high
    assert anees["paper-fed-back"][-1] > 5 * anees["paper-fed-back"][0]
    assert anees["covariance-intersection"][0] < anees["exact"][0]
    assert anees["covariance-intersection"][-1] < low


def test_equation_29_weighs_by_information():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 5, 5))
    covariances = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(5)
    x = rng.normal(size=(4, 5))
    units = 10.0 ** np.array([-6, -3, 0, 3, 6])
    delta, covariance = combine(x * units, covariances * np.outer(units, units))
    # Least squares on the stacked estimates, by another road.
    rows = np.vstack([np.linalg.inv(np.linalg.cholesky(c)) for c in covariances])
    values = np.concatenate(
        [np.linalg.inv(np.linalg.cholesky(c)) @ v for c, v in zip(covariances, x, strict=True)]
    )
    expected, *_ = np.linalg.lstsq(rows, values, rcond=None)
    np.testing.assert_allclose(delta / units, expected, rtol=1e-9)
    np.testing.assert_allclose(
        covariance / np.outer(units, units), np.linalg.inv(rows.T @ rows), rtol=1e-9, atol=1e-12
    )


# ---------------------------------------------------------------- one central update


def central_update(state, frame, problem):
    """Stack all measurements and apply Joseph's form, in states scaled by their sigmas."""
    T, camera, catalog = state.gTb, problem.camera, problem.catalog
    rows = frame.rims.craters
    y, J, _ = conic.chart_jacobian(T, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    n = len(rows)
    H = np.zeros((5 * n + 1, 18))
    H[:-1, :6] = J.reshape(-1, 6)
    Js = np.zeros((1, 6))
    tilt, _ = sun.sun_tilt(T, camera.bTc, frame.sun.direction, *frame.sun.point, Js)
    H[-1, :6] = Js
    H[:, 3:6] = H[:, 3:6] @ T[:3, :3].T
    z = np.append((frame.rims.chart - y).ravel(), np.angle(np.exp(1j * (frame.sun.tilt_rad - tilt))))
    noise = np.zeros((5 * n + 1, 5 * n + 1))
    for i in range(n):
        noise[5 * i : 5 * i + 5, 5 * i : 5 * i + 5] = frame.rims.covariance[i]
    noise[-1, -1] = frame.sun.sigma_rad**2
    s = np.sqrt(np.diag(state.covariance))
    P, H = state.covariance / np.outer(s, s), H * s
    K = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
    I_KH = np.eye(18) - K @ H
    P = I_KH @ P @ I_KH.T + K @ noise @ K.T
    return s * (K @ z), P * np.outer(s, s)


def test_exact_fusion_equals_a_central_update(world, problem):
    # The prior of the second frame: correlated over all 18 states.
    prior = filter_state.propagate(
        filter_state.begin(problem), problem, problem.frames[0].stamp_ns, problem.frames[1].stamp_ns
    )
    frame = problem.frames[1]
    assert len(frame.rims) >= 3
    delta, covariance = central_update(prior, frame, problem)
    expected = prior.moved(delta, covariance)
    found = DistributedEkf("ekf", PLAIN).estimate(dataclasses.replace(problem, frames=problem.frames[:2]))
    s = np.sqrt(np.diag(expected.covariance))
    R_error = frames.rotation_log(expected.gTb[:3, :3].T @ found.gRb[1])
    np.testing.assert_allclose(R_error / s[:3], 0.0, atol=1e-9)
    np.testing.assert_allclose((found.gP[1] - expected.gTb[:3, 3]) / s[3:6], 0.0, atol=1e-9)
    np.testing.assert_allclose((found.gV[1] - expected.gV) / s[6:9], 0.0, atol=1e-9)
    np.testing.assert_allclose((found.bias[1] - expected.bias) / s[12:], 0.0, atol=1e-9)
    for part, name in ((slice(0, 6), "pose"), (slice(6, 9), "velocity"), (slice(12, 18), "bias")):
        scale = np.outer(s[part], s[part])
        difference = (getattr(found, f"{name}_covariance")[1] - expected.covariance[part, part]) / scale
        np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def test_sub_filters_that_share_a_prior_fuse_as_their_covariances_say(problem):
    # Each sub-filter by itself, then the information of each rule summed with plain inverses.
    frame = problem.frames[1]
    prior = np.diag(np.repeat([1e-2, 30.0, 2.0, 0.1, 1e-3, 1e-2], 3) ** 2)
    A, r, usable = linearise_rims(
        problem.start.gTb, frame.rims, problem.camera, problem.catalog, model="chart", noise="measured"
    )
    assert usable.all()
    updates = [Update(a, b) for a, b in zip(A, r, strict=True)]
    n = len(updates)
    singles = [fuse_updates(prior, [u], "exact") for u in updates]
    s = np.sqrt(np.diag(prior))
    infos = [np.linalg.inv(c / np.outer(s, s)) for _, c in singles]
    vectors = [i @ (d / s) for i, (d, _) in zip(infos, singles, strict=True)]
    totals = {
        "exact": (sum(infos) - (n - 1) * np.eye(18), sum(vectors)),
        "paper-fed-back": (sum(infos), sum(vectors)),
        "covariance-intersection": (sum(infos) / n, sum(vectors) / n),
    }
    for rule, (info, vector) in totals.items():
        delta, covariance = fuse_updates(prior, updates, rule)
        np.testing.assert_allclose(
            np.linalg.inv(covariance / np.outer(s, s)), info, atol=1e-7 * np.abs(info).max()
        )
        np.testing.assert_allclose(delta / s, np.linalg.solve(info, vector), rtol=1e-6, atol=1e-9)


def test_a_correction_carries_the_covariance_to_the_new_attitude():
    # A large correction: the error left after it, seen from the corrected attitude, is turned and scaled.
    rng = np.random.default_rng(2)
    T = frames.pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 1e6)
    state = filter_state.FilterState(T, rng.normal(size=3), rng.normal(size=3), np.zeros(6), np.eye(18))
    delta = rng.normal(size=18)
    for i in range(18):
        e = 1e-6 * np.eye(18)[i]
        moved = state.moved(delta, np.outer(e, e) * 1e12)
        left = state.moved(delta + e, np.eye(18)).minus(state.moved(delta - e, np.eye(18))) / 2e-6
        np.testing.assert_allclose(moved.covariance, np.outer(left, left), atol=1e-3)


# ---------------------------------------------------------------- measurements


@pytest.mark.parametrize("noise", ["measured", "fixed"])
def test_implicit_and_chart_measurements_agree_near_the_truth(world, problem, noise):
    # EQUATIONS: whitened by its own covariance, (19) is the conic residual: same information, same sign.
    frame = problem.frames[3]
    rng = np.random.default_rng(0)
    T = world.gTb[3].copy()
    T[:3, 3] += rng.normal(size=3)  # one metre
    T[:3, :3] = T[:3, :3] @ frames.rotation_exp(1e-5 * rng.normal(size=3))
    exact = RimSet(*world.seen[3], frame.rims.covariance)
    forms = [
        linearise_rims(T, exact, problem.camera, problem.catalog, model=model, noise=noise)
        for model in ("chart", "implicit")
    ]
    steps = np.repeat([1e-3, 30.0], 3)
    infos = [np.einsum("nki,nkj->ij", A, A) * np.outer(steps, steps) for A, _, _ in forms]
    vectors = [np.einsum("nki,nk->i", A, r) * steps for A, r, _ in forms]
    assert np.abs(infos[0] - infos[1]).max() < 0.01 * np.abs(infos[0]).max()
    assert np.abs(vectors[0] - vectors[1]).max() < 0.01 * np.abs(vectors[0]).max()


def test_whitened_rows_have_unit_noise(world, problem):
    # At the true pose the residuals of drawn rims are the noise itself.
    rng = np.random.default_rng(8)
    rows, charts = world.seen[2]
    S = np.array([rim_covariance(y) for y in charts])
    T = world.gTb[2]
    for model in ("chart", "implicit"):
        samples = []
        for _ in range(300):
            y = drawn(charts, S, rng)
            _, r, _ = linearise_rims(
                T, RimSet(rows, y, S), problem.camera, problem.catalog, model=model, noise="measured"
            )
            samples.append(r)
        squared = np.sum(np.array(samples) ** 2, axis=2)
        assert squared.mean() == pytest.approx(5.0, abs=5 * np.sqrt(10.0 / squared.size))


def test_sun_residual_is_wrapped(problem):
    frame = problem.frames[0]
    J = np.zeros((1, 6))
    tilt, _ = sun.sun_tilt(problem.start.gTb, problem.camera.bTc, frame.sun.direction, 0.0, 0.0, J)
    for offset in (0.1, -0.1, 2 * np.pi - 0.1, -2 * np.pi + 0.1):
        measured = SunTilt(tilt + offset, 0.2, np.zeros(2), frame.sun.direction)
        update = linearise_sun(problem.start.gTb, measured, problem.camera)
        assert abs(update.residual[0]) == pytest.approx(0.5)
        assert update.residual[0] * offset > 0 if abs(offset) < 1 else update.residual[0] * offset < 0
    assert linearise_sun(problem.start.gTb, None, problem.camera) is None
    along = problem.start.gTb[:3, 2]
    assert linearise_sun(problem.start.gTb, SunTilt(0.0, 0.2, np.zeros(2), along), problem.camera) is None


def test_inflated_noise_meets_the_limit():
    rng = np.random.default_rng(3)
    A, P = rng.normal(size=(5, 6)), np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    r = 20.0 * rng.normal(size=5)
    (sigmas, sound), (factor, untouched) = inflation(np.stack([A, A]), np.stack([r, 0.01 * r]), P, 4.5)
    assert sigmas == pytest.approx(np.sqrt(r @ np.linalg.solve(A @ P @ A.T + np.eye(5), r)))
    limited = r @ np.linalg.solve(A @ P @ A.T + factor * np.eye(5), r)
    assert np.sqrt(limited) == pytest.approx(4.5)
    assert sound == pytest.approx(0.01 * sigmas)
    assert untouched == 1.0


# ---------------------------------------------------------------- whole descents


def monte_carlo(world, estimator, runs, seed=100, **kwargs):
    out = []
    for run in range(runs):
        problem = draw(world, np.random.default_rng(seed + run), **kwargs)
        out.append(nees(estimator.estimate(problem), world))
    return np.array(out)


def test_the_filter_is_consistent(world):
    runs = 30
    samples = monte_carlo(world, ekf(), runs)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * runs) / runs
    for frame in (0, 1, 5, 10, 25, 50):
        assert low < samples[:, frame].mean() < high, frame
    assert 5.0 < samples[:, 1:].mean() < 7.0


def test_equation_29_fed_back_is_over_confident(world):
    samples = monte_carlo(world, DistributedEkf("x", dataclasses.replace(PLAIN, fusion="paper-fed-back")), 5)
    assert samples[:, -1].mean() > 30.0


def test_covariance_intersection_is_cautious(world):
    rule = dataclasses.replace(PLAIN, fusion="covariance-intersection")
    samples = monte_carlo(world, DistributedEkf("x", rule), 10)
    assert samples[:, 5:].mean() < 5.0


def test_paper_filter_survives_and_is_worse(world):
    rms = {}
    for estimator in (ekf(), ekf_paper(), DeadReckoning()):
        errors = [
            pose_errors(estimator.estimate(draw(world, np.random.default_rng(200 + run))), world)
            for run in range(5)
        ]
        rms[estimator.name] = np.sqrt(np.mean(np.array(errors)[:, -1, 3:] ** 2))
    assert rms["ekf"] < 0.3 * rms["ekf_paper"]
    assert rms["ekf_paper"] < 0.5 * rms["dead_reckoning"]


def test_dead_reckoning_knows_how_lost_it_is(world):
    runs = 40
    samples = monte_carlo(world, DeadReckoning(), runs)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * runs) / runs
    assert low < samples[:, -1].mean() < high


def test_first_entry_is_the_start_and_covariances_are_symmetric(problem):
    for estimator in (ekf(), ekf_paper(), DeadReckoning()):
        out = estimator.estimate(problem)
        np.testing.assert_array_equal(out.gTb[0], problem.start.gTb)
        np.testing.assert_array_equal(out.pose_covariance[0], problem.start.pose_covariance)
        np.testing.assert_array_equal(out.stamps_ns, [f.stamp_ns for f in problem.frames])
        for covariance in (out.pose_covariance, out.velocity_covariance, out.bias_covariance):
            np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
            assert np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize("fusion", ["exact", "paper", "paper-fed-back", "covariance-intersection"])
def test_frames_without_craters_predict_with_growing_covariance(world, problem, fusion):
    blind = [
        dataclasses.replace(f, rims=RimSet.empty()) if 10 <= k < 15 else f
        for k, f in enumerate(problem.frames)
    ]
    out = DistributedEkf("x", dataclasses.replace(PLAIN, fusion=fusion)).estimate(
        dataclasses.replace(problem, frames=blind)
    )
    volume = np.linalg.slogdet(out.pose_covariance)[1]
    assert np.all(np.diff(volume[9:15]) > 0)
    assert volume[15] < volume[14]
    assert np.isfinite(out.gTb).all()


def test_a_sub_filter_keeps_its_own_state_while_its_crater_is_in_view(world, problem):
    # One crater only, always the same: eq. (29) over one sub-filter is that filter, under every rule.
    frames_of_one = []
    for frame in problem.frames:
        rows = np.flatnonzero(frame.rims.craters == problem.frames[1].rims.craters[0])
        frames_of_one.append(dataclasses.replace(frame, rims=frame.rims.take(rows)))
    single = dataclasses.replace(problem, frames=frames_of_one[:8])
    outs = [
        DistributedEkf("x", dataclasses.replace(PLAIN, fusion=fusion)).estimate(single)
        for fusion in ("exact", "paper", "paper-fed-back", "covariance-intersection")
    ]
    for other in outs[1:]:
        np.testing.assert_allclose(other.gP, outs[0].gP, rtol=0, atol=1e-6)
        np.testing.assert_allclose(other.pose_covariance, outs[0].pose_covariance, rtol=1e-6, atol=1e-12)


def test_one_bad_rim_does_not_ruin_the_filter(world, problem):
    k = 20
    frame = problem.frames[k]
    chart = frame.rims.chart.copy()
    chart[0, :2] += 80 / FOCAL_PX
    spoilt = list(problem.frames)
    spoilt[k] = dataclasses.replace(frame, rims=dataclasses.replace(frame.rims, chart=chart))
    broken = dataclasses.replace(problem, frames=spoilt)
    clean = np.linalg.norm(pose_errors(ekf().estimate(problem), world)[k, 3:])
    robust = np.linalg.norm(pose_errors(ekf().estimate(broken), world)[k, 3:])
    limit = EkfOptions(gate_sigmas=None)
    limited = np.linalg.norm(pose_errors(DistributedEkf("x", limit).estimate(broken), world)[k, 3:])
    plain = np.linalg.norm(pose_errors(DistributedEkf("x", PLAIN).estimate(broken), world)[k, 3:])
    assert robust < clean + 20.0
    assert plain > 5 * robust
    assert limited < 0.5 * plain


def test_when_all_rims_disagree_the_gate_does_not_lock_the_filter_out(world):
    # A start ten of its sigmas off: the gate alone would refuse every rim for ever.
    problem = draw(world, np.random.default_rng(5), start_scale=0.1)
    T = problem.start.gTb.copy()
    T[:3, 3] += [0.0, 900.0, 0.0]
    lost = dataclasses.replace(problem, start=dataclasses.replace(problem.start, gTb=T))
    out = pose_errors(ekf().estimate(lost), world)
    assert np.linalg.norm(out[-1, 3:]) < 100.0


def test_iterations_help_a_rough_start(world):
    problems = [draw(world, np.random.default_rng(300 + k), start_scale=8.0) for k in range(10)]
    errors = {}
    for iterations in (1, 4):
        estimator = DistributedEkf("x", dataclasses.replace(PLAIN, iterations=iterations))
        errors[iterations] = np.median([nees(estimator.estimate(p), world)[1] for p in problems])
    assert errors[4] < 0.5 * errors[1]
