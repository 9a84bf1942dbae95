"""Gravity and spin of bodies that are known by name."""

import pytest

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.importing import bodies
from craternav_fg.simulation.scenario_file import load_scenario


@pytest.mark.parametrize("scenario", ["lunar_descent", "dione_descent", "bennu_descent"])
def test_bodies_are_those_of_the_scenarios(scenario: str) -> None:
    case = load_scenario(scenario)
    assert case.body.name is not None
    known = bodies.with_gravity_and_spin(named_body(case.body.name), None, None)
    assert known.radius_m == pytest.approx(case.body.radius_m, rel=2e-3)
    assert known.mu_m3_s2 == pytest.approx(case.body.mu_m3_s2, rel=2e-3)
    assert known.spin_rad_s == pytest.approx(case.body.spin_rad_s, rel=1e-4)
