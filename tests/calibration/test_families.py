"""The command of the calibrations, and the family that takes no time."""

import re

import pytest

from craternav_fg import calibration
from craternav_fg.calibration.__main__ import main
from craternav_fg.calibration.families import FAMILIES, ON_REAL_GROUND
from craternav_fg.calibration.regenerated import Regenerated, Relation
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


@pytest.mark.parametrize(
    ("shipped", "value", "error", "relation", "verdict"),
    [
        (0.7, 0.61, 0.03, Relation.FITTED, "confirmed"),
        (-30.4, -22.9, 3.0, Relation.FITTED, "confirmed"),
        (0.7, 0.5, 0.03, Relation.FITTED, "contradicted"),
        # Zero by mistake passes, but not for a fit.
        (0.4, 0.2, 0.5, Relation.FITTED, "not contradicted"),
        (0.0, 0.2, 0.5, Relation.FITTED, "not contradicted"),
        (0.2, 0.09, 0.06, Relation.FITTED, "not contradicted"),
        (-50.0, -111.0, 26.0, Relation.FITTED, "not contradicted"),
        (0.0, 0.2, 0.05, Relation.FITTED, "contradicted"),
        (0.02, 0.011, 0.001, Relation.AT_LEAST, "at least"),
        (0.01, 0.02, 0.001, Relation.AT_LEAST, "not at least"),
    ],
)
def test_what_data_hardly_determine_is_not_confirmed(shipped, value, error, relation, verdict):
    assert Regenerated("x", shipped, value, error, relation).verdict == verdict


def test_the_package_says_which_constants_are_confirmed():
    row = re.compile(r" (\S+) +(at least )?(\S+) ± ([\d.]+)(?:, (.*))?$", re.M)
    found = row.findall(calibration.__doc__)
    assert len(found) > 30
    for shipped, bound, value, error, said in found:
        if not bound and said != "kept":
            assert Regenerated("x", float(shipped), float(value), float(error)).verdict == said


def test_an_unknown_family_is_one_line(capsys):
    assert main(["rim_flour"]) == 2
    error = capsys.readouterr().err
    assert "rim_flour" in error
    assert "rim_floor" in error


@pytest.mark.parametrize("name", ON_REAL_GROUND)
def test_what_is_measured_on_real_ground_asks_for_its_folder(name, tmp_path, capsys):
    for given, says in (
        ([], f"{name}: expected the folder"),
        ([str(tmp_path / "none")], "lu1319381.parquet: "),
    ):
        assert main([name, *given]) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1


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
