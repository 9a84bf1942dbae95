"""Errors of rims are split into what a crater keeps and what is new in each frame."""

import numpy as np
import pytest

from tests.foreign.variance_components import split


def test_errors_are_split_into_kept_and_new() -> None:
    rng = np.random.default_rng(1)
    craters = np.repeat(np.arange(400), rng.integers(2, 9, 400))
    kept, new = np.array([0.3, 0.1, 0.0]), np.array([0.1, 0.3, 0.2])
    errors = kept * rng.standard_normal((400, 3))[craters] + new * rng.standard_normal((len(craters), 3))
    found = split(craters, errors)
    # The first two within four of their own standard deviations; nothing kept in the third.
    assert found[0][:2] == pytest.approx(kept[:2], abs=0.05)
    assert found[0][2] < 0.06
    assert found[1] == pytest.approx(new, abs=0.02)
