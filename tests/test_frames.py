"""Conversions between frames."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.frames import (
    adjoint,
    cross_matrix,
    east_north_up,
    from_quaternion_wxyz,
    inverse,
    latitude_longitude,
    pose,
    pose_log,
    right_jacobian,
    rotate_position_block,
    rotation_exp,
    rotation_log,
    to_quaternion_wxyz,
    up,
)


def test_cross_matrices_multiply_like_cross_products() -> None:
    v, u = np.random.default_rng(4).normal(size=(2, 5, 3))
    assert_allclose(np.einsum("nij,nj->ni", cross_matrix(v), u), np.cross(v, u), atol=1e-14)
    assert_allclose(cross_matrix(v[0]) @ u[0], np.cross(v[0], u[0]), atol=1e-14)


def test_adjoint_takes_a_twist_to_the_other_frame() -> None:
    aTb = pose(rotation_exp(np.array([0.4, -1.1, 0.7])), np.array([3.0, -2.0, 5.0]))
    w_b = np.array([0.2, -0.1, 0.3, 1.0, 2.0, -1.0])
    gTa = gtsam.Pose3(pose(rotation_exp(np.array([-0.3, 0.2, 0.9])), np.array([1.0, 1.0, 1.0])))
    gTb = gTa * gtsam.Pose3(aTb)
    # The same motion, as a right twist of either pose.
    by_b = gTb * gtsam.Pose3.Expmap(w_b)
    by_a = gTa * gtsam.Pose3.Expmap(adjoint(aTb) @ w_b) * gtsam.Pose3(aTb)
    assert by_a.equals(by_b, 1e-9)


def test_position_part_of_a_pose_covariance_is_turned_and_back() -> None:
    gRb = rotation_exp(np.array([0.4, -1.1, 0.7]))
    # Of right twists: the rotation stays in b, a step of rho in b is one of R rho in g.
    twists = np.random.default_rng(3).normal(size=(9, 6))
    steps = np.array([[*w_rho[:3], *(gRb @ w_rho[3:])] for w_rho in twists])
    in_b, in_g = (each.T @ each for each in (twists, steps))
    assert_allclose(rotate_position_block(in_b, gRb), in_g, atol=1e-13)
    assert_allclose(rotate_position_block(in_g, gRb.T), in_b, atol=1e-13)


def test_poses_cancel_their_inverses() -> None:
    rng = np.random.default_rng(4)
    aTb = np.stack([pose(rotation_exp(w), t) for w, t in rng.normal(size=(3, 2, 3))])
    assert_allclose(inverse(aTb) @ aTb, np.broadcast_to(np.eye(4), (3, 4, 4)), atol=1e-14)
    assert_allclose(inverse(aTb[1]), inverse(aTb)[1])


def test_rotation_vectors_and_matrices() -> None:
    w = np.array([[0.0, 0.0, np.pi / 2.0], [0.3, -0.2, 0.1], [0.0, 0.0, 0.0]])
    R = rotation_exp(w)
    # A quarter turn about z takes x to y.
    assert_allclose(R[0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    assert_allclose(rotation_log(R), w, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 1.56, 1.58, 2.0, 3.1415])
def test_one_rotation_has_the_rotation_vector_that_it_has_among_many(angle: float) -> None:
    for axis in np.random.default_rng(5).normal(size=(20, 3)):
        w = angle * axis / np.linalg.norm(axis)
        R = gtsam.Rot3.Expmap(w).matrix()
        assert_allclose(rotation_log(R), w, atol=1e-12, rtol=1e-9)
        assert_allclose(rotation_log(R), rotation_log(R[None])[0], atol=1e-12, rtol=1e-9)


def test_quaternions_are_scalar_first_and_of_any_length() -> None:
    # Half an angle of 90 deg about x: y goes to z.
    q = np.array([np.cos(np.pi / 4.0), np.sin(np.pi / 4.0), 0.0, 0.0])
    R = from_quaternion_wxyz(-3.0 * q)
    assert_allclose(R @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-15)
    assert_allclose(to_quaternion_wxyz(R), q, atol=1e-15)


def test_one_quaternion_is_converted_as_many_are() -> None:
    """One by its own formulas, many by scipy; half turns and almost half turns among them."""
    rng = np.random.default_rng(8)
    q = rng.normal(size=(300, 4))
    q[:20, 0] = 0.0
    q[20:40, 0] *= 1e-9
    q[40:60, 1:] *= 1e-9
    q[60:63, 1:] = 0.0
    q[63:70, :3] = 0.0
    R = from_quaternion_wxyz(q)
    for one, its in zip(q, R, strict=True):
        assert_allclose(from_quaternion_wxyz(one), its, atol=1e-14)
        found, expected = to_quaternion_wxyz(its), to_quaternion_wxyz(its[None])[0]
        # Of a half turn, both signs are right.
        sign = 1.0 if expected[0] > 1e-12 else np.sign(found @ expected)
        assert_allclose(found, sign * expected, atol=1e-14)
    for wrong in (np.zeros(4), np.full(4, np.nan)):
        with pytest.raises(ValueError, match="any length but zero"):
            from_quaternion_wxyz(wrong)
    for wrong in (np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="expected a rotation"):
            to_quaternion_wxyz(wrong)


def test_local_axes_of_places() -> None:
    latitude, longitude = np.array([0.0, 0.5, -1.2]), np.array([0.0, 2.5, -3.0])
    gRe = east_north_up(latitude, longitude)
    assert_allclose(gRe[0], np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).T, atol=1e-15)
    assert_allclose(np.linalg.det(gRe), 1.0)
    step = 1e-6
    to_north = (up(latitude + step, longitude) - up(latitude - step, longitude)) / (2.0 * step)
    assert_allclose(gRe[:, :, 1], to_north, atol=1e-9)
    assert_allclose(gRe[:, :, 2], up(latitude, longitude))
    found = latitude_longitude(1.7e6 * up(latitude, longitude))
    assert_allclose(found, [latitude, longitude], atol=1e-14)


@pytest.mark.parametrize("size", [1e-6, 9.9e-5, 1.01e-4, 0.5, 3.0])
def test_right_jacobian_is_the_derivative_of_the_exponential(size: float) -> None:
    w = size * np.array([0.6, -0.48, 0.64])
    step = 1e-5
    back = rotation_exp(w).T
    ahead, behind = (
        np.array([rotation_log(back @ rotation_exp(w + e)) for e in sign * step * np.eye(3)])
        for sign in (1.0, -1.0)
    )
    assert_allclose(right_jacobian(w), (ahead - behind).T / (2.0 * step), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_the_twist_of_a_pose_is_that_of_gtsam(angle: float) -> None:
    T = pose(rotation_exp(angle * np.array([0.6, 0.0, -0.8])), np.array([3.0, -2.0, 5.0]))
    assert_allclose(pose_log(T), gtsam.Pose3.Logmap(gtsam.Pose3(T)), atol=1e-9)
