"""A truth in another frame, or with another order of quaternions, is told from a failed estimator."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.evaluation.truth_check import doubted_truth
from craternav_fg.trajectory import Trajectory

SPIN = (0.0, 0.0, 1.9234e-4)
SECONDS = np.linspace(0.0, 160.0, 33)


@pytest.fixture
def truth() -> Trajectory:
    gTb = np.tile(np.eye(4), (33, 1, 1))
    gTb[:, :3, :3] = frames.rotation_exp(SECONDS[:, None] * [0.006, 0.002, -0.01] + [1.0, 0.5, 2.0])
    gTb[:, :3, 3] = np.array([3.2e5, -3.8e5, -1.9e5]) + SECONDS[:, None] * [-20.0, 300.0, 5.0]
    stamps = np.round(1e9 * SECONDS).astype(np.int64)
    return Trajectory(stamps, gTb, np.zeros((33, 3)), np.zeros((33, 6)))


@pytest.fixture
def estimate(truth: Trajectory) -> Trajectory:
    rng = np.random.default_rng(1)
    gTb = truth.gTb @ [
        frames.pose(frames.rotation_exp(w), np.zeros(3)) for w in rng.normal(0.0, 1e-3, (33, 3))
    ]
    gTb[:, :3, 3] += rng.normal(0.0, 10.0, (33, 3))
    return replace(truth, gTb=gTb)


def turned(truth: Trajectory, angles_rad: np.ndarray) -> Trajectory:
    """Positions and attitudes about the body's axis."""
    turn = np.tile(np.eye(4), (33, 1, 1))
    turn[:, :3, :3] = frames.rotation_exp(np.array(angles_rad)[:, None] * [0.0, 0.0, 1.0])
    return replace(truth, gTb=turn @ truth.gTb)


def test_a_right_truth_is_not_doubted(truth: Trajectory, estimate: Trajectory) -> None:
    assert doubted_truth(estimate, truth, SPIN) == []


def test_the_order_of_quaternions(truth: Trajectory, estimate: Trajectory) -> None:
    q = frames.to_quaternion_wxyz(truth.gRb)
    gTb = truth.gTb.copy()
    gTb[:, :3, :3] = frames.from_quaternion_wxyz(q[:, [1, 2, 3, 0]])
    (warning,) = doubted_truth(estimate, replace(truth, gTb=gTb), SPIN)
    assert "the truth, not the estimate, seems to give quaternions as x, y, z, w: read so" in warning
    gTb[:, :3, :3] = np.swapaxes(truth.gRb, 1, 2)
    (warning,) = doubted_truth(estimate, replace(truth, gTb=gTb), SPIN)
    assert "seems to give the attitude of g in b" in warning


def test_small_errors_of_attitude_are_the_estimates(truth: Trajectory) -> None:
    """Near the axes of g, an attitude and its inverse differ by little."""
    gTb, of_truth = (np.tile(np.eye(4), (33, 1, 1)) for _ in range(2))
    gTb[:, :3, :3] = frames.rotation_exp(np.full((33, 3), 0.03))
    of_truth[:, :3, :3] = frames.rotation_exp(np.full((33, 3), -0.03))
    gTb[:, :3, 3] = of_truth[:, :3, 3] = truth.gP
    assert doubted_truth(replace(truth, gTb=gTb), replace(truth, gTb=of_truth), SPIN) == []


@pytest.mark.parametrize("first_rad", [0.0, 2.5])
def test_inertial_space(truth: Trajectory, estimate: Trajectory, first_rad: float) -> None:
    (warning,) = doubted_truth(estimate, turned(truth, first_rad + SPIN[2] * SECONDS), SPIN)
    assert "seems to be in inertial space: turned back" in warning


def test_another_prime_meridian(truth: Trajectory, estimate: Trajectory) -> None:
    (warning,) = doubted_truth(estimate, turned(truth, np.full(33, -0.3)), SPIN)
    assert "another prime meridian" in warning


@pytest.mark.parametrize(
    ("order", "signs", "said"),
    [
        ([1, 0, 2], [1, 1, 1], "with its y, x, z for x, y, z"),
        ([0, 1, 2], [1, -1, 1], "with its x, -y, z for"),
        ([2, 0, 1], [1, 1, -1], "with its y, -z, x for"),
    ],
)
def test_other_axes(
    truth: Trajectory, estimate: Trajectory, order: list[int], signs: list[int], said: str
) -> None:
    """Interchanged columns, velocities alike, passed for an estimator that is 1,000 km off."""
    gTb = truth.gTb.copy()
    gTb[:, :3, 3] = truth.gP[:, order] * signs
    (warning,) = doubted_truth(estimate, replace(truth, gTb=gTb), SPIN)
    assert said in warning


def test_a_single_frame_tells_nothing_of_frames(truth: Trajectory, estimate: Trajectory) -> None:
    other = turned(truth, np.full(33, 0.2))
    first = [
        replace(one, **{name: getattr(one, name)[:1] for name in ("stamps_ns", "gTb", "gV", "bias")})
        for one in (estimate, other)
    ]
    assert not [text for text in doubted_truth(*first, SPIN) if "about the body's axis" in text]


def test_a_failed_estimator_is_not_excused(truth: Trajectory, estimate: Trajectory) -> None:
    rng = np.random.default_rng(2)
    drift_m = SECONDS[:, None] * rng.normal(0.0, 30.0, 3)
    # The last: dead reckoning from a velocity in inertial space.
    for off_m in (drift_m, drift_m**2 / 100.0, 8e3, SECONDS[:, None] * np.cross(SPIN, truth.gP)):
        gTb = estimate.gTb.copy()
        gTb[:, :3, 3] += off_m
        gTb[:, :3, :3] = gTb[:, :3, :3] @ frames.rotation_exp(rng.normal(0.0, 1.0, 3))
        assert doubted_truth(replace(estimate, gTb=gTb), truth, SPIN) == []
