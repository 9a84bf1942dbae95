"""Small systems, twists, and priors at half a turn, where a rotation's logarithm is a special case."""

import numpy as np
import pytest
from scipy.linalg import expm

from craternav_fg import frames
from factors.kernels.gauss_newton import invert, move, prior_terms, screw, screw_between, solve, substitute

AXES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-0.6, 0.0, 0.8], [0.3, -0.9, -0.2]])


@pytest.mark.parametrize("axis", AXES / np.linalg.norm(AXES, axis=1, keepdims=True))
@pytest.mark.parametrize("short_of_it", [0.0, 1e-14, 1e-10, 1e-8, 1e-4])
def test_a_prior_is_not_met_by_half_a_turn(axis, short_of_it):
    """The matrix of half a turn is symmetric: its antisymmetric part, from which angles come, is zero."""
    prior, pose = np.eye(4), np.eye(4)
    prior[:3, :3] = frames.rotation_exp(np.array([0.3, -0.2, 0.9]))
    angle = np.pi - short_of_it
    pose[:3, :3] = prior[:3, :3] @ (2.0 * np.outer(axis, axis) - np.eye(3))
    pose[:3, :3] = pose[:3, :3] @ frames.rotation_exp(-short_of_it * axis)
    weight = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 1.0])
    cost = prior_terms(prior, weight, pose, np.empty((6, 6)), np.empty(6))
    assert cost == pytest.approx(4.0 * angle**2, rel=1e-6)
    twist = np.empty(6)
    pose[:3, 3] = [3.0, -2.0, 5.0]
    screw_between(prior, pose, twist)
    assert np.linalg.norm(twist[:3]) == pytest.approx(angle, rel=1e-6)
    there = prior.copy()
    screw(there, twist)
    np.testing.assert_allclose(there, pose, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 5, 6])
def test_small_systems_against_numpy(n):
    """Unknowns of units as different as rad and m: the matrix's condition number is up to 1e16."""
    rng = np.random.default_rng(n)
    units = 10.0 ** rng.uniform(-4.0, 4.0, n)
    A = rng.normal(size=(n + 3, n))
    N = A.T @ A
    g, x, inverse = rng.normal(size=n), np.empty(n), np.empty((n, n))
    scaled = N * np.outer(units, units)
    solve(scaled, g * units, x)
    np.testing.assert_allclose(x * units, np.linalg.solve(N, g), rtol=1e-9)
    invert(scaled, inverse)
    np.testing.assert_allclose(inverse * np.outer(units, units), np.linalg.inv(N), rtol=1e-9, atol=1e-12)
    y = g.copy()
    substitute(np.linalg.cholesky(N), y)
    np.testing.assert_allclose(y, np.linalg.solve(N, g), rtol=1e-9)


def test_a_matrix_that_is_not_positive_definite_has_no_solution():
    N, x = np.diag([2.0, -1.0, 3.0]), np.empty(3)
    N[0, 2] = N[2, 0] = 0.5
    solve(N, np.ones(3), x)
    assert np.isnan(x).any()
    inverse = np.empty((3, 3))
    invert(N, inverse)
    assert not np.isfinite(inverse).all()


@pytest.mark.parametrize("angle", [0.0, 3e-5, 2e-4, 0.3, 3.0])
def test_a_screw_is_the_exponential_of_a_twist(angle):
    start = np.eye(4)
    start[:3, :3] = frames.rotation_exp(np.array([0.3, -0.2, 0.9]))
    start[:3, 3] = [100.0, -200.0, 300.0]
    twist = np.concatenate([angle * AXES[4] / np.linalg.norm(AXES[4]), [5.0, 6.0, -7.0]])
    generator = np.zeros((4, 4))
    for i in range(3):
        generator[:3, i] = np.cross(twist[:3], np.eye(3)[i])
    generator[:3, 3] = twist[3:]
    moved, back = start.copy(), np.empty(6)
    screw(moved, twist)
    np.testing.assert_allclose(moved, start @ expm(generator), atol=1e-7)
    screw_between(start, moved, back)
    np.testing.assert_allclose(back, twist, atol=1e-6)
    step = start.copy()
    move(step, twist)
    np.testing.assert_allclose(step[:3, :3], moved[:3, :3], atol=1e-12)
    np.testing.assert_allclose(step[:3, 3], start[:3, 3] + start[:3, :3] @ twist[3:], atol=1e-9)
