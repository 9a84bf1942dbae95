"""Posterior Cramér-Rao bound against the estimators' own graph, inverted densely."""

import dataclasses
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import insert_state, state_stamps
from craternav_fg.estimators.linearisation import linearise_sun
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.frames import rotate_position_block
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.custom import Loss
from factors.kernels import robust
from tests.descents import problem, scenario

NO_LOSS = BatchOptions(loss=Loss(robust.NONE, 1.0))


@pytest.fixture(scope="module")
def descent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Problem, Trajectory]:
    """Eleven frames; the prior's mean is moved to the truth, where the graph is linearised."""
    p, truth = problem(tmp_path_factory.mktemp("bounds"), scenario(duration_s=20.0), 0)
    initial = dataclasses.replace(p.initial, gTb=truth.gTb[0], gV=truth.gV[0])
    return dataclasses.replace(p, initial=initial), truth


def true_values(p: Problem, truth: Trajectory) -> tuple[gtsam.Values, list[int]]:
    """Truth at the frames, carried by the IMU to the states between; numbers of the frames' states."""
    values, numbers = gtsam.Values(), [0]
    for k, frame in enumerate(p.frames):
        state = FilterState(truth.gTb[k], truth.gV[k], np.zeros(3), truth.bias[k], np.eye(18))
        nav = gtsam.NavState(gtsam.Pose3(state.gTb), state.gV)
        insert_state(values, numbers[-1], nav, state.bias)
        if k + 1 == len(p.frames):
            break
        begin = frame.stamp_ns
        stamps = state_stamps(begin, p.frames[k + 1].stamp_ns, NO_LOSS.keyframe_s)
        for n, end in enumerate(stamps[:-1], numbers[-1] + 1):
            state = filter_state.propagate(state, p, begin, int(end))
            begin = int(end)
            insert_state(values, n, gtsam.NavState(gtsam.Pose3(state.gTb), state.gV), state.bias)
        numbers.append(numbers[-1] + len(stamps))
    return values, numbers


def dense(p: Problem, truth: Trajectory) -> np.ndarray:
    """Pose covariances (k, 6, 6) by inverting the whole information matrix at the truth."""
    values, numbers = true_values(p, truth)
    ordering = gtsam.Ordering()
    for key in values.keys():  # noqa: SIM118 (Values is no mapping)
        ordering.push_back(key)
    A, _ = build_graph(p, NO_LOSS, values).linearize(values).jacobian(ordering)
    scale = np.linalg.norm(A, axis=0)
    R = np.linalg.qr(A / scale, mode="r")
    inverse = np.linalg.inv(R) / scale[:, None]
    sizes = {"x": 6, "v": 3, "b": 6}
    begins, offset = {}, 0
    for i in range(ordering.size()):
        begins[ordering.at(i)] = offset
        offset += sizes[chr(gtsam.Symbol(ordering.at(i)).chr())]
    out = []
    for n, T in zip(numbers, truth.gTb, strict=True):
        rows = inverse[begins[X(n)] : begins[X(n)] + 6]
        out.append(rotate_position_block(rows @ rows.T, T[:3, :3]))
    return np.array(out)


def part(p: Problem, truth: Trajectory, frames: int) -> tuple[Problem, Trajectory]:
    """First frames alone."""
    cut = Trajectory(truth.stamps_ns[:frames], truth.gTb[:frames], truth.gV[:frames], truth.bias[:frames])
    return dataclasses.replace(p, frames=p.frames[:frames]), cut


def correlation(covariance: np.ndarray, reference: np.ndarray) -> np.ndarray:
    sigma = np.sqrt(np.einsum("kii->ki", reference))
    return covariance / (sigma[:, :, None] * sigma[:, None, :])


def test_smoothed_bound_is_the_inverse_of_all_information(descent: tuple[Problem, Trajectory]) -> None:
    p, truth = descent
    bound, reference = posterior_bound(p, p.frames, truth), dense(p, truth)
    assert_allclose(correlation(bound.smoothed, reference), correlation(reference, reference), atol=2e-3)


@pytest.mark.parametrize("frames", [1, 2, 6])
def test_filtered_bound_is_that_of_the_frames_so_far(
    descent: tuple[Problem, Trajectory], frames: int
) -> None:
    p, truth = descent
    bound = posterior_bound(p, p.frames, truth).filtered[frames - 1 : frames]
    reference = dense(*part(p, truth, frames))[-1:]
    assert_allclose(correlation(bound, reference), correlation(reference, reference), atol=2e-3)


def test_a_blind_stretch_is_bridged_by_the_imu(descent: tuple[Problem, Trajectory]) -> None:
    """Frames without rims and sun: the bound still holds, filtered from before, smoothed from both sides."""
    p, truth = descent
    blind = [
        frame if k < 3 or k > 8 else FrameMeasurement(frame.stamp_ns, RimSet.empty(), None)
        for k, frame in enumerate(p.frames)
    ]
    p = dataclasses.replace(p, frames=blind)
    bound, reference = posterior_bound(p, p.frames, truth), dense(p, truth)
    assert_allclose(correlation(bound.smoothed, reference), correlation(reference, reference), atol=2e-3)
    assert np.all(np.diff(position_rms_m(bound.filtered)[2:9]) > 0.0)


def test_tracked_points_count(tmp_path: Path) -> None:
    """As in the smoothers, which need a third observation and a parallax: they know a little less."""
    tracked = {"features": {"simulation": {"count": 30}}}
    p, truth = problem(tmp_path, scenario(duration_s=60.0, sensors=tracked), 0)
    blind = [
        frame if k < 5 or k > 25 else FrameMeasurement(frame.stamp_ns, RimSet.empty(), None)
        for k, frame in enumerate(p.frames)
    ]
    # An IMU that needs help to bridge 40 s.
    noise = dataclasses.replace(
        p.imu_noise,
        gyro_density_rad_s_sqrt_hz=10.0 * p.imu_noise.gyro_density_rad_s_sqrt_hz,
        accelerometer_density_m_s2_sqrt_hz=1000.0 * p.imu_noise.accelerometer_density_m_s2_sqrt_hz,
    )
    p = dataclasses.replace(p, frames=blind, imu_noise=noise)
    bound = posterior_bound(p, p.frames, truth)
    without = posterior_bound(dataclasses.replace(p, features=None), p.frames, truth)
    # Online, points count once the attitude is known.
    for of_bound, of_less, one, off, share in (
        (bound.smoothed, without.smoothed, BatchSmoother(), 0.01, 0.95),
        (bound.filtered, without.filtered, OnlineSmoother(), 0.1, 0.6),
    ):
        claimed = one.estimate(p).pose_covariance
        assert claimed is not None
        ratio = position_rms_m(claimed) / position_rms_m(of_bound)
        assert_allclose(ratio[8:], 1.0, atol=off)
        assert (position_rms_m(of_bound) < share * position_rms_m(of_less))[15:26].all()


def test_sensors_and_the_sun_count_with_the_biases_of_sensors(tmp_path: Path) -> None:
    """Rims at the beginning only: ranges, velocities and tilts of the sun tell what they tell estimators."""
    sensors = {
        "altimeter": {"rate_hz": 0.5, "noise_m": 2.0, "bias_sigma_m": 300.0},
        "velocimeter": {"rate_hz": 0.5, "noise_m_s": 0.05, "bias_sigma_m_s": 0.5},
    }
    p, truth = problem(tmp_path, scenario(duration_s=24.0, sensors=sensors), 0)
    frames = []
    for k, (frame, gTb) in enumerate(zip(p.frames, truth.gTb, strict=True)):
        at_truth = linearise_sun(gTb, frame.sun, p.camera)
        assert frame.sun is not None
        assert at_truth is not None
        # Tilts as at the truth, and better than they usually are: they decide.
        tilt_rad = frame.sun.tilt_rad - float(at_truth.residual[0]) * frame.sun.sigma_rad
        sun = dataclasses.replace(frame.sun, tilt_rad=tilt_rad, sigma_rad=3e-4)
        frames.append(FrameMeasurement(frame.stamp_ns, frame.rims if k < 3 else RimSet.empty(), sun))
    # An IMU that needs help.
    noise = dataclasses.replace(
        p.imu_noise,
        gyro_density_rad_s_sqrt_hz=100.0 * p.imu_noise.gyro_density_rad_s_sqrt_hz,
        accelerometer_density_m_s2_sqrt_hz=1000.0 * p.imu_noise.accelerometer_density_m_s2_sqrt_hz,
    )
    p = dataclasses.replace(p, frames=frames, imu_noise=noise)
    bound = posterior_bound(p, p.frames, truth)
    for of_bound, claimed in (
        (bound.smoothed, BatchSmoother(NO_LOSS).estimate(p).pose_covariance),
        (bound.filtered, ekf().estimate(p).pose_covariance),
    ):
        assert claimed is not None
        # The filter begins at the prior's mean, far from the truth for such tilts.
        found, expected = correlation(claimed, of_bound)[1:], correlation(of_bound, of_bound)[1:]
        assert_allclose(found, expected, atol=0.05)
    dark = [dataclasses.replace(frame, sun=None) for frame in frames]
    for less, block, share in (
        (posterior_bound(dataclasses.replace(p, sensors=()), frames, truth), slice(3, 6), 0.5),
        (posterior_bound(p, dark, truth), slice(0, 3), 0.8),
    ):
        one, other = (np.sqrt(np.trace(each.smoothed[-1, block, block])) for each in (bound, less))
        assert one < share * other


def test_what_was_read_does_not_matter(descent: tuple[Problem, Trajectory]) -> None:
    """Only how well: other readings, with the covariances that a fit has there, give the same bound."""
    p, truth = descent
    other = [
        dataclasses.replace(
            frame,
            rims=dataclasses.replace(
                frame.rims.expected_at(frame.rims.chart + 0.003), chart=frame.rims.chart + 0.003
            ),
            sun=None if frame.sun is None else dataclasses.replace(frame.sun, tilt_rad=1.0),
        )
        for frame in p.frames
    ]
    here, there = posterior_bound(p, p.frames, truth), posterior_bound(p, other, truth)
    assert_allclose(there.filtered, here.filtered, rtol=1e-9)
    assert_allclose(there.smoothed, here.smoothed, rtol=1e-9)


def test_units_of_the_rms_position() -> None:
    S = np.diag([1e-4, 4e-4, 4e-4, 9.0, 16.0, 144.0])[None]
    assert_allclose(position_rms_m(S), [13.0])


def test_refuses_other_stamps(descent: tuple[Problem, Trajectory], tmp_path: Path) -> None:
    p, truth = descent
    with pytest.raises(EstimationError, match="different stamps"):
        posterior_bound(p, p.frames[:-1], truth)
