"""Ground without one property has the same craters, light and motion."""

from dataclasses import replace

import numpy as np
import pytest

from tests.foreign.left_out import PROPERTIES
from tests.foreign.worlds import KINDS, draw_world


@pytest.mark.slow
@pytest.mark.parametrize("name", PROPERTIES)
def test_all_else_stays_the_same(name: str) -> None:
    whole = draw_world(1, "rough", frames=1)
    other = draw_world(1, "rough", frames=1, ground=replace(KINDS["rough"], **{name: 0.0}))
    assert (other.law, other.optics) == (whole.law, whole.optics)
    np.testing.assert_array_equal(other.sun, whole.sun)
    craters, others = whole.ground.craters, other.ground.craters
    for part in ("centres", "semi_axes", "angles", "wear"):
        np.testing.assert_array_equal(getattr(others, part), getattr(craters, part))
    assert others.family == craters.family
    assert (other.ground.albedo.std() == 0.0) == (name == "albedo")
    assert np.any(other.images[0] != whole.images[0])
