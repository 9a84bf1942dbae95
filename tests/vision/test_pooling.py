"""Rims of rough ground are given the covariances that they usually have."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.measurements import RimQuality, RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes
from craternav_fg.vision.error_model.pooling import PooledErrors
from factors.kernels.conic import project_rims
from tests.vision import scene

CRATERS, FRAMES = 8, 24
# On the ground, in radii: what lasts, what does not.
LASTING, WHITE = 0.008, 0.006


@pytest.fixture(scope="module")
def view():
    """Catalogue, camera, pose."""
    catalog = scene.craters(np.random.default_rng(3)).take(np.arange(CRATERS))
    return catalog, scene.camera(), scene.pose(0.0, 10.0)


def frame(view, claims, chart=None, outline=0.02):
    """Rims that claim so many times (n,) the standard deviations that they have."""
    catalog, camera, gTb = view
    rows = np.arange(CRATERS)
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    correlated = LASTING * claims[:, None, None] * slopes
    covariance = (LASTING**2 + WHITE**2) * claims[:, None, None] ** 2 * slopes @ np.swapaxes(slopes, 1, 2)
    same = np.ones(CRATERS)
    quality = RimQuality(same, same, same, same, outline * same)
    if chart is None:
        chart = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    return RimSet(rows, chart, covariance, quality, correlated, np.zeros((CRATERS, 5, 8)))


def common_shift(view, frames):
    """Estimate what moves all rims alike (5,), lasting errors along; return it and its covariance."""
    catalog, camera, gTb = view
    slopes = in_plane_slopes(np.arange(CRATERS), gTb, camera, catalog)
    truth = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    size = 5 + 5 * CRATERS
    N, b = np.diag([1e-6] * 5 + [1.0] * (size - 5)), np.zeros(size)
    for rims in frames:
        for i in range(CRATERS):
            H = np.zeros((5, size))
            H[:, :5], H[:, 5 + 5 * i : 10 + 5 * i] = slopes[i], rims.correlated[i]
            weighed = np.linalg.solve(rims.uncorrelated_covariance[i], H).T
            N += weighed @ H
            b += weighed @ (rims.chart[i] - truth[i])
    P = np.linalg.inv(N)
    return (P @ b)[:5], P[:5, :5]


def test_claims_that_scatter_no_longer_mislead_who_fuses_frames(view):
    catalog, camera, gTb = view
    rng = np.random.default_rng(4)
    slopes = in_plane_slopes(np.arange(CRATERS), gTb, camera, catalog)
    truth = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    squared = {"told": [], "pooled": []}
    for _ in range(12):
        lasting = LASTING * rng.normal(size=(CRATERS, 5))
        told = []
        for _ in range(FRAMES):
            error = lasting + WHITE * rng.normal(size=(CRATERS, 5))
            chart = truth + np.einsum("nij,nj->ni", slopes, error)
            told.append(frame(view, np.exp(rng.normal(0.0, 0.5, CRATERS)), chart))
        pooled = PooledErrors(camera, catalog)
        for name, frames in (("told", told), ("pooled", [pooled.pool(rims, gTb) for rims in told])):
            shift, P = common_shift(view, frames)
            squared[name].append(shift @ np.linalg.solve(P, shift) / 5.0)
    assert np.mean(squared["told"]) > 4.0
    # Better, not well, as long as few frames have been seen.
    assert 0.5 < np.mean(squared["pooled"]) < 2.0


def test_what_claims_less_is_believed_and_what_lasts_is_as_usual(view):
    catalog, camera, gTb = view
    pooled = PooledErrors(camera, catalog)
    same = np.ones(CRATERS)
    for _ in range(20):
        pooled.pool(frame(view, same), gTb)
    odd = same.copy()
    odd[0], odd[1] = 4.0, 0.25
    told = frame(view, odd)
    got = pooled.pool(told, gTb)
    plain = frame(view, same)
    covariances = [rims.uncorrelated_covariance for rims in (got, told, plain)]
    size = [np.sqrt(np.trace(C, axis1=1, axis2=2)) for C in covariances]
    assert size[0][0] == pytest.approx(size[1][0], rel=1e-6)
    assert size[0][1] == pytest.approx(size[2][1], rel=0.05)
    kept = np.linalg.norm(got.correlated, axis=(1, 2)) / np.linalg.norm(plain.correlated, axis=(1, 2))
    assert kept[0] == pytest.approx(np.sqrt((19.0 + 3.0 + 16.0) / 23.0), rel=0.1)
    np.testing.assert_allclose(kept[2:], 1.0, rtol=1e-6)


def test_rims_that_are_ellipses_stay_as_they_are(view):
    catalog, camera, gTb = view
    told = frame(view, np.linspace(0.3, 3.0, CRATERS), outline=0.001)
    assert PooledErrors(camera, catalog).pool(told, gTb) is told
    bare = replace(told, quality=None)
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
