"""Estimates of the intrinsics by single frames are pooled with what they state and how they scatter."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.pipeline.intrinsics_check import contradicted_by


def fit(
    focal_scale: float = 1.0, shift_px: tuple[float, float] = (0.0, 0.0), **changes: object
) -> SimpleNamespace:
    """What a frame tells: the focal length to half a percent, the principal point to 3 px."""
    return SimpleNamespace(**{
        "converged": True, "focal_scale": focal_scale, "focal_scale_sigma": 0.005,
        "principal_shift_px": np.array(shift_px), "principal_covariance_px2": 9.0 * np.eye(2), **changes,
    })  # fmt: skip


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
