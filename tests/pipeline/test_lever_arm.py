"""A lever arm of the camera that is not exact: nothing shows it, so covariances hold what is stated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import errors
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario

SIGMA_M, TRIALS = 50.0, 12
ESTIMATORS = ["smoother", "online", "ekf"]


def with_lever_arm(data: Dataset, arm_m: np.ndarray, sigma_m: float | None) -> Dataset:
    bTc = data.camera.bTc.copy()
    bTc[:3, 3] = arm_m
    return replace(data, camera=replace(data.camera, bTc=bTc, lever_arm_sigma_m=sigma_m))


def test_errors_of_the_lever_arm_agree_with_their_covariances(tmp_path: Path) -> None:
    """A long one, so that it counts from 40 km; the lander does not turn by more than a few degrees."""
    rng = np.random.default_rng(5)
    squares: dict[str, list[list[float]]] = {name: [] for name in ESTIMATORS}
    for trial in range(TRIALS):
        data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / f"{trial}", trial=trial))
        wrong = SIGMA_M * rng.standard_normal(3)
        found = reconstruct(with_lever_arm(data, wrong, SIGMA_M), ESTIMATORS).trajectories
        unstated = reconstruct(with_lever_arm(data, wrong, None), ["smoother"]).trajectories["smoother"]
        for name, one in found.items():
            assert one.pose_covariance is not None
            off = errors(one, data.truth).pose[-1, 3:]
            squares[name].append(
                [
                    float(off @ np.linalg.solve(P[-1, 3:, 3:], off))
                    for P in (one.pose_covariance, unstated.pose_covariance)
                    if P is not None
                ]
            )
    low, high = chi2.ppf([0.001, 0.999], 3 * TRIALS) / TRIALS
    for name in ESTIMATORS:
        stated, untold = np.mean(squares[name], axis=0)
        assert low < stated < high, name
        assert untold > high, name


def test_errors_of_the_rotation_agree_with_their_covariances(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    sigma_deg, arm_m = 0.2, np.array([40.0, 0.0, 20.0])
    squares: dict[str, list[list[float]]] = {name: [] for name in ESTIMATORS}
    for trial in range(TRIALS):
        data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / f"{trial}", trial=trial))
        right = with_lever_arm(data, np.zeros(3), None)
        turned = right.camera.bTc.copy()
        turned[:3, :3] = frames.rotation_exp(np.radians(sigma_deg) * rng.standard_normal(3)) @ turned[:3, :3]
        for name, one in _both(right, turned, sigma_deg).items():
            squares[name].append(one)
    low, high = chi2.ppf([0.001, 0.999], 6 * TRIALS) / TRIALS
    for name in ESTIMATORS:
        stated, untold = np.mean(squares[name], axis=0)
        assert low < stated < high, name
        assert untold > high, name
    # The lander's origin moves with the lever arm; an estimated rotation is not added once more.
    data = with_lever_arm(data, arm_m, None)
    exact, told = (
        reconstruct(
            replace(data, camera=replace(data.camera, mounting_sigma_deg=sigma)),
            ["smoother", "self_calibrating_smoother"],
        ).trajectories
        for sigma in (None, sigma_deg)
    )
    added = told["smoother"].pose_covariance[-1] - exact["smoother"].pose_covariance[-1]
    assert np.trace(added[3:, 3:]) == pytest.approx(2.0 * (np.radians(sigma_deg) * 44.72) ** 2, rel=1e-3)
    # The camera stays where it is: the origin moves by the difference of what the lever arm is in g.
    gRb, moved = exact["smoother"].gRb[-1], []
    for axis in 1e-6 * np.eye(3):
        moved.append((gRb - gRb @ frames.rotation_exp(axis)) @ arm_m / 1e-6)
    np.testing.assert_allclose(
        added[:3, 3:], np.radians(sigma_deg) ** 2 * np.array(moved), rtol=1e-3, atol=1e-6
    )
    np.testing.assert_allclose(
        told["self_calibrating_smoother"].pose_covariance, exact["self_calibrating_smoother"].pose_covariance
    )


def _both(data: Dataset, bTc: np.ndarray, sigma_deg: float) -> dict[str, list[float]]:
    """Squared errors of the last poses of a camera that is turned, with its sigma stated and without."""
    out: dict[str, list[float]] = {name: [] for name in ESTIMATORS}
    for sigma in (sigma_deg, None):
        camera = replace(data.camera, bTc=bTc, mounting_sigma_deg=sigma)
        for name, one in reconstruct(replace(data, camera=camera), ESTIMATORS).trajectories.items():
            assert one.pose_covariance is not None
            off = errors(one, data.truth).pose[-1]
            out[name].append(float(off @ np.linalg.solve(one.pose_covariance[-1], off)))
    return out


def test_velocities_of_a_lander_that_turns_are_less_certain(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / "d"))
    exact, stated = (
        reconstruct(with_lever_arm(data, np.zeros(3), sigma_m), ["smoother"]).trajectories["smoother"]
        for sigma_m in (0.0, SIGMA_M)
    )
    assert exact.velocity_covariance is not None
    assert stated.velocity_covariance is not None
    added = stated.velocity_covariance - exact.velocity_covariance
    row = int(np.searchsorted(data.imu.stamps_ns, exact.stamps_ns[-1]))
    of_b = data.imu.gyro_rad_s[row] - exact.bias[-1, :3]
    rate = exact.gRb[-1] @ of_b - np.array(data.body.spin_rad_s)
    # Across the axis of the turn by as much as the arm's end moves, along it not at all.
    np.testing.assert_allclose(np.linalg.eigvalsh(added[-1])[1:], (SIGMA_M * np.linalg.norm(rate)) ** 2)
    np.testing.assert_allclose(added[-1] @ rate, 0.0, atol=1e-12)


def test_a_lever_arm_that_is_left_out_is_told_where_it_matters(tmp_path: Path) -> None:
    case = scenario(duration_s=20.0)
    measurements = case.measurements.model_copy(update={"edge_sigma_px": 0.02})
    sharp = case.model_copy(update={"measurements": measurements})
    data = Dataset.open(simulate(sharp, tmp_path / "d"))
    for arm_m, sigma_m, told in (
        (np.zeros(3), None, True),
        (np.zeros(3), 0.0, False),
        (np.array([1e-3, 0.0, 0.0]), None, False),
    ):
        run = reconstruct(with_lever_arm(data, arm_m, sigma_m), ["smoother"])
        assert any("its lever arm in T_BS is zero" in text for text in run.warnings) == told
    far = Dataset.open(simulate(case, tmp_path / "far"))
    assert not any("lever arm" in text for text in reconstruct(far, ["smoother"]).warnings)
