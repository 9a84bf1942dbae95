"""Matches of rims with the craters that a pose puts nearest."""

import numpy as np
import pytest

from factors.kernels.conic import chart_jacobian
from factors.kernels.rim_poses import PAIR_GATE, distances2, nearest

# From 50 km straight down on flat ground.
POSE = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 50e3], [0.0, 0.0, 0.0, 1.0]])
COVARIANCE = np.diag(np.repeat([1e-4, 200.0], 3)) ** 2
EVERYWHERE = np.array([1.0, 1.0])


def scene(order: list[int]) -> tuple[np.ndarray, ...]:
    """Three craters in some order; rims on the second, beside it towards the first, and far off."""
    centres = np.array([[0.0, 0.0, 0.0], [1500.0, 0.0, 0.0], [-9000.0, 4000.0, 0.0]])[order]
    axes = np.tile(np.array([[800.0, 0.0, 0.0], [0.0, 760.0, 0.0]]), (3, 1, 1))
    at = {row: place for place, row in enumerate(order)}
    charts, _, _ = chart_jacobian(POSE, np.eye(4), centres, axes)
    rims = charts[[at[1], at[1], at[2]]] + np.array([[0.0], [-0.012], [0.1]]) * np.eye(5)[0]
    noise = np.tile(np.diag([4e-3, 4e-3, 0.1, 0.1, 0.1]) ** 2, (3, 1, 1))
    return POSE, COVARIANCE, np.eye(4), centres, axes, rims, noise


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2], [2, 1, 0]])
def test_a_rim_gets_the_nearest_crater_or_none(order: list[int]) -> None:
    """However the craters are ordered: the second rim lost its crater to the first, and took the next."""
    given = scene(order)
    found = distances2(*given, PAIR_GATE, EVERYWHERE)
    first, second = order.index(0), order.index(1)
    assert found[1, second] < found[1, first] < PAIR_GATE
    crater, distance2 = nearest(*given, EVERYWHERE)
    assert crater.tolist() == [second, -1, -1]
    np.testing.assert_allclose(distance2, [found[0, second], PAIR_GATE, PAIR_GATE])


def test_distances_contain_the_poses_uncertainty() -> None:
    pose, covariance, mounting, centres, axes, rims, noise = scene([0, 1, 2])
    charts, H, _ = chart_jacobian(pose, mounting, centres, axes)
    found = distances2(pose, covariance, mounting, centres, axes, rims, noise, 1e9, EVERYWHERE)
    for i in range(3):
        for m in range(3):
            off = rims[i] - charts[m]
            expected = off @ np.linalg.solve(H[m] @ covariance @ H[m].T + noise[i], off)
            assert found[i, m] == pytest.approx(expected, rel=1e-9)
    narrow = distances2(pose, covariance, mounting, centres, axes, rims, noise, 1e9, np.array([0.1, 1.0]))
    assert np.isinf(narrow[:, 2]).all()
    assert np.isfinite(narrow[:, :2]).all()
