"""The command of the calibrations, and the family that takes no time."""

import pytest

from craternav_fg.calibration.__main__ import main
from craternav_fg.calibration.families import FAMILIES
from craternav_fg.vision import ellipse_bias


def test_constants_that_follow_from_gaussian_errors(capsys):
    assert main(["robust_moments"]) == 0
    printed = capsys.readouterr().out
    assert "PSI_MIXED" in printed
    assert "not exact" not in printed


def test_a_wrong_constant_is_noticed(monkeypatch, capsys):
    monkeypatch.setattr(ellipse_bias, "PSI_MIXED", 0.573)
    assert main(["robust_moments"]) == 1
    assert "not exact" in capsys.readouterr().out


def test_an_unknown_family_is_one_line(capsys):
    assert main(["rim_flour"]) == 2
    error = capsys.readouterr().err
    assert "rim_flour" in error
    assert "rim_floor" in error


# Of the same rendered images: one process renders them once.
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "robust_moments"])
def test_shipped_constants_are_what_the_calibration_gives(name):
    wrong = [
        f"{one.name}: shipped {one.shipped:g}, regenerated {one.value:.4g} +- {one.error:.2g}"
        for one in FAMILIES[name]()
        if not one.holds
    ]
    assert not wrong, "; ".join(wrong)
