import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from craternav_fg.camera import Camera
from craternav_fg.ellipse import normalised_chart, pixel_chart
from craternav_fg.vision.ellipse_fit import (
    BrightnessUnknown,
    FitFailure,
    FitOptions,
    RimFit,
    fit_rim,
    refine_rim,
)
from craternav_fg.vision.error_model.systematic import floor_covariance

CAMERA = Camera(1024, 1024, 1267.0, 1267.0, 511.5, 511.5)
WIDE = Camera(1024, 768, 1267.0, 1100.0, 500.0, 400.0)
BARE = FitOptions(floor_px=0.0, floor_share=0.0)
FULL = (0.0, 2.0 * np.pi)


def rim(a, b, turn, count=60, arc=FULL, centre=(300.0, 420.0)):
    """Points (n, 2) of an ellipse and its normals there."""
    t = np.linspace(*arc, count, endpoint=False)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    normals = np.column_stack([np.cos(t) / a, np.sin(t) / b])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([a * np.cos(t), b * np.sin(t)]) @ R.T + centre, normals @ R.T


def chart_of(a, b, turn, camera, centre=(300.0, 420.0)):
    """Chart from the covariance of the rim's points, independent of the fit."""
    points, _ = rim(a, b, turn, 4096, centre=centre)
    u = (points - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
    S = 2.0 * np.cov(u.T, bias=True)
    return np.array(
        [*u.mean(axis=0), 0.5 * np.log(S[0, 0]), S[0, 1] / S[0, 0],
         0.5 * np.log(S[1, 1] - S[0, 1] ** 2 / S[0, 0])]
    )  # fmt: skip


def monte_carlo(rng, a, b, turn, sigma_px, runs, arc=FULL):
    points, normals = rim(a, b, turn, arc=arc)
    truth = chart_of(a, b, turn, CAMERA)
    errors, covariances = [], []
    for _ in range(runs):
        fit = fit_rim(points + normals * rng.normal(0.0, sigma_px, (len(points), 1)), CAMERA, BARE)
        if isinstance(fit, RimFit):
            errors.append(fit.chart - truth)
            covariances.append(fit.covariance)
    return np.array(errors), np.array(covariances)


@settings(max_examples=60, deadline=None)
@given(
    b=st.floats(6.0, 150.0), ratio=st.floats(1.0, 2.5), turn=st.floats(0.0, np.pi),
    x=st.floats(0.0, 1000.0), y=st.floats(0.0, 700.0),
)  # fmt: skip
def test_perfect_points_give_their_ellipse_under_unequal_focal_lengths(b, ratio, turn, x, y):
    points, _ = rim(ratio * b, b, turn, centre=(x, y))
    fit = fit_rim(points, WIDE)
    assert isinstance(fit, RimFit)
    np.testing.assert_allclose(
        fit.chart, chart_of(ratio * b, b, turn, WIDE, (x, y)), atol=2e-6 * max(1.0, b / 10.0)
    )
    assert fit.arc_share == 1.0
    assert fit.point_count == 60
    np.testing.assert_allclose(pixel_chart(fit.chart, WIDE), fit.chart_px, rtol=1e-9, atol=1e-9)


def test_scatter_is_that_of_the_points():
    """Every other point outside by as much as the others are inside: no ellipse follows them."""
    points, normals = rim(50.0, 40.0, 0.3)
    fit = fit_rim(points + 0.2 * normals * np.resize([1.0, -1.0], (60, 1)), CAMERA, BARE)
    assert fit.rms_px == pytest.approx(0.2, rel=1e-3)


def squared_distances(errors, covariances):
    """Of estimates from truth (n,), by their covariances."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


@pytest.mark.parametrize(
    ("a", "b", "turn", "sigma_px", "bound"),
    [
        (8.0, 8.0, 0.0, 1.0, 0.05),
        (13.0, 8.0, 0.6, 1.0, 0.05),
        (26.0, 8.0, 2.0, 1.0, 0.05),
        (120.0, 40.0, 0.3, 1.0, 0.02),
        # Where the expansion that is subtracted is complete to the eye: each of its terms shows.
        (26.0, 8.0, 0.6, 0.3, 0.012),
        (50.0, 15.0, 0.6, 0.3, 0.008),
        (30.0, 25.0, 2.5, 0.3, 0.008),
    ],
)
def test_no_component_of_the_chart_is_biased(a, b, turn, sigma_px, bound):
    """In standard deviations, of pairs with opposite errors: what is of odd order cancels in each."""
    rng = np.random.default_rng(4)
    points, normals = rim(a, b, turn)
    truth = chart_of(a, b, turn, CAMERA)
    means = []
    for _ in range(1000):
        e = normals * rng.normal(0.0, sigma_px, (len(points), 1))
        ends = [fit_rim(points + sign * e, CAMERA, BARE) for sign in (1.0, -1.0)]
        means.append(np.mean([(f.chart - truth) / np.sqrt(np.diag(f.covariance)) for f in ends], axis=0))
    # The Monte Carlo's own standard deviation is up to 0.006 at a pixel, 0.0015 at 0.3.
    assert np.max(np.abs(np.mean(means, axis=0))) < bound


def test_chi_square_at_truth():
    """Of full rims with 60 points; every fit converges."""
    rng = np.random.default_rng(5)
    runs = 2000
    pooled = []
    for a, b, turn, sigma_px in [
        (15.0, 15.0, 0.0, 1.0), (25.0, 15.0, 0.6, 0.3), (50.0, 15.0, 2.0, 1.0), (40.0, 40.0, 0.0, 0.5),
        (120.0, 40.0, 1.0, 0.3), (300.0, 100.0, 0.3, 1.0),
    ]:  # fmt: skip
        errors, covariances = monte_carlo(rng, a, b, turn, sigma_px, runs)
        assert len(errors) == runs
        distance2 = squared_distances(errors, covariances)
        # The Monte Carlo's own standard deviation is 0.016.
        assert 0.95 < distance2.mean() / 5.0 < 1.10
        pooled.append(distance2)
    assert 0.97 < np.mean(pooled) / 5.0 < 1.05
    # A little under 0.95: with the scatter estimated from 60 points the tail is that of an F distribution.
    assert 0.925 < np.mean(np.array(pooled) < chi2.ppf(0.95, 5)) < 0.955


@pytest.mark.parametrize(("a", "b", "turn"), [(8.0, 8.0, 0.0), (12.0, 8.0, 0.6)])
def test_small_ellipses_are_consistent(a, b, turn):
    errors, covariances = monte_carlo(np.random.default_rng(5), a, b, turn, 0.5, 2000)
    assert len(errors) == 2000
    distance2 = squared_distances(errors, covariances)
    assert 0.9 < distance2.mean() / 5.0 < 1.1
    assert np.mean(distance2 < chi2.ppf(0.95, 5)) > 0.925


def test_half_a_rim_is_consistent():
    errors, covariances = monte_carlo(np.random.default_rng(6), 45.0, 38.0, 0.4, 0.3, 1500, arc=(0.5, 3.9))
    assert len(errors) == 1500
    assert 0.9 < squared_distances(errors, covariances).mean() / 5.0 < 1.1


def test_outliers_do_not_move_the_ellipse():
    rng = np.random.default_rng(7)
    points, normals = rim(40.0, 33.0, 1.1, 80)
    points = points + normals * rng.normal(0.0, 0.2, (80, 1))
    clean = fit_rim(points, CAMERA, BARE)
    wrong = [10, 11, 12, 13, 14, 15, 27, 39, 48, 60, 69]
    points[wrong] += rng.uniform(4.0, 8.0, (11, 1)) * rng.choice([-1.0, 1.0], (11, 1)) * normals[wrong]
    spoilt = fit_rim(points, CAMERA, BARE)
    assert isinstance(clean, RimFit)
    assert isinstance(spoilt, RimFit)
    assert spoilt.point_count <= 69
    sigma = np.sqrt(np.diag(spoilt.covariance))
    assert np.all(np.abs(spoilt.chart - clean.chart) < 1.5 * sigma)


def test_errors_shared_by_neighbours_enlarge_the_covariance():
    rng = np.random.default_rng(8)
    points, normals = rim(40.0, 36.0, 0.0, 96)
    white = rng.normal(size=(400, 96))
    shared = np.repeat(rng.normal(size=(400, 24)), 4, axis=1)
    sizes = []
    for noise in (white, shared):
        fits = [fit_rim(points + 0.3 * e[:, None] * normals, CAMERA, BARE) for e in noise]
        sizes.append(np.mean([f.covariance[0, 0] for f in fits if isinstance(f, RimFit)]))
    assert 1.7 < sizes[1] / sizes[0] < 4.5


def test_uncertain_points_count_less():
    rng = np.random.default_rng(9)
    points, normals = rim(30.0, 26.0, 0.3)
    ratio = np.where(np.arange(60) % 2 == 0, 1.0, 10.0)
    truth = chart_of(30.0, 26.0, 0.3, CAMERA)
    plain, weighed = [], []
    for _ in range(200):
        noisy = points + normals * (0.1 * ratio * rng.normal(size=60))[:, None]
        for fit, out in ((fit_rim(noisy, CAMERA), plain), (fit_rim(noisy, CAMERA, None, ratio), weighed)):
            assert isinstance(fit, RimFit)
            out.append(fit.chart - truth)
    assert np.std(weighed, axis=0)[2] < 0.6 * np.std(plain, axis=0)[2]


def test_an_unknown_common_motion_of_the_points_is_estimated():
    rng = np.random.default_rng(10)
    points, normals = rim(30.0, 25.0, 0.2, 80)
    side = normals @ [0.6, 0.8]
    keep = np.abs(side) > 0.15
    # What a wrong reference brightness does to crossings: the smaller the slope across the rim, the farther
    # they move.
    motion = (normals / side[:, None])[keep]
    points = points[keep] + 0.3 * motion + normals[keep] * rng.normal(0.0, 0.05, (np.count_nonzero(keep), 1))
    start = pixel_chart(chart_of(30.0, 25.0, 0.2, CAMERA), CAMERA)
    ones = np.ones(len(points))
    truth = start[:2]
    without = refine_rim(points, start, CAMERA, BARE, ones)
    with_unknown = refine_rim(points, start, CAMERA, BARE, ones, BrightnessUnknown(motion, 1.0))
    assert isinstance(without, RimFit)
    assert isinstance(with_unknown, RimFit)
    assert np.hypot(*(without.chart_px[:2] - truth)) > 0.25
    assert np.hypot(*(with_unknown.chart_px[:2] - truth)) < 0.08


def test_a_slope_of_that_motion_is_in_the_covariance():
    """A large rim's shape shows how the brightness changes across the sun direction, but not along it."""
    rng = np.random.default_rng(12)
    points, normals = rim(110.0, 100.0, 0.2, 120)
    sun_px = np.array([0.6, 0.8])
    side = normals @ sun_px
    keep = np.abs(side) > 0.15
    place = ((points - points.mean(axis=0)) / 105.0)[keep]
    motion = 20.0 * (normals / side[:, None])[keep]
    truth = chart_of(110.0, 100.0, 0.2, CAMERA)
    start = pixel_chart(truth, CAMERA)
    blind, knowing, too_sure, consistent = [], [], [], []
    for _ in range(100):
        slope = place @ rng.normal(0.0, 0.01, 2)
        off = rng.normal(0.0, 0.08, (len(motion), 1))
        moved = points[keep] + slope[:, None] * motion + normals[keep] * off
        args = (moved, start, CAMERA, BARE, np.abs(1.0 / side[keep]))
        even, sloping = BrightnessUnknown(motion, 0.02), BrightnessUnknown(motion, 0.02, 0.01, sun_px)
        for fit, errors, distances in (
            (refine_rim(*args, even), blind, too_sure), (refine_rim(*args, sloping), knowing, consistent)
        ):  # fmt: skip
            assert isinstance(fit, RimFit)
            error = fit.chart - truth
            errors.append(error)
            distances.append(error @ np.linalg.solve(fit.covariance, error) / 5.0)
    assert np.mean(too_sure) > 3.0
    assert 0.7 < np.mean(consistent) < 1.3
    assert np.std(knowing, axis=0)[3] < 0.7 * np.std(blind, axis=0)[3]


def outlined(rng, rms, arc, last=20, fall=1.5, count=90):
    """Points of an ellipse whose radius has harmonics from 3 on; the fit expects another spectrum."""
    points, normals = rim(30.0, 24.0, 0.4, count, arc)
    t, k = np.linspace(*arc, count, endpoint=False), np.arange(3, last + 1)
    scale = rms * k**-fall / np.linalg.norm(k**-fall)
    share = np.cos(np.outer(t, k)) @ (scale * rng.normal(size=len(k)))
    share += np.sin(np.outer(t, k)) @ (scale * rng.normal(size=len(k)))
    centre = [300.0, 420.0]
    return (points - centre) * (1.0 + share[:, None]) + centre + normals * rng.normal(0.0, 0.1, (count, 1))


def outline_fits(rms, share, arc):
    """Errors (n, 5), squared distances over 5 and estimated deviations of rims fitted from their truth."""
    truth = chart_of(30.0, 24.0, 0.4, CAMERA)
    options = FitOptions(floor_px=0.0, floor_share=0.0, outline_share=share)
    rng = np.random.default_rng(13)
    fits = [
        refine_rim(outlined(rng, rms, arc), pixel_chart(truth, CAMERA), CAMERA, options, np.ones(90))
        for _ in range(150)
    ]
    good = [f for f in fits if isinstance(f, RimFit)]
    assert len(good) >= 148
    e = np.array([f.chart for f in good]) - truth
    C = np.array([f.covariance for f in good])
    distance2 = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0]) / 5.0
    return e, distance2, np.array([f.outline_share for f in good])


@pytest.mark.parametrize("arc", [FULL, (0.3, 5.7), (0.3, 4.9)])
def test_outlines_that_are_no_ellipses(arc):
    """The part of a rim that is not seen is as uncertain as the seen part deviates."""
    plain, too_sure, none = outline_fits(0.03, 0.0, arc)
    e, distance2, shares = outline_fits(0.03, 0.003, arc)
    better = np.mean(e**2, axis=0) / np.mean(plain**2, axis=0)
    assert np.all(better[:4] < 0.85)
    assert better[4] < 1.05
    assert np.mean(distance2) < 2.2
    assert np.median(distance2) > 0.2
    assert 0.02 < np.median(shares) < 0.035
    assert np.all(none == 0.0)
    if arc != FULL:
        assert np.mean(too_sure) > np.mean(distance2)


@pytest.mark.parametrize(("count", "outliers"), [(18, 0), (20, 0), (22, 0), (28, 6)])
def test_an_outline_through_few_points_is_not_taken_for_exact(count, outliers):
    """As many harmonics as points leave no scatter, of which the covariance would be made."""
    truth = chart_of(30.0, 24.0, 0.4, CAMERA)
    options = FitOptions(floor_px=0.0, floor_share=0.0, outline_share=0.0003)
    rng = np.random.default_rng(14)
    distance2, views = [], 200
    for _ in range(views):
        points = outlined(rng, 0.03, FULL, count=count)
        wrong = rng.choice(count, outliers, replace=False)
        off = rng.uniform(10.0, 15.0, (outliers, 1)) * rng.choice([-1.0, 1.0], (outliers, 1))
        points[wrong] += off * rim(30.0, 24.0, 0.4, count)[1][wrong]
        fit = refine_rim(points, pixel_chart(truth, CAMERA), CAMERA, options, np.ones(count))
        if isinstance(fit, RimFit):
            error = fit.chart - truth
            distance2.append(error @ np.linalg.solve(fit.covariance, error) / 5.0)
    assert len(distance2) > 0.8 * views
    assert np.mean(distance2) < 3.0
    assert np.mean(np.array(distance2) > 10.0) < 0.06


def test_rims_that_are_ellipses_lose_little_by_an_outline():
    (plain, _, _), (free, distance2, shares) = (outline_fits(0.0, share, FULL) for share in (0.0, 0.003))
    assert np.all(np.std(free, axis=0) < 1.1 * np.std(plain, axis=0))
    assert 0.6 < np.mean(distance2) < 1.3
    assert np.median(shares) < 0.006


def test_what_does_not_determine_an_ellipse_is_refused():
    rng = np.random.default_rng(11)
    points, normals = rim(30.0, 25.0, 0.2, 60)
    assert fit_rim(points[:8], CAMERA) is FitFailure.TOO_FEW_POINTS
    few, lax = points[::7] + normals[::7] * rng.normal(0.0, 0.1, (9, 1)), FitOptions(8, max_gap_rad=1.0)
    assert fit_rim(few, CAMERA, lax) is FitFailure.NO_ELLIPSE
    short, _ = rim(30.0, 25.0, 0.2, 60, arc=(0.0, 1.9))
    assert fit_rim(short, CAMERA) in (FitFailure.SHORT_ARC, FitFailure.NO_ELLIPSE)
    line = np.column_stack([np.linspace(0.0, 100.0, 40), np.linspace(3.0, 60.0, 40)])
    for jitter in (0.0, 0.3):
        assert isinstance(fit_rim(line + rng.normal(0.0, 1.0, line.shape) * jitter, CAMERA), FitFailure)
    assert isinstance(fit_rim(np.full((40, 2), 7.0), CAMERA), FitFailure)
    assert isinstance(fit_rim(points + normals * rng.normal(0.0, 15.0, (60, 1)), CAMERA), FitFailure)


def test_floor_displaces_the_rim_by_its_size():
    """Charts drawn from the floor: centre, axes and the shape's turn scatter by the floor's length."""
    rng = np.random.default_rng(12)
    for a, b, turn in [(30.0, 30.0, 0.0), (40.0, 25.0, 0.7)]:
        y = pixel_chart(chart_of(a, b, turn, CAMERA), CAMERA)
        cov = floor_covariance(y, 0.1, 0.002)
        length = 0.1 + 0.002 * b
        draws = rng.multivariate_normal(y, cov, 20000)
        sxx = np.exp(2.0 * draws[:, 2])
        sxy = draws[:, 3] * sxx
        S = np.stack([sxx, sxy, sxy, np.exp(2.0 * draws[:, 4]) + draws[:, 3] * sxy], axis=-1).reshape(
            -1, 2, 2
        )
        np.testing.assert_allclose(np.std(draws[:, :2], axis=0), length, rtol=0.03)
        c = np.array([np.cos(turn), np.sin(turn)])
        d = np.array([-np.sin(turn), np.cos(turn)])
        reach = [np.sqrt(np.einsum("i,nij,j->n", e, S, e)) for e in (c, d)]
        np.testing.assert_allclose([np.std(r) for r in reach], length, rtol=0.05)
        # Half-way between the axes a circle's radius scatters as on them.
        if a == b:
            e = (c + d) / np.sqrt(2.0)
            np.testing.assert_allclose(np.std(np.sqrt(np.einsum("i,nij,j->n", e, S, e))), length, rtol=0.05)


def test_chart_conversion_is_that_of_the_points():
    for camera in (CAMERA, WIDE):
        y = chart_of(33.0, 21.0, 1.0, camera)
        pixels = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
        chart_px = chart_of(33.0, 21.0, 1.0, pixels)
        np.testing.assert_allclose(normalised_chart(chart_px, camera)[0], y, atol=1e-9)
        np.testing.assert_allclose(pixel_chart(y, camera), chart_px, atol=1e-7)


def brightness_fits(rms, share):
    """Covariances and brightness roots of rims whose points a wrong reference brightness moves, too."""
    sun_px = np.array([0.6, 0.8])
    truth = chart_of(30.0, 24.0, 0.4, CAMERA)
    options = FitOptions(floor_px=0.0, floor_share=0.0, outline_share=share)
    rng = np.random.default_rng(14)
    _, normals = rim(30.0, 24.0, 0.4, 90)
    side = normals @ sun_px
    keep = np.abs(side) > 0.15
    motion = 20.0 * (normals / side[:, None])[keep]
    unknown = BrightnessUnknown(motion, 0.02)
    fits = []
    for _ in range(150):
        points = outlined(rng, rms, FULL)[keep] + 0.015 * rng.normal() * motion
        start = pixel_chart(truth, CAMERA)
        fits.append(refine_rim(points, start, CAMERA, options, np.abs(1.0 / side[keep]), unknown))
    good = [f for f in fits if isinstance(f, RimFit)]
    assert len(good) >= 148
    return np.array([f.covariance for f in good]), np.array([f.errors.brightness_root for f in good])


def test_an_irregular_outline_leaves_the_reference_brightness_uncertain():
    """In proportion to its deviation, along the illumination direction, and within the whole covariance."""
    sun_px = np.array([0.6, 0.8])
    covariances, roots = brightness_fits(0.02, 0.003)
    along = np.abs(roots[:, :2] @ sun_px)
    assert np.all(np.abs(roots[:, :2] @ [-sun_px[1], sun_px[0]]) < 0.3 * along)
    # A relative error of 0.01 moves the points by 0.2 px or more.
    assert 0.2 < np.median(along) * CAMERA.fx_px < 0.4
    rest = covariances - roots[:, :, None] * roots[:, None, :]
    assert np.linalg.eigvalsh(rest)[:, 0].min() > 0.0
    _, none = brightness_fits(0.0, 0.0003)
    assert np.median(np.abs(none[:, :2] @ sun_px)) < 0.1 * np.median(along)
