"""Heights of crests that a coarse model loses: drawn with known constants, they are found again."""

import numpy as np

from craternav_fg.calibration.crest_heights import LostHeights, fitted

STEP_M = 1900.0
TRUE = np.array([0.03, 0.01, 3.0])


def drawn(rng: np.random.Generator, count: int) -> LostHeights:
    share, sigma_share, steps = TRUE
    radius_m = np.exp(rng.uniform(np.log(600.0), np.log(15e3), count))
    smoothed_m = radius_m * np.exp(-radius_m / (steps * STEP_M))
    scatter_m = 0.005 * radius_m
    sigma_m = np.hypot(scatter_m, sigma_share * smoothed_m)
    return LostHeights(radius_m, share * smoothed_m + sigma_m * rng.standard_normal(count), scatter_m)


def test_drawn_constants_are_found() -> None:
    rng = np.random.default_rng(1)
    found = fitted([drawn(rng, 200) for _ in range(12)], STEP_M)
    values, errors = np.array([(one.value, one.error) for one in found]).T
    assert (np.abs(values - TRUE) < 4.0 * errors).all()
    assert (errors < 0.1 * TRUE).all()
    assert [one.name for one in found] == [
        "heights.CREST_SHARE", "heights.CREST_SIGMA_SHARE", "heights.CREST_STEPS"
    ]  # fmt: skip
