"""Priors and twists at half a turn, where a rotation's logarithm is a special case."""

import numpy as np
import pytest

from craternav_fg import frames
from factors.kernels.gauss_newton import prior_terms, screw, screw_between

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
