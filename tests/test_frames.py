"""Conversions between frames."""

import numpy as np
from numpy.testing import assert_allclose

from craternav_fg.frames import rotate_position_block, rotation_exp


def test_position_part_of_a_pose_covariance_is_turned_and_back() -> None:
    gRb = rotation_exp(np.array([0.4, -1.1, 0.7]))
    # Of right twists: the rotation stays in b, a step of rho in b is one of R rho in g.
    twists = np.random.default_rng(3).normal(size=(9, 6))
    steps = np.array([[*w_rho[:3], *(gRb @ w_rho[3:])] for w_rho in twists])
    in_b, in_g = (each.T @ each for each in (twists, steps))
    assert_allclose(rotate_position_block(in_b, gRb), in_g, atol=1e-13)
    assert_allclose(rotate_position_block(in_g, gRb.T), in_b, atol=1e-13)
