"""Rims of which some are likelier craters than others, and places with more craters than others."""

import numpy as np
import pytest

from craternav_fg.matching.identify import search
from craternav_fg.matching.identify.search import IdentifyOptions, identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import (
    _crowding,
    image_triples,
    largest,
    likeliest,
    project_all_to_sphere,
)
from craternav_fg.matching.identify.view import view_of
from craternav_fg.simulation.catalog_views import ViewOptions, random_view

MOST_FALSE = ViewOptions(false=0.7, sigma_px=1.0)


@pytest.fixture(scope="module")
def scene(synthetic):
    return random_view(synthetic.catalog, MOST_FALSE, np.random.default_rng(3), true_rims=(12, 16))


@pytest.fixture(scope="module")
def quality(scene):
    """As a good detector states it."""
    rng = np.random.default_rng(4)
    true = scene.craters >= 0
    return np.where(true, rng.uniform(0.6, 0.95, len(true)), rng.uniform(0.05, 0.5, len(true)))


def test_likely_rims_are_more_evidence(scene, synthetic, quality) -> None:
    alike = identify(scene.ellipses_px, scene.camera, synthetic)
    known = identify(scene.ellipses_px, scene.camera, synthetic, quality=quality)
    assert alike.identified
    assert known.identified
    assert known.log_chance < alike.log_chance - 5.0
    opposite = identify(scene.ellipses_px, scene.camera, synthetic, quality=1.0 - quality)
    assert opposite.log_chance > alike.log_chance + 5.0


def test_only_ratios_of_probabilities_are_evidence(scene, synthetic, quality) -> None:
    known = identify(scene.ellipses_px, scene.camera, synthetic, quality=quality)
    halved = identify(scene.ellipses_px, scene.camera, synthetic, quality=0.5 * quality)
    assert halved.rows.tolist() == known.rows.tolist()
    assert halved.log_chance == pytest.approx(known.log_chance)


def test_chance_has_the_same_bound_whatever_the_probabilities_are(synthetic) -> None:
    """Mirrored rims fit nowhere."""
    rng = np.random.default_rng(5)
    for _ in range(8):
        view = random_view(synthetic.catalog, ViewOptions(), rng, true_rims=(6, 20))
        skewed = rng.uniform(0.02, 1.0, len(view.craters)) ** 2
        found = identify(view.mirrored(), view.camera, synthetic, quality=skewed)
        assert not found.identified
        assert found.log_chance > -4.0


def test_triples_of_likely_rims_come_first(scene, quality) -> None:
    views = [view_of(scene.ellipses_px, scene.camera, quality=q) for q in (None, quality)]
    down = scene.gTb[:3, :3].T @ -scene.gTb[:3, 3] / np.linalg.norm(scene.gTb[:3, 3])
    right = []
    for view in views:
        projection = project_all_to_sphere(view, np.ascontiguousarray(down), 2e5, 1737.4e3)
        first = image_triples(view, projection, np.arange(len(view.charts)), 6, 1.0)[:24]
        right.append((scene.craters[first] >= 0).mean())
    assert right[1] > right[0] + 0.15


def test_likeliest_and_largest_rims(scene, quality) -> None:
    view = view_of(scene.ellipses_px, scene.camera, quality=quality)
    rims = np.arange(0, len(quality))
    assert set(likeliest(view, rims, 5)) == set(np.argsort(-quality)[:5])
    assert likeliest(view, rims, len(rims)) is rims
    # Without probabilities all are as likely.
    assert len(likeliest(view_of(scene.ellipses_px, scene.camera), rims, 5)) == len(rims)
    assert set(largest(view, rims, 4)) == set(np.argsort(-view.radius_px)[:4])


def test_the_optical_axis_is_tried_where_the_rims_show_another_vertical(synthetic, monkeypatch) -> None:
    scene = random_view(
        synthetic.catalog, ViewOptions(largest_tilt_deg=2.0), np.random.default_rng(6), true_rims=(16, 24)
    )
    aside = np.array([np.sin(0.7), 0.0, np.cos(0.7), 0.08])
    monkeypatch.setattr(search, "nadirs", lambda *_: (aside[None], np.zeros(1)))
    found = identify(scene.ellipses_px, scene.camera, synthetic)
    assert found.identified
    assert scene.agrees(found.rows)


def test_errors_of_centres_that_grow_with_the_rims(synthetic) -> None:
    rng = np.random.default_rng(7)
    scene = random_view(synthetic.catalog, ViewOptions(sigma_px=0.3, false=0.0), rng, true_rims=(24, 30))
    moved = scene.ellipses_px.copy()
    radius = np.sqrt(moved[:, 2] * moved[:, 3])
    moved[:, :2] += 0.1 * radius[:, None] * rng.normal(size=(len(moved), 2))
    answers = [
        identify(moved, scene.camera, synthetic, options=IdentifyOptions(centre_share=share))
        for share in (0.01, 0.2)
    ]
    assert answers[1].identified
    assert answers[1].log_chance < answers[0].log_chance - 5.0


def test_crowded_places(synthetic) -> None:
    """A catalogue of which one hemisphere has a tenth of the craters."""
    catalog = synthetic.catalog
    rng = np.random.default_rng(8)
    north = catalog.centres[:, 2] > 0.0
    index = TripleIndex.build(catalog.take(np.flatnonzero(north | (rng.uniform(size=len(north)) < 0.1))))
    craters = index.craters
    crowding = np.array([_crowding(craters, index.neighbours, k) for k in range(len(craters.centres))])
    sine = craters.centres[:, 2] / np.linalg.norm(craters.centres, axis=1)
    dense, sparse = np.median(crowding[sine > 0.2]), np.median(crowding[sine < -0.2])
    assert 1.3 < dense < 2.6
    assert 0.1 <= sparse < 0.35
