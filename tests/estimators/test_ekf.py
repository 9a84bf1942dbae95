"""The distributed filter: agreement with a central update, measurements, consistency."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.ekf.filter import DistributedEkf, EkfOptions, ekf, ekf_paper
from craternav_fg.estimators.ekf.fusion import fuse_updates
from craternav_fg.estimators.linearisation import LinearMeasurement, linearise_rims, linearise_sun
from craternav_fg.estimators.measurement_weighting import noise_inflation, with_predicted_covariances
from craternav_fg.measurements import RimSet, SunTilt
from factors.kernels import conic, sun
from tests.estimators.small_descent import (
    FOCAL_PX,
    draw,
    drawn,
    make_world,
    nees,
    pose_errors,
    rim_covariance,
)

PLAIN = EkfOptions(iterations=1, limit_sigmas=None, gate_sigmas=None)


@pytest.fixture(scope="module")
def world():
    return make_world()


@pytest.fixture(scope="module")
def problem(world):
    return draw(world, np.random.default_rng(11))


# ---------------------------------------------------------------- one central update


def central_update(state, frame, problem):
    """Stack all measurements and apply Joseph's form, in states scaled by their sigmas."""
    T, camera, catalog = state.gTb, problem.camera, problem.catalog
    frame = with_predicted_covariances(frame, T, camera, catalog)
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
        filter_state.states_to_start(problem)[-1],
        problem,
        problem.frames[0].stamp_ns,
        problem.frames[1].stamp_ns,
    )
    frame = problem.frames[1]
    assert len(frame.rims) >= 3
    delta, covariance = central_update(prior, frame, problem)
    expected = prior.corrected(delta, covariance)
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
    updates = [LinearMeasurement(a, b) for a, b in zip(A, r, strict=True)]
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
        moved = state.corrected(delta, np.outer(e, e) * 1e12)
        left = state.corrected(delta + e, np.eye(18)).minus(state.corrected(delta - e, np.eye(18))) / 2e-6
        np.testing.assert_allclose(moved.covariance, np.outer(left, left), atol=1e-3)


# ---------------------------------------------------------------- measurements


@pytest.mark.parametrize("noise", ["measured", "fixed"])
def test_eq19_and_chart_measurements_agree_near_the_truth(world, problem, noise):
    # EQUATIONS: whitened by its own covariance, (19) is the conic residual: same information, same sign.
    frame = problem.frames[3]
    rng = np.random.default_rng(0)
    T = world.gTb[3].copy()
    T[:3, 3] += rng.normal(size=3)  # one metre
    T[:3, :3] = T[:3, :3] @ frames.rotation_exp(1e-5 * rng.normal(size=3))
    exact = RimSet(*world.seen[3], frame.rims.covariance)
    forms = [
        linearise_rims(T, exact, problem.camera, problem.catalog, model=model, noise=noise)
        for model in ("chart", "eq19")
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
    for model in ("chart", "eq19"):
        samples = []
        for _ in range(300):
            y = drawn(charts, S, rng)
            _, r, _ = linearise_rims(
                T, RimSet(rows, y, S), problem.camera, problem.catalog, model=model, noise="measured"
            )
            samples.append(r)
        squared = np.sum(np.array(samples) ** 2, axis=2)
        assert squared.mean() == pytest.approx(5.0, abs=5 * np.sqrt(10.0 / squared.size))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"measurement": "implicit"}, "measurement: expected one of chart, .*, found 'implicit'"),
        ({"noise": "own"}, "noise: expected one of measured, fixed, found 'own'"),
        ({"fusion": "mean"}, "fusion: expected one of paper, .*, found 'mean'"),
        ({"iterations": 0}, "iterations: expected 1 or more, found 0"),
        ({"limit_sigmas": 0.0}, "limit_sigmas: expected a positive number"),
        ({"gate_sigmas": float("nan")}, "gate_sigmas: expected a positive number"),
        ({"variance_inflation": 0.0}, "variance_inflation: expected a positive number"),
    ],
)
def test_wrong_options_are_refused(wrong, says):
    with pytest.raises(EstimationError, match=says):
        EkfOptions(**wrong)


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
    scales = np.array([1.0, 0.01, 1e4, 1e9])
    sigmas, factors = noise_inflation(np.stack([A] * 4), scales[:, None] * r, P, 4.5)
    assert sigmas == pytest.approx(scales * np.sqrt(r @ np.linalg.solve(A @ P @ A.T + np.eye(5), r)))
    assert factors[1] == 1.0
    for k in (0, 2, 3):
        left = scales[k] * r
        limited = left @ np.linalg.solve(A @ P @ A.T + factors[k] * np.eye(5), left)
        assert np.sqrt(limited) == pytest.approx(4.5)


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


def test_published_state_is_equation_29_over_the_sub_filters(world):
    # In the first update all sub-filters still share a prior: fed back or not, eq. (29) says the same, up
    # to the attitudes' curvature, which a good start makes small.
    problem = draw(world, np.random.default_rng(11), start_scale=0.05)
    two = dataclasses.replace(problem, frames=problem.frames[:2])
    outs = [
        DistributedEkf("x", dataclasses.replace(PLAIN, fusion=fusion)).estimate(two)
        for fusion in ("paper", "paper-fed-back")
    ]
    sigma = np.sqrt(np.diag(outs[1].pose_covariance[1]))
    np.testing.assert_allclose((outs[0].gP[1] - outs[1].gP[1]) / sigma[3:], 0.0, atol=0.002)
    np.testing.assert_allclose(
        outs[0].pose_covariance[1] / np.outer(sigma, sigma),
        outs[1].pose_covariance[1] / np.outer(sigma, sigma),
        atol=0.002,
    )


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
    # A start many of its sigmas off: the gate alone would refuse every rim for ever.
    problem = draw(world, np.random.default_rng(5), start_scale=0.1)
    T = problem.start.gTb.copy()
    T[:3, 3] += [0.0, 1500.0, 0.0]
    lost = dataclasses.replace(problem, start=dataclasses.replace(problem.start, gTb=T))
    out = pose_errors(ekf().estimate(lost), world)
    assert np.linalg.norm(out[-1, 3:]) < 300.0  # 2 km when locked out


def test_iterations_help_a_rough_start(world):
    problems = [draw(world, np.random.default_rng(300 + k), start_scale=8.0) for k in range(10)]
    errors = {}
    for iterations in (1, 4):
        estimator = DistributedEkf("x", dataclasses.replace(PLAIN, iterations=iterations))
        errors[iterations] = np.median([nees(estimator.estimate(p), world)[1] for p in problems])
    assert errors[4] < 0.5 * errors[1]


def test_iterated_update_reaches_the_maximum_a_posteriori_state(world):
    # The same cost by another road: scipy's minimiser with numerical derivatives over all 18 states.
    problem = draw(world, np.random.default_rng(42), start_scale=20.0)
    frame = problem.frames[1]
    prior = filter_state.propagate(
        filter_state.states_to_start(problem)[-1], problem, problem.frames[0].stamp_ns, frame.stamp_ns
    )
    scale = np.sqrt(np.diag(prior.covariance))
    root = np.linalg.cholesky(prior.covariance / np.outer(scale, scale))
    rims = with_predicted_covariances(frame, prior.gTb, problem.camera, problem.catalog).rims
    white = np.linalg.inv(np.linalg.cholesky(rims.covariance))
    rows = frame.rims.craters

    def residuals(x):
        T = prior.corrected(scale * (root @ x), prior.covariance).gTb
        y, _ = conic.project_rims(
            T, problem.camera.bTc, problem.catalog.centres[rows], problem.catalog.axes[rows]
        )
        tilt, _ = sun.sun_tilt(T, problem.camera.bTc, frame.sun.direction, 0.0, 0.0, np.zeros((1, 6)))
        rims = np.einsum("nij,nj->ni", white, frame.rims.chart - y).ravel()
        return np.concatenate([x, rims, [sun.wrap(frame.sun.tilt_rad - tilt) / frame.sun.sigma_rad]])

    best = least_squares(residuals, np.zeros(18), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    expected = prior.corrected(scale * (root @ best.x), prior.covariance)
    assert np.linalg.norm(expected.minus(prior)[:3]) > np.radians(3.0)
    estimator = DistributedEkf("x", dataclasses.replace(PLAIN, iterations=12))
    out = estimator.estimate(dataclasses.replace(problem, frames=problem.frames[:2]))
    sigma = np.sqrt(np.diag(out.pose_covariance[1]))
    phi = frames.rotation_log(expected.gTb[:3, :3].T @ out.gRb[1])
    np.testing.assert_allclose(phi / sigma[:3], 0.0, atol=1e-6)
    np.testing.assert_allclose((out.gP[1] - expected.gTb[:3, 3]) / sigma[3:], 0.0, atol=1e-6)


def test_a_new_sub_filter_does_not_inherit_a_past_that_was_counted_twice(world):
    """Craters that take turns make every sub-filter a newcomer: (29) must not feed back through them."""

    def taking_turns(estimator, seed):
        p = draw(world, np.random.default_rng(seed))
        frames = [
            dataclasses.replace(f, rims=f.rims.take(f.rims.craters % 2 == k % 2))
            for k, f in enumerate(p.frames)
        ]
        return nees(estimator.estimate(dataclasses.replace(p, frames=frames)), world)[-1]

    apart = DistributedEkf("x", dataclasses.replace(PLAIN, fusion="paper"))
    together = DistributedEkf("x", dataclasses.replace(PLAIN, fusion="paper-fed-back"))
    values = [np.mean([taking_turns(e, 300 + run) for run in range(4)]) for e in (apart, together)]
    assert values[0] < 30.0 < values[1]


def test_a_frame_with_the_sun_alone_still_measures_it(world, problem):
    with_sun = DistributedEkf("x", PLAIN)
    only_sun = [problem.frames[0]] + [dataclasses.replace(f, rims=RimSet.empty()) for f in problem.frames[1:]]
    nothing = [dataclasses.replace(f, sun=None) for f in only_sun]
    spread = [
        np.trace(with_sun.estimate(dataclasses.replace(problem, frames=f)).pose_covariance[-1, :3, :3])
        for f in (only_sun, nothing)
    ]
    assert spread[0] < spread[1]
