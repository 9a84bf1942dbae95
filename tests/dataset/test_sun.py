"""The direction towards the sun: whether it stays where it is among the stars while the body spins."""

import numpy as np
import pytest

from craternav_fg.dataset.sun import SunVectors
from craternav_fg.pipeline.input_warnings import departing_sun

# Of Bennu over 40 minutes.
SPIN, END_NS = (0.0, 0.0, 4.06e-4), 2_400_000_000_000
STAMPS = np.linspace(0, END_NS, 21).astype(np.int64)


def test_a_sun_among_the_stars_is_not_told() -> None:
    # In g, what is fixed in space turns backwards about the axis.
    turn = -1e-9 * STAMPS * SPIN[2]
    x, y = 0.8 * np.cos(turn), 0.8 * np.sin(turn)
    sun = SunVectors(STAMPS, np.column_stack([x, y, np.full(len(x), 0.6)]))
    departure = sun.departure_rad(0, END_NS, SPIN)
    assert departure == pytest.approx(0.0, abs=1e-9)
    assert departing_sun(departure) == []


def test_one_direction_turns_with_the_body_s_spin() -> None:
    """From the stamp in the middle it is known at all others."""
    sun = SunVectors.among_stars(np.array([1.6, 0.0, 1.2]), int(STAMPS[10]), STAMPS, SPIN)
    assert sun.vectors[10] == pytest.approx([0.8, 0.0, 0.6])
    angle = 4.06e-4 * 1200.0
    assert sun.vectors[0] == pytest.approx([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.6])
    assert sun.vectors[20] == pytest.approx([0.8 * np.cos(angle), -0.8 * np.sin(angle), 0.6])


def test_one_direction_on_a_body_that_spins_is_told() -> None:
    sun = SunVectors(STAMPS[:1], np.array([[1.0, 0.0, 0.0]]))
    departure = sun.departure_rad(0, END_NS, SPIN)
    assert departure == pytest.approx(4.06e-4 * 2400.0)
    (told,) = departing_sun(departure)
    assert "55.8 deg" in told
    assert departing_sun(sun.departure_rad(0, END_NS, (0.0, 0.0, 2.6616995e-6))) == []
