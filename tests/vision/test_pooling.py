"""Rims on rough ground get the covariances of their crater, pooled over frames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.measurements import RimQuality, RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes
from craternav_fg.vision.error_model.pooling import PooledErrors
from factors.kernels.conic import project_rims
from tests.vision import scene

CRATERS, FRAMES = 8, 24
# Standard deviations on the ground, in radii, of the time-correlated and the white error.
CORRELATED, WHITE = 0.008, 0.006


@pytest.fixture(scope="module")
def view():
    """Catalogue, camera, pose."""
    catalog = scene.craters(np.random.default_rng(3)).take(np.arange(CRATERS))
    return catalog, scene.camera(), scene.pose(0.0, 10.0)


def frame(view, claims, chart=None, outline=0.02):
    """Rims that claim `claims` (n,) times their standard deviations."""
    catalog, camera, gTb = view
    rows = np.arange(CRATERS)
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    correlated = CORRELATED * claims[:, None, None] * slopes
    covariance = (CORRELATED**2 + WHITE**2) * claims[:, None, None] ** 2 * slopes @ np.swapaxes(slopes, 1, 2)
    same = np.ones(CRATERS)
    quality = RimQuality(same, same, same, same, outline * same)
    if chart is None:
        chart = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    return RimSet(rows, chart, covariance, quality, correlated, shared=np.zeros((CRATERS, 5, 8)))


def common_shift(view, frames):
    """Estimate an error (5,) common to all rims beside the correlated ones, and its covariance."""
    catalog, camera, gTb = view
    slopes = in_plane_slopes(np.arange(CRATERS), gTb, camera, catalog)
    truth = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    size = 5 + 5 * CRATERS
    N, b = np.diag([1e-6] * 5 + [1.0] * (size - 5)), np.zeros(size)
    for rims in frames:
        for i in range(CRATERS):
            H = np.zeros((5, size))
            H[:, :5], H[:, 5 + 5 * i : 10 + 5 * i] = slopes[i], rims.correlated[i]
            weighted = np.linalg.solve(rims.uncorrelated_covariance[i], H).T
            N += weighted @ H
            b += weighted @ (rims.chart[i] - truth[i])
    P = np.linalg.inv(N)
    return (P @ b)[:5], P[:5, :5]


def test_pooled_covariances_are_consistent_where_the_claims_scatter(view):
    """The variances that single frames claim are right on average, and scatter by a factor of e."""
    catalog, camera, gTb = view
    rng = np.random.default_rng(4)
    slopes = in_plane_slopes(np.arange(CRATERS), gTb, camera, catalog)
    truth = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    trials = 40
    squared = {"claimed": 0.0, "pooled": 0.0}
    for _ in range(trials):
        correlated = CORRELATED * rng.normal(size=(CRATERS, 5))
        claimed = []
        for _ in range(2 * FRAMES):
            error = correlated + WHITE * rng.normal(size=(CRATERS, 5))
            chart = truth + np.einsum("nij,nj->ni", slopes, error)
            variance = np.exp(rng.normal(-0.5, 1.0, CRATERS))
            claimed.append(frame(view, np.sqrt(variance), chart))
        pooled = PooledErrors(camera, catalog)
        for name, frames in (("claimed", claimed), ("pooled", [pooled.pool(rims, gTb) for rims in claimed])):
            # The first frames only fill the pool.
            shift, P = common_shift(view, frames[FRAMES:])
            squared[name] += shift @ np.linalg.solve(P, shift)
    low, high = chi2.ppf([0.001, 0.999], 5 * trials)
    assert low < squared["pooled"] < high
    assert squared["claimed"] > 5.0 * high


def test_a_pool_is_a_mean_over_frames_and_a_larger_white_claim_is_kept(view):
    catalog, camera, gTb = view
    pooled = PooledErrors(camera, catalog)
    same = np.ones(CRATERS)
    for _ in range(20):
        pooled.pool(frame(view, same), gTb)
    odd = same.copy()
    odd[0], odd[1] = 4.0, 0.25
    claimed = frame(view, odd)
    got = pooled.pool(claimed, gTb)
    plain = frame(view, same)
    covariances = [rims.uncorrelated_covariance for rims in (got, claimed, plain)]
    size = [np.sqrt(np.trace(C, axis1=1, axis2=2)) for C in covariances]
    assert size[0][0] == pytest.approx(size[1][0], rel=1e-6)
    assert size[0][1] == pytest.approx(size[2][1], rel=0.05)
    variance = (got.correlated**2).sum(axis=(1, 2)) / (plain.correlated**2).sum(axis=(1, 2))
    # Sixteen times the variance in one frame of 21, beside a prior worth a few frames.
    assert 15.0 / 25.0 < variance[0] - 1.0 < 15.0 / 21.0
    np.testing.assert_allclose(variance[2:], 1.0, rtol=1e-6)


def test_errors_of_the_map_are_not_pooled(view):
    catalog, camera, gTb = view
    same = np.ones(CRATERS)
    A = 1e-3 * np.random.default_rng(1).standard_normal((CRATERS, 5, 6))
    bare = frame(view, same)
    wider = replace(bare, covariance=bare.covariance + A @ np.swapaxes(A, 1, 2), of_map=A)
    got = []
    for rims in (bare, wider):
        pooled = PooledErrors(camera, catalog)
        pooled.pool(replace(rims, chart=rims.chart), gTb)
        got.append(pooled.pool(rims, gTb))
    assert got[1].of_map is A
    np.testing.assert_allclose(
        got[1].covariance - got[0].covariance, A @ np.swapaxes(A, 1, 2), rtol=1e-6, atol=1e-12
    )


def test_rims_that_are_ellipses_stay_as_they_are(view):
    catalog, camera, gTb = view
    claimed = frame(view, np.linspace(0.3, 3.0, CRATERS), outline=0.001)
    assert PooledErrors(camera, catalog).pool(claimed, gTb) is claimed
    bare = replace(claimed, quality=None)
    assert PooledErrors(camera, catalog).pool(bare, gTb) is bare


def test_a_rim_seen_much_larger_is_remembered_less(view):
    catalog, camera, gTb = view
    same = np.ones(CRATERS)
    sizes = []
    for growth in (0.0, 4.0):
        pooled = PooledErrors(camera, catalog)
        for _ in range(20):
            pooled.pool(frame(view, 5.0 * same), gTb)
        rims = frame(view, same)
        chart = rims.chart.copy()
        chart[:, [2, 4]] += growth
        sizes.append(np.linalg.norm(pooled.pool(replace(rims, chart=chart), gTb).correlated[0]))
    assert sizes[1] < 0.7 * sizes[0]


def test_the_white_part_of_estimators_is_pooled_as_the_rims_own(view):
    """A frame that scatters less than those before does not make its rims count for more at once."""
    catalog, camera, gTb = view
    pooled = PooledErrors(camera, catalog)
    plain = frame(view, np.ones(CRATERS))

    def inflated(factors):
        return replace(plain, fused_white=factors[:, None, None] * plain.uncorrelated_covariance)

    for _ in range(20):
        pooled.pool(inflated(np.full(CRATERS, 5.0)), gTb)
    calm = np.ones(CRATERS)
    calm[0] = 9.0
    got = pooled.pool(inflated(calm), gTb)
    np.testing.assert_allclose(got.covariance, plain.covariance, rtol=1e-6, atol=1e-18)
    ratio = np.trace(got.fused_white @ np.linalg.inv(plain.uncorrelated_covariance), axis1=1, axis2=2) / 5.0
    assert ratio[0] == pytest.approx(9.0, rel=1e-6)
    # Of 21 frames and a prior of two, one does not scatter.
    np.testing.assert_allclose(ratio[1:], 5.0 - 4.0 / 23.0, rtol=1e-3)
    assert pooled.pool(plain, gTb).fused_white is None
