"""Rims as measured."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from craternav_fg.ellipse import chart_covariance
from craternav_fg.measurements import ArcSet, RimSet
from craternav_fg.simulation.scenario_file import load_scenario


def test_weights_do_not_favour_rims_measured_too_large() -> None:
    camera = load_scenario("paper_case3").camera.camera()
    f = camera.focal_px
    true = np.array([0.1, 0.05, np.log(7.0 / f), 0.1, np.log(5.0 / f)])
    root = np.linalg.cholesky(chart_covariance(true[None], camera, 1.0, 60)[0])
    z = np.random.default_rng(1).standard_normal((50_000, 5))
    errors = np.concatenate([z, -z]) @ root.T
    charts = true + errors
    rims = RimSet(np.zeros(len(charts), np.int64), charts, chart_covariance(charts, camera, 1.0, 60))
    expected = rims.expected_at(np.broadcast_to(true, charts.shape))

    def pull(S: np.ndarray) -> float:
        """Mean of the weighted errors, in sigmas of one rim: what a weighted mean of many is wrong by."""
        return float(np.linalg.norm(np.mean(np.linalg.solve(S, errors[..., None])[..., 0] @ root, axis=0)))

    assert pull(rims.covariance) > 0.1
    assert pull(expected.covariance) < 0.04


def test_what_a_measured_shape_contradicts_is_not_expected() -> None:
    camera = load_scenario("paper_case3").camera.camera()
    chart = np.array([[0.1, 0.05, -5.0, 0.1, -5.2]] * 3)
    rims = RimSet(np.arange(3), chart, chart_covariance(chart, camera, 1.0, 60))
    sigma = np.sqrt(rims.covariance[0, 2, 2])
    elsewhere = chart.copy()
    elsewhere[0, :2] += 1.0
    elsewhere[1, 2] += 20.0 * sigma
    elsewhere[2] = np.nan
    assert_allclose(rims.expected_at(elsewhere).covariance, rims.covariance, rtol=1e-12)
    elsewhere[1, 2] = chart[1, 2] + 2.0 * sigma
    size = np.exp(-2.0 * sigma)
    assert_allclose(rims.expected_at(elsewhere).covariance[1, 2, 2], (size * sigma) ** 2, rtol=1e-12)


def test_arcs_keep_their_correlated_errors_when_some_are_taken() -> None:
    """Without it the rest would count as far better than they are."""
    points = tuple(np.full((n, 2), 0.1 * n) for n in (3, 4, 5))
    sigmas = tuple(np.full(n, 1e-4) for n in (3, 4, 5))
    roots = np.arange(120.0).reshape(3, 5, 8)
    arcs = ArcSet(np.array([7, 8, 9]), points, sigmas, np.array([1e-3, 2e-3, 3e-3]), roots)
    some = arcs.take(np.array([True, False, True]))
    assert some.correlated_sigmas is not None
    assert_allclose(some.correlated_sigmas, [1e-3, 3e-3])
    every = arcs.inflate_correlated(2.0).sigmas
    for one, whole in zip(some.inflate_correlated(2.0).sigmas, (every[0], every[2]), strict=True):
        assert_allclose(one, whole)
    for kept in (some, some.inflate_correlated(2.0)):
        assert kept.shared is not None
        assert_allclose(kept.shared, roots[[0, 2]])


def test_estimators_that_fuse_frames_take_more_white_variance_than_rims_state() -> None:
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 5, 29)) * 1e-3
    correlated, of_map, shared, white = np.split(root, [5, 13, 21], axis=2)
    factors = np.array([1.0, 2.0, 7.0])
    rims = RimSet(
        np.arange(3), rng.standard_normal((3, 5)), root @ np.swapaxes(root, 1, 2),
        correlated=correlated, of_map=of_map, shared=shared,
        fused_white=factors[:, None, None] * white @ np.swapaxes(white, 1, 2),
    )  # fmt: skip
    own = white @ np.swapaxes(white, 1, 2)
    kept = root[:, :, :21] @ np.swapaxes(root[:, :, :21], 1, 2)
    assert_allclose(rims.uncorrelated_covariance, own, rtol=1e-9)
    assert_allclose(rims.fused_white_covariance, factors[:, None, None] * own, rtol=1e-9)
    inflated = rims.inflate_correlated(4.0)
    assert_allclose(inflated.covariance, factors[:, None, None] * own + 4.0 * kept, rtol=1e-9)
    each, of_shared = np.array([1.0, 2.0, 5.0]), 9.0
    own_kept = root[:, :, :13] @ np.swapaxes(root[:, :, :13], 1, 2)
    of_all = factors[:, None, None] * own + each[:, None, None] * own_kept
    assert_allclose(
        rims.inflate_correlated(each, of_shared).covariance,
        of_all + of_shared * shared @ np.swapaxes(shared, 1, 2), rtol=1e-9,
    )  # fmt: skip
    # Once it is in the covariance it is not applied again.
    assert_allclose(inflated.inflate_correlated(4.0).covariance, inflated.covariance, rtol=1e-12)
    # It stays with its rim, whatever is done to them before.
    expected = rims.expected_at(rims.chart)
    assert_allclose(expected.fused_white_covariance, rims.fused_white_covariance, rtol=1e-9)
    scaled = rims.scaled(np.full(3, 2.0))
    assert_allclose(scaled.fused_white_covariance, 2.0 * rims.fused_white_covariance, rtol=1e-9)
    assert_allclose(scaled.uncorrelated_covariance, 2.0 * own, rtol=1e-7)
    elsewhere = rims.chart + 1e-4
    exact = rims.with_exact_map()
    assert exact.of_map is not None
    level = replace(exact, covariance=exact.covariance - exact.of_map @ np.swapaxes(exact.of_map, 1, 2))
    moved, alike = (one.expected_at(elsewhere) for one in (rims, replace(level, of_map=None)))
    assert_allclose(moved.uncorrelated_covariance, alike.uncorrelated_covariance, rtol=1e-6)
    some = rims.take(np.array([2, 0]))
    assert some.of_map is not None
    assert_allclose(some.of_map, of_map[[2, 0]])
    assert_allclose(some.fused_white_covariance, rims.fused_white_covariance[[2, 0]], rtol=1e-12)
