"""Attitudes of pairs of rims and craters against the definition, by matrices."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.linalg import bisecting_triads, squared_distance
from craternav_fg.matching.pair_kernel import CENTRE_ERROR_RAD, Directions, costs_of_pairs
from factors.arrays import FloatArray

COUNT = 6
RANGE_M = 5e4 * np.array([1.0, 1.1, 0.9, 1.2, 1.0, 0.8])


def directions(rng: np.random.Generator, turn: FloatArray) -> Directions:
    """Rims of craters that a camera sees which is turned from the predicted attitude."""
    rays = np.column_stack([rng.uniform(-0.4, 0.4, (COUNT, 2)), np.ones(COUNT)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    sizes = rng.normal(-8.0, 1.0, COUNT)
    return Directions(rays, sizes, rays @ frames.rotation_exp(turn).T, RANGE_M, sizes)


def costs(pairs: list[list[int]], known: Directions, covariance: FloatArray, sigma_m: float) -> FloatArray:
    variances, axes = np.linalg.eigh(covariance)
    return costs_of_pairs(np.array(pairs), known, axes, variances, 4.0 * sigma_m, sigma_m)


def test_costs_are_squared_distances_of_the_turn() -> None:
    rng = np.random.default_rng(1)
    root = 0.02 * rng.standard_normal((3, 3))
    covariance = root @ root.T
    for turn in (np.zeros(3), np.array([0.03, -0.02, 0.05]), np.array([0.4, 1.0, -2.0])):
        known = directions(rng, turn)
        pairs = [[i, i, j, j] for i in range(COUNT) for j in range(COUNT) if i != j]
        found = costs(pairs, known, covariance, 100.0)
        for (i, m, j, k), cost in zip(pairs, found, strict=True):
            seen = np.linalg.norm(known.rays[i] - known.rays[j])
            slack = (100.0 / min(RANGE_M[m], RANGE_M[k])) ** 2 + CENTRE_ERROR_RAD**2
            spread = covariance + slack / max(seen, 0.05) ** 2 * np.eye(3)
            R = bisecting_triads(known.sights[m], known.sights[k])
            R = R @ bisecting_triads(known.rays[i], known.rays[j]).T
            assert cost == pytest.approx(
                float(squared_distance(frames.rotation_log(R), spread)), rel=1e-9, abs=1e-12
            )


def test_pairs_that_do_not_agree_are_left_out() -> None:
    known = directions(np.random.default_rng(2), np.zeros(3))
    twice = known._replace(sights=known.sights[[0, 0, 2, 3, 4, 5]], rays=known.rays[[0, 1, 2, 2, 4, 5]])
    pairs = [[0, 0, 2, 0], [0, 0, 1, 1], [2, 2, 3, 3]]
    # One crater for two rims; two craters in one place; two rims in one place.
    assert np.isinf(costs(pairs, twice, 1e-4 * np.eye(3), 1.0)).all()
    # Craters that are farther apart than the rims, and those of other sizes.
    far = known._replace(rays=known.rays * [0.5, 0.5, 1.0])
    far = far._replace(rays=far.rays / np.linalg.norm(far.rays, axis=1, keepdims=True))
    large = known._replace(log_solid=known.log_solid + np.arange(COUNT))
    for other in (far, large):
        assert np.isinf(costs([[0, 0, 5, 5]], other, 1e-4 * np.eye(3), 1.0)).all()
    assert costs([[0, 0, 5, 5]], known, 1e-4 * np.eye(3), 1.0) == pytest.approx(0.0, abs=1e-9)


def test_half_a_turn_is_as_far_as_any_axis_allows() -> None:
    known = directions(np.random.default_rng(3), np.zeros(3))
    rays = np.array([[0.1, 0.0, 1.0], [-0.1, 0.0, 1.0]]) / np.hypot(0.1, 1.0)
    half = known._replace(rays=rays, sights=rays[::-1].copy())
    found = costs([[0, 0, 1, 1]], half, np.diag([1e-4, 4e-4, 9e-4]), 1e-3)
    slack = (CENTRE_ERROR_RAD / np.linalg.norm(rays[0] - rays[1])) ** 2
    assert found == pytest.approx(np.pi**2 / (9e-4 + slack), rel=1e-6)
