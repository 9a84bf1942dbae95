"""Identification of detected rims, some of which are coarse ellipses."""

import numpy as np
import pytest

from craternav_fg.matching.identify import detected
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
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


def test_no_rims(index, view):
    found = identify_detected(np.empty((0, 5)), np.empty(0, bool), view.camera, index)
    assert not found.identified
    assert found.craters == ()


def test_a_deep_search_is_by_all(index, view, monkeypatch):
    asked = []

    def noted(ellipses_px, *others):
        asked.append(len(ellipses_px))
        return identify(ellipses_px, *others)

    monkeypatch.setattr(detected, "identify", noted)
    traced = np.arange(len(view.ellipses_px)) < 6
    identify_detected(view.ellipses_px, traced, view.camera, index, options=IdentifyOptions(deep=True))
    assert asked == [len(traced)]
