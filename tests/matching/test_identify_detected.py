"""Identification of detected rims, some of which are coarse ellipses."""

import numpy as np
import pytest

from craternav_fg.errors import EstimationError
from craternav_fg.matching.identify import detected
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.options import Effort, IdentifyOptions
from craternav_fg.matching.identify.pose_fit import fit_pose, pack_rims
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.view import view_of
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON


@pytest.fixture(scope="module")
def index():
    return TripleIndex.build(synthetic_catalog(MOON, np.random.default_rng(0), count=2000))


@pytest.fixture(scope="module")
def view(index):
    rng = np.random.default_rng(5)
    return random_view(index.catalog, ViewOptions(), rng, true_rims=(16, 24))


def test_coarse_ellipses_are_left_out_but_have_their_rows(index, view):
    traced = np.arange(len(view.ellipses_px)) % 4 != 1
    coarse = view.ellipses_px * np.where(traced, 1.0, 1.4)[:, None] ** [0, 0, 1, 1, 0]
    found = identify_detected(coarse, traced, view.camera, index)
    alone = identify(coarse[traced], view.camera, index)
    assert found.identified
    assert len(found.craters) == len(found.rows) == len(coarse)
    assert not (found.rows[~traced] >= 0).any()
    assert found.rows[traced].tolist() == alone.rows.tolist()
    right = np.where(found.rows >= 0, found.rows == view.craters, True)
    assert right.all()
    assert [name is None for name in found.craters] == (found.rows < 0).tolist()


def test_all_are_used_where_the_traced_ones_do_not_suffice(index, view):
    traced = np.arange(len(view.ellipses_px)) < 2
    assert not identify(view.ellipses_px[traced], view.camera, index).identified
    found = identify_detected(view.ellipses_px, traced, view.camera, index)
    assert found.identified
    assert (found.rows >= 0).sum() > 5


def test_an_answer_by_traced_rims_is_extended_to_all(index, view):
    true = np.flatnonzero(view.craters >= 0)
    traced = np.isin(np.arange(len(view.craters)), true[:8])
    alone = identify(view.ellipses_px[traced], view.camera, index)
    found = identify_detected(view.ellipses_px, traced, view.camera, index)
    assert alone.identified
    assert np.count_nonzero(found.rows >= 0) > 12
    assert (found.rows[found.rows >= 0] == view.craters[found.rows >= 0]).all()
    assert np.trace(found.covariance[3:, 3:]) < 0.5 * np.trace(alone.covariance[3:, 3:])
    assert found.log_chance < alone.log_chance


def test_an_answer_stays_where_the_other_rims_do_not_agree(index, view):
    traced = view.craters >= 0
    false = ~traced
    assert false.sum() >= 3
    found = identify_detected(view.ellipses_px, traced, view.camera, index)
    alone = identify(view.ellipses_px[traced], view.camera, index)
    assert found.rows[traced].tolist() == alone.rows.tolist()
    np.testing.assert_array_equal(found.gTb, alone.gTb)


def test_circles_say_nothing_of_the_foreshortening(index):
    """A detector that gives places and sizes alone draws circles, also where craters are foreshortened."""
    options = ViewOptions(sigma_px=0.5, altitudes_m=(100e3, 300e3), largest_tilt_deg=50.0)
    view = random_view(index.catalog, options, np.random.default_rng(7), true_rims=(8, 16))
    true = view.craters >= 0
    ellipses, rows = view.ellipses_px[true], view.craters[true]
    circles = ellipses.copy()
    circles[:, 2:4] = np.sqrt(ellipses[:, 2] * ellipses[:, 3])[:, None]
    assert (ellipses[:, 2] / ellipses[:, 3]).max() > 1.3
    poses = []
    for shapes, traced in (
        (ellipses, None),
        (ellipses, ~true[true]),
        (circles, ~true[true]),
        (circles, None),
    ):
        rims = view_of(shapes, view.camera, traced=traced)
        data = pack_rims(rims, index.craters, rows, np.ones(3))
        gTc = view.gTb @ view.camera.bTc
        # A fit makes few steps.
        assert all(fit_pose(gTc, data, np.eye(4), np.zeros((6, 6)), np.empty((6, 6))) for _ in range(5))
        poses.append(gTc)
    np.testing.assert_allclose(poses[2], poses[1], rtol=1e-9, atol=1e-3)
    without_m, misled_m = (np.linalg.norm(poses[k][:3, 3] - poses[0][:3, 3]) for k in (2, 3))
    assert without_m < 0.3 * misled_m


@pytest.mark.parametrize("value", [np.nan, -3.0])
def test_impossible_ellipses_are_refused_also_where_they_were_not_traced(index, view, value):
    coarse = view.ellipses_px.copy()
    traced = np.arange(len(coarse)) != 2
    coarse[2, 3] = value
    with pytest.raises(EstimationError, match="expected finite numbers and positive axes"):
        identify_detected(coarse, traced, view.camera, index)


def test_no_rims(index, view):
    found = identify_detected(np.empty((0, 5)), np.empty(0, bool), view.camera, index)
    assert not found.identified
    assert found.craters == ()


@pytest.mark.parametrize("effort", [Effort.WIDE, Effort.DEEP])
def test_more_than_a_plain_search_is_by_all(index, view, monkeypatch, effort):
    asked = []

    def noted(ellipses_px, *others):
        asked.append(len(ellipses_px))
        return identify(ellipses_px, *others)

    monkeypatch.setattr(detected, "identify", noted)
    traced = np.arange(len(view.ellipses_px)) < 6
    identify_detected(view.ellipses_px, traced, view.camera, index, options=IdentifyOptions(effort=effort))
    assert asked == [len(traced)]
