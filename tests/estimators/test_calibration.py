"""Mounting and time offset as variables: found, consistent, and absent unless asked for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.gnc import GncOptions, GncSmoother
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.evaluation.residuals import rim_residuals
from craternav_fg.simulation.scenario_tables import FaultsSection
from craternav_fg.trajectory import Trajectory
from tests.descents import problem, scenario

TRIALS = 5
MOUNTING_DEG, DELAY_S = 0.2, 0.02
# The axis of the mounting's error is at random: so much falls on each of three.
MOUNTING_SIGMA_RAD = np.radians(MOUNTING_DEG) / np.sqrt(3.0)


def smooth(p: Problem, calibration: Calibration) -> Trajectory:
    return BatchSmoother(BatchOptions(calibration=calibration)).estimate(p)


def interval(dof: int) -> tuple[float, float]:
    """99.8 % interval of the mean of all trials' NEES."""
    return tuple(float(chi2.ppf(q, dof * TRIALS)) / TRIALS for q in (0.001, 0.999))  # type: ignore[return-value]


@pytest.fixture(scope="module")
def mounted(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    case = scenario(duration_s=60.0, faults=FaultsSection(mounting_deg=MOUNTING_DEG))
    folder = tmp_path_factory.mktemp("mounted")
    return [problem(folder, case, trial) for trial in range(TRIALS)]


@pytest.fixture(scope="module")
def delayed(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    case = scenario(duration_s=60.0, faults=FaultsSection(time_offset_s=DELAY_S))
    folder = tmp_path_factory.mktemp("delayed")
    return [problem(folder, case, trial) for trial in range(TRIALS)]


def pose_nees(t: Trajectory, truth: Trajectory) -> float:
    assert t.pose_covariance is not None
    return float(nees(errors(t, truth).pose, t.pose_covariance)[-1])


def test_a_wrong_mounting_is_found_and_the_pose_is_consistent_again(
    mounted: list[tuple[Problem, Trajectory]], tmp_path: Path
) -> None:
    poses, believed, untold = [], [], []
    for trial, (p, truth) in enumerate(mounted):
        t = smooth(p, Calibration(mounting_sigma_rad=MOUNTING_SIGMA_RAD))
        assert t.calibrated is not None
        assert t.calibrated.mounting_rad is not None
        assert t.calibrated.time_offset_s is None
        turn, sigma = t.calibrated.mounting_rad
        # Without the fault the same trial has the camera as it is.
        right, _ = problem(tmp_path, scenario(duration_s=60.0), trial)
        actual = frames.rotation_log(right.camera.bTc[:3, :3] @ p.camera.bTc[:3, :3].T)
        assert np.all(sigma < 1.001 * MOUNTING_SIGMA_RAD)
        believed.append(((turn - actual) / sigma) ** 2)
        poses.append(pose_nees(t, truth))
        untold.append(pose_nees(smooth(p, Calibration()), truth))
    low, high = interval(6)
    assert low < np.mean(poses) < high
    assert np.mean(untold) > 3.0 * high
    low, high = interval(3)
    assert low < np.mean(np.sum(believed, axis=1)) < high


def test_a_time_offset_is_found_and_the_pose_is_consistent_again(
    delayed: list[tuple[Problem, Trajectory]],
) -> None:
    poses, believed, rms = [], [], []
    for p, truth in delayed:
        t = smooth(p, Calibration(time_offset_sigma_s=DELAY_S))
        assert t.calibrated is not None
        assert t.calibrated.time_offset_s is not None
        assert t.calibrated.mounting_rad is None
        delay_s, sigma_s = t.calibrated.time_offset_s
        believed.append(((delay_s - DELAY_S) / sigma_s) ** 2)
        poses.append(pose_nees(t, truth))
        rms.append(sigma_s)
    low, high = interval(6)
    assert low < np.mean(poses) < high
    assert np.mean(believed) < interval(1)[1]
    # It is told by the data, not by the prior alone.
    assert max(rms) < 0.9 * DELAY_S


def test_gnc_judges_matches_at_the_exposure(tmp_path: Path) -> None:
    """At the stamp, half a second off, two thirds of the right matches look wrong."""
    faults = FaultsSection(time_offset_s=0.5, mounting_deg=0.5)
    p, _ = problem(tmp_path, scenario(duration_s=60.0, faults=faults), 0)
    options = BatchOptions(calibration=Calibration(np.radians(0.5), 0.5))
    t = GncSmoother(GncOptions(graph=options)).estimate(p)
    assert t.rim_weights is not None
    assert np.mean(np.concatenate(t.rim_weights)) > 0.95
    assert t.calibrated is not None
    assert t.calibrated.time_offset_s is not None
    assert abs(t.calibrated.time_offset_s[0] - 0.5) < 0.03


def test_gnc_judges_matches_by_the_errors_of_the_map_that_it_estimates(tmp_path: Path) -> None:
    """By the rims' errors alone a right match looked wrong, and a crater without rims ended in a crash."""
    p, _ = problem(tmp_path, scenario(duration_s=60.0), 0)
    rng, true, share = np.random.default_rng(0), p.catalog, 0.02
    radius_m = np.sqrt(true.semi_major_m * true.semi_minor_m)
    north, east = share * radius_m / true.body.radius_m * rng.normal(size=(2, len(true)))
    catalog = replace(
        true,
        latitude_rad=true.latitude_rad + north,
        longitude_rad=true.longitude_rad + east / np.cos(true.latitude_rad),
    )
    wrong = 4
    seen = []
    for frame in p.frames:
        moved = 0.1 * (frame.rims.craters == wrong)[:, None] * np.array([1.0, 0.0, 0.0, 0.0, 0.0])
        seen.append(replace(frame, rims=replace(frame.rims, chart=frame.rims.chart + moved)))
    options = BatchOptions(calibration=Calibration(map_place_sigma_share=share))
    t = GncSmoother(GncOptions(graph=options)).estimate(replace(p, catalog=catalog, frames=seen))
    assert t.rim_weights is not None
    for frame, weights in zip(seen, t.rim_weights, strict=True):
        np.testing.assert_array_equal(weights, frame.rims.craters != wrong)
    assert t.calibrated is not None
    assert t.calibrated.map_errors is not None
    assert set(t.calibrated.map_errors) == {0, 1, 2, 3}


def test_tracked_points_are_seen_from_the_exposure(tmp_path: Path) -> None:
    """Seen with the stated mounting, they would hold its error at zero against the rims."""
    faults = FaultsSection(mounting_deg=MOUNTING_DEG, time_offset_s=DELAY_S)
    tracks = {"features": {"sigma_px": 0.3, "simulation": {"count": 40}}}
    case = scenario(duration_s=40.0, faults=faults, sensors=tracks)
    poses = []
    for trial in range(TRIALS):
        p, truth = problem(tmp_path, case, trial)
        assert p.features is not None
        poses.append(pose_nees(smooth(p, Calibration(MOUNTING_SIGMA_RAD, DELAY_S)), truth))
    low, high = interval(6)
    assert low < np.mean(poses) < high


def test_errors_of_the_map_are_found_and_the_pose_is_consistent_again(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    share = 0.02
    faults = FaultsSection(map_place_share=share, map_size_share=share, map_height_share=share)
    folder = tmp_path_factory.mktemp("map")
    calibration = Calibration(
        map_place_sigma_share=share, map_height_sigma_share=share, map_size_sigma_share=share
    )
    poses, untold, believed = [], [], []
    for trial in range(TRIALS):
        p, truth = problem(folder, scenario(duration_s=60.0, faults=faults), trial)
        right, _ = problem(folder, scenario(duration_s=60.0), trial)
        t = smooth(p, calibration)
        poses.append(pose_nees(t, truth))
        untold.append(pose_nees(smooth(p, Calibration()), truth))
        assert t.calibrated is not None
        assert t.calibrated.map_errors is not None
        assert len(t.calibrated.map_errors) == len(p.catalog)
        for crater, (error, sigma) in t.calibrated.map_errors.items():
            off = right.catalog.centres[crater] - p.catalog.centres[crater]
            radius_m = np.sqrt(p.catalog.semi_major_m[crater] * p.catalog.semi_minor_m[crater])
            actual = p.catalog.gRl[crater].T @ off / radius_m
            believed.append(((error[:3] - actual) / sigma[:3]) ** 2)
            assert np.all(sigma <= 1.001 * share)
        of_map, of_both = (
            np.mean(rim_residuals(one, p.frames, p.camera, p.catalog) ** 2)
            for one in (replace(t, calibrated=None), t)
        )
        assert of_both < 1.2 < of_map
    low, high = interval(6)
    assert low < np.mean(poses) < high
    assert np.mean(untold) > 2.0 * high
    assert 0.5 < np.mean(believed) < 1.6


def test_what_is_not_asked_for_is_not_estimated(mounted: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = mounted[0]
    assert smooth(p, Calibration()).calibrated is None
    tight = smooth(p, Calibration(mounting_sigma_rad=1e-9, time_offset_sigma_s=1e-9))
    assert np.allclose(tight.gTb, smooth(p, Calibration()).gTb, atol=1e-3)


@pytest.mark.parametrize("field", ["mounting_sigma_rad", "time_offset_sigma_s", "map_height_sigma_share"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_refusals_name_the_field(field: str, value: float) -> None:
    with pytest.raises(EstimationError, match=field):
        Calibration(**{field: value})


@pytest.mark.parametrize("field", ["map_place_sigma_share", "focal_sigma_share"])
def test_only_charts_have_errors_of_map_and_intrinsics(field: str) -> None:
    with pytest.raises(EstimationError, match="need rims='chart', found 'eq19'"):
        BatchOptions(rims="eq19", calibration=Calibration(**{field: 0.01}))
