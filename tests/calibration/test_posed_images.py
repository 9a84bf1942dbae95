"""The number of images that err alike, found from drawn errors."""

import numpy as np
import pytest

from craternav_fg.calibration.posed_images import images_per_view


def descents(rng, size, craters=150):
    """Three descents; `size` neighbouring images of each crater have one error."""
    truth = 0.1 * rng.standard_normal((craters, 5))
    return [
        {
            row: truth[row] + 0.03 * np.repeat(rng.standard_normal((1 + row % 5, 5)), size, axis=0)
            for row in range(craters)
        }
        for _ in range(3)
    ]


@pytest.mark.parametrize("size", [1, 3, 6])
def test_blocks_of_equal_errors_are_counted(size):
    rng = np.random.default_rng(size)
    found = images_per_view([descents(rng, size), descents(rng, size)])
    assert found == pytest.approx(size, rel=0.3)


def test_what_never_differs_is_at_the_lower_end():
    alike = descents(np.random.default_rng(1), 2)[0]
    assert images_per_view([[alike, alike, alike]]) == 0.5
