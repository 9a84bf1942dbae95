"""Estimates of the intrinsics by single frames are pooled with what they state and how they scatter."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.intrinsics_check import contradicted_by, contradicted_intrinsics
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate


def fit(
    focal_scale: float = 1.0, shift_px: tuple[float, float] = (0.0, 0.0), **changes: object
) -> SimpleNamespace:
    """What a frame tells: the focal length to half a percent, the principal point to 3 px."""
    return SimpleNamespace(**{
        "converged": True, "focal_scale": focal_scale, "focal_scale_sigma": 0.005,
        "principal_shift_px": np.array(shift_px), "principal_covariance_px2": 9.0 * np.eye(2), **changes,
    })  # fmt: skip


def scaled_rims(frame: FrameMeasurement, share: float) -> FrameMeasurement:
    """Rims by a focal length that is too small by this share."""
    chart = frame.rims.chart * [1.0 + share, 1.0 + share, 1.0, 1.0, 1.0]
    chart[:, [2, 4]] += np.log1p(share)
    return replace(frame, rims=replace(frame.rims, chart=chart))


RNG = np.random.default_rng(1)
SOUND = [fit(1.0 + 0.005 * x, (3.0 * y, 3.0 * z)) for x, y, z in RNG.standard_normal((9, 3))]


@pytest.mark.parametrize(
    ("fits", "contradicted"),
    [
        (SOUND, False),
        # Each frame by itself is less than three standard deviations off.
        ([fit(1.013)] * 9, True),
        ([fit(0.987)] * 9, True),
        ([fit(1.0, (0.0, -8.0))] * 9, True),
        ([fit(1.0, (8.0, 0.0))] * 9, True),
        ([fit(1.008)] * 9, False),
        # They scatter by more than they state: pooled, the focal length is known to 0.5 %.
        ([fit(1.02 + off) for off in (-0.03, 0.0, 0.03) for _ in range(3)], False),
        # Too few tell.
        ([fit(1.03)] * 3, False),
        ([fit(1.03)] * 4, True),
        ([fit(1.03, converged=False)] * 9, False),
        ([fit(1.03, focal_scale_sigma=np.inf)] * 9, False),
        # The better ones decide.
        ([fit(1.03, focal_scale_sigma=0.5)] * 5 + [fit(1.0)] * 5, False),
    ],
)
def test_frames_contradict_intrinsics_together(fits: Any, contradicted: bool) -> None:
    assert contradicted_by(fits) == contradicted


def test_rims_name_a_focal_length_that_nothing_else_contradicts(tmp_path: Path) -> None:
    """Altitude and accelerometer bias follow it: 86 m off with a sigma of 3 m, without a word."""
    data = Dataset.open(simulate("measured_descent", tmp_path / "data"))
    assert data.measurements is not None
    said = "contradict the camera's intrinsics: check focal lengths"
    for share, contradicted in ((-0.003, True), (0.0, False), (0.003, True), (0.02, True)):
        scaled = tuple(scaled_rims(frame, share) for frame in data.measurements)
        told = reconstruct(replace(data, measurements=scaled), ["ekf"]).warnings
        assert any(said in text for text in told) == contradicted, told
        # Nor is the map blamed for what the camera explains.
        assert not any("counts as exact" in text for text in told), told


@pytest.mark.parametrize(("share", "sigma"), [(0.0, 0.002), (0.005, 1.5e-4)])
def test_errors_that_craters_keep_are_those_of_the_frames_that_show_them(
    tmp_path: Path, share: float, sigma: float
) -> None:
    """A dozen of 76 each: as if all showed each crater, an error of the camera would not be found."""
    data = Dataset.open(simulate("measured_descent", tmp_path / "data"))
    assert data.measurements is not None
    assert data.truth is not None
    at = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    root, rng = sigma * np.diag([1.0, 1.0, 5.0, 5.0, 5.0]), np.random.default_rng(2)
    for _ in range(2):
        own = rng.standard_normal((len(data.catalog), 5)) @ root
        frames = [
            replace(
                frame,
                rims=replace(
                    frame.rims,
                    chart=frame.rims.chart + own[frame.rims.craters],
                    covariance=frame.rims.covariance + root @ root.T,
                    correlated=np.tile(root, (len(frame.rims), 1, 1)),
                ),
            )
            for frame in data.measurements
        ]
        seen = [scaled_rims(frame, share) for frame in frames]
        told = contradicted_intrinsics(seen, data.truth.gTb[at], data.camera, data.catalog)
        assert told == (share > 0.0)


@pytest.mark.slow
def test_rims_of_images_name_small_errors_of_the_intrinsics(tmp_path: Path) -> None:
    """Errors that craters keep counted as if all frames showed each crater: 28 m off with a sigma of 2 m."""
    said = "contradict the camera's intrinsics: check focal lengths"
    scenario = tmp_path / "every_ten_seconds.toml"
    scenario.write_text('base = "lunar_descent"\n[trajectory]\nframe_interval_s = 10.0\n')
    data = Dataset.open(simulate(str(scenario), tmp_path / "data"))
    right = data.camera
    for wrong in (
        right,
        replace(right, cx_px=right.cx_px + 2.0, cy_px=right.cy_px + 2.0),
        replace(right, fx_px=1.003 * right.fx_px, fy_px=1.003 * right.fy_px),
    ):
        told = reconstruct(replace(data, camera=wrong), ["ekf"]).warnings
        assert any(said in text for text in told) == (wrong is not right), told
