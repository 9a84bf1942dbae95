import dataclasses

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.evaluation.metrics import errors, metrics, nees, step_errors
from craternav_fg.trajectory import Trajectory


def trajectory(rng: np.random.Generator, n: int = 5) -> Trajectory:
    gTb = np.stack(
        [frames.pose(frames.rotation_exp(w), P) for w, P in rng.normal(size=(n, 2, 3)) * [[[1.0], [1e6]]]]
    )
    stamps = np.arange(n, dtype=np.int64) * 10**9
    return Trajectory(stamps, gTb, rng.normal(size=(n, 3)), np.zeros((n, 6)), np.tile(np.eye(6), (n, 1, 1)))


def test_errors_move_the_estimate_to_the_truth() -> None:
    rng = np.random.default_rng(0)
    estimate, truth = trajectory(rng), trajectory(rng)
    e = errors(estimate, truth)
    assert_allclose(estimate.gRb @ frames.rotation_exp(e.attitude_rad), truth.gRb, atol=1e-12)
    assert_allclose(estimate.gP + e.position_m, truth.gP)
    assert_allclose(estimate.gV + e.velocity_m_s, truth.gV)


def test_metrics_of_a_known_offset() -> None:
    truth = trajectory(np.random.default_rng(1), 4)
    gTb = truth.gTb.copy()
    gTb[:, :3, 3] += np.array([[3.0, 4.0, 0.0], [0, 0, 0], [0, 0, 0], [0.0, 0.0, 2.0]])
    gTb[3, :3, :3] = gTb[3, :3, :3] @ frames.rotation_exp(np.array([0.0, np.radians(0.5), 0.0]))
    m = metrics(dataclasses.replace(truth, gTb=gTb, gV=truth.gV + np.array([0.0, 2.0, 0.0])), truth)
    assert m.position_rms_m == pytest.approx(np.sqrt(29.0 / 4.0))
    assert m.position_final_m == pytest.approx(2.0)
    assert m.attitude_final_deg == pytest.approx(0.5)
    assert m.attitude_rms_deg == pytest.approx(0.25)
    assert m.velocity_rms_m_s == pytest.approx(2.0)
    assert m.anees == pytest.approx((25.0 + 4.0 + np.radians(0.5) ** 2) / 4.0)
    assert m.frames == 4


def test_trajectory_errors_are_evo_s() -> None:
    rng = np.random.default_rng(5)
    truth = trajectory(rng, 40)
    gTb = truth.gTb.copy()
    errors = rng.normal(size=(40, 2, 3)) * [[[0.01], [300.0]]]
    for T, (w, p) in zip(gTb, errors, strict=True):
        T[:3, :3] = T[:3, :3] @ frames.rotation_exp(w)
        T[:3, 3] += p
    m = metrics(dataclasses.replace(truth, gTb=gTb), truth)
    pair = [PosePath3D(poses_se3=list(T)) for T in (truth.gTb, gTb)]

    def of_evo(metric: evo_metrics.PE) -> float:
        metric.process_data(tuple(pair))
        return float(metric.get_statistic(evo_metrics.StatisticsType.rmse))

    part, angle = evo_metrics.PoseRelation.translation_part, evo_metrics.PoseRelation.rotation_angle_deg
    assert m.position_rms_m == pytest.approx(of_evo(evo_metrics.APE(part)), rel=1e-9)
    assert m.rpe_m == pytest.approx(of_evo(evo_metrics.RPE(part, 1, evo_metrics.Unit.frames)), rel=1e-9)
    assert m.rpe_deg == pytest.approx(of_evo(evo_metrics.RPE(angle, 1, evo_metrics.Unit.frames)), rel=1e-6)
    pair[1].align(pair[0])
    assert m.ate_m == pytest.approx(of_evo(evo_metrics.APE(part)), rel=1e-9)


def test_nees_of_consistent_errors_is_chi_square() -> None:
    """Covariances that mix microradians and kilometres, as a pose's do."""
    rng = np.random.default_rng(2)
    n = 4000
    units = np.array([1e-6, 1e-5, 1e-4, 1e2, 1e3, 1e1])
    A = rng.normal(size=(n, 6, 6)) * units[:, None]
    values = nees(np.einsum("kij,kj->ki", A, rng.normal(size=(n, 6))), A @ np.swapaxes(A, 1, 2))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * n) / n
    assert low < values.mean() < high


def test_without_truth_only_the_frames_are_counted() -> None:
    m = metrics(trajectory(np.random.default_rng(3)), None)
    assert m.frames == 5
    assert {value for name, value in m.as_dict().items() if name != "frames"} == {None}


def test_other_stamps_are_refused() -> None:
    truth = trajectory(np.random.default_rng(4))
    with pytest.raises(EstimationError, match="different stamps"):
        errors(dataclasses.replace(truth, stamps_ns=truth.stamps_ns + 1), truth)


def test_a_single_frame_has_no_motion() -> None:
    rng = np.random.default_rng(2)
    m = metrics(trajectory(rng, 1), trajectory(rng, 1))
    assert m.rpe_m is None
    assert m.rpe_deg is None
    assert m.frames == 1


def test_steps_are_those_of_the_estimate_seen_from_the_true_ones() -> None:
    rng = np.random.default_rng(6)
    found, true = trajectory(rng, 3).gTb, trajectory(rng, 3).gTb
    for k, step in enumerate(step_errors(found, true)):
        after_true_step = np.linalg.inv(true[k]) @ true[k + 1] @ step
        assert_allclose(found[k] @ after_true_step, found[k + 1], rtol=1e-9, atol=1e-6)
