"""Drawings of a campaign whose errors are chosen: which trials they are of, and what they show."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from craternav_fg.campaign.read import Campaign
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.reports import campaign_page, trial_charts
from craternav_fg.reports.page import Drawing, Table, number_cell
from tests.campaign.test_summary import campaign, estimate, rows

LANDING_M = [30e3, 10e3, 4e3, 1e3, -2e3]


def known(errors_m: dict[str, dict[int, float]], altitudes_m: list[float], nees: float = 6.0) -> Campaign:
    """Two trials, and one without a result; the bound of the second is ten times that of the first."""
    table = []
    for name, by_trial in errors_m.items():
        for trial, off_m in by_trial.items():
            table += estimate(trial, name, off_m, 0.1, nees, altitudes_m)
    for trial, sigma_m in enumerate((1.0, 10.0)):
        for bound in (FILTERED_BOUND, SMOOTHED_BOUND):
            table += rows(trial, bound, altitudes_m, pose_sigma=[1e-3] * 3 + [sigma_m] * 3)
    return campaign(table, list(errors_m))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures as they are drawn."""
    figures: list[Figure] = []
    of = campaign_page.inline_svg

    def keep(figure: Figure, name: str) -> object:
        figures.append(figure)
        return of(figure, name)

    monkeypatch.setattr(campaign_page, "inline_svg", keep)
    return figures


def test_a_landing_below_the_mean_sphere_has_an_anees_in_every_bin(drawn: list[Figure]) -> None:
    found = known({"ekf": {0: 3.0, 1: 3.0}}, LANDING_M)
    _, table = campaign_page._consistency(found, ["ekf"])
    assert isinstance(table, Table)
    assert [cell.text for cell in table.rows[0][1][1:]] == ["6"] * len(table.headings[1:])
    assert table.headings[-1].endswith("-2.03 km")
    campaign_page._errors(found, ["ekf"])
    for figure in drawn:
        assert figure.axes[0].get_xscale() == "linear"
    assert trial_charts.altitude_scale(found) == "linear"
    assert trial_charts.altitude_scale(known({"ekf": {0: 3.0}}, [9e3, 1e3])) == "log"


def test_errors_and_bounds_are_over_the_same_trials(drawn: list[Figure]) -> None:
    found = known({"ekf": {0: 3.0, 1: 30.0}, "online": {0: 4.0}}, [9e3, 4e3, 1e3])
    drawing = campaign_page._errors(found, ["ekf", "online"])
    lines = {line.get_label(): line.get_ydata()[-1] for line in drawn[0].axes[0].get_lines()}
    assert lines == pytest.approx(
        {"ekf": 3.0, "online": 4.0, "filtering PCRB": np.sqrt(3.0), "smoothing PCRB": np.sqrt(3.0)}
    )
    assert "over the 1 of 3 trials in which every estimator" in drawing.caption
    apart = known({"ekf": {1: 30.0}, "online": {0: 4.0}}, [9e3, 4e3, 1e3])
    assert "so no bound is drawn" in campaign_page._errors(apart, ["ekf", "online"]).caption
    assert len(drawn[1].axes[0].get_lines()) == 2


def test_the_share_of_trials_is_of_all(drawn: list[Figure]) -> None:
    found = known({"ekf": {0: 3.0, 1: 30.0}, "online": {0: 4.0}}, [9e3, 4e3, 1e3])
    drawing = campaign_page._final(found, ["ekf", "online"])
    lines = {line.get_label(): line.get_ydata()[-1] for line in drawn[0].axes[0].get_lines()}
    assert lines == pytest.approx({"ekf (2 of 3 trials)": 2.0 / 3.0, "online (1 of 3 trials)": 1.0 / 3.0})
    assert "with a trajectory: ekf 2 of 3, online 1 of 3 trials." in drawing.caption


def test_a_small_anees_is_on_the_axis(drawn: list[Figure]) -> None:
    for nees in (0.2, 6.0):
        found = known({"ekf": {0: 3.0, 1: 3.0}}, [9e3, 4e3, 1e3], nees)
        drawing = campaign_page._consistency(found, ["ekf"])[0]
        assert isinstance(drawing, Drawing)
        assert re.search("<svg", drawing.svg)
    assert [figure.axes[0].get_ylim()[0] for figure in drawn] == pytest.approx([0.18, 1.0])


def test_a_number_that_is_none_stays_of_concern() -> None:
    assert number_cell(np.inf, concern=True).concern
    assert number_cell(np.inf).text == "∞"
    assert number_cell(np.nan, concern=True).text == number_cell(None).text == "–"
