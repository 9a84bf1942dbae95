"""What identification tries, in which order, and when it searches deeper."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.matching.identify import search
from craternav_fg.matching.identify.expansion import Search
from craternav_fg.matching.identify.given import Given
from craternav_fg.matching.identify.nadir import nadirs
from craternav_fg.matching.identify.options import Effort
from craternav_fg.matching.identify.search import IdentifyOptions, Status, identify
from craternav_fg.matching.identify.single_rim_search import search_single_rims
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import (
    image_order,
    image_triples,
    project_all_to_sphere,
    search_triples,
)
from craternav_fg.matching.identify.view import distinct_rows, view_of
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, square_camera
from craternav_fg.simulation.scenes import MOON
from tests.catalogs.population import power_law_population
from tests.matching.test_identify import tracker


def test_triples_that_the_index_has_come_first(synthetic) -> None:
    """Those whose nearest neighbours the image shows: it ends where a large crater's neighbours are."""
    neighbours = synthetic.neighbours
    first, last = [], []
    rng = np.random.default_rng(17)
    for _ in range(30):
        scene = random_view(synthetic.catalog, ViewOptions(sigma_px=3.0), rng, true_rims=(9, 20))
        view = view_of(scene.ellipses_px, scene.camera)
        model = nadirs(view, np.arange(len(scene.craters)), np.array([0.08, 0.25]), 1)[0][0]
        down, height_m = model[:3].copy(), model[3] * MOON.radius_m
        projection = project_all_to_sphere(view, down, height_m, MOON.radius_m)
        craters = scene.craters[image_triples(view, projection, np.arange(len(view.charts)), 6, 3.0)]
        had = [row.min() >= 0 and set(row[1:]) <= set(neighbours[row[0]]) for row in craters]
        first.extend(had[:12])
        last.extend(had[-24:])
    assert np.mean(first) > 0.3
    assert np.mean(last) < 0.12


def test_neighbours_in_the_image_are_the_nearest(synthetic) -> None:
    scene = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(19), true_rims=(40, 80))
    view = view_of(scene.ellipses_px, scene.camera)
    rims = np.arange(0, len(view.charts), 2)
    apart = np.linalg.norm(view.points_px[:, None] - view.points_px[rims], axis=-1)
    np.testing.assert_array_equal(image_order(view, rims, 5), rims[np.argsort(apart, axis=1)[:, :5]])
    assert image_order(view, rims[:3], 5).shape == (len(view.charts), 3)
    assert image_order(view, rims[:0], 5).shape == (len(view.charts), 0)


def test_rows_that_repeat_one_before_them_are_left_out() -> None:
    """One that repeats a row left out is kept; a hundred thousand equal ones take no time."""
    rng = np.random.default_rng(23)
    rows = np.round(rng.uniform(0.0, 1.0, (60, 5)), 1)
    ellipses = 0.03 * np.round(rows[rng.integers(0, 60, 2000)] + 2.0 * rng.integers(-1, 2, (2000, 5)))
    apart = np.abs(ellipses[:, None, :4] - ellipses[:, :4]).max(axis=-1) <= 0.05
    kept: list[int] = []
    for i in range(len(ellipses)):
        if not apart[i, kept].any():
            kept.append(i)
    np.testing.assert_array_equal(distinct_rows(ellipses), kept)
    assert 5 < len(kept) < 1000
    assert distinct_rows(np.ones((100_000, 5))).tolist() == [0]
    assert distinct_rows(np.empty((0, 5))).tolist() == []
    column = np.zeros((5000, 5))
    column[:, 1] = np.arange(5000)
    assert len(distinct_rows(column)) == 5000


def test_single_rims_are_tried_within_bounds(synthetic, monkeypatch) -> None:
    """Of a large catalogue few rims: no answer comes in time."""
    rng = np.random.default_rng(16)
    scene = random_view(synthetic.catalog, ViewOptions(), rng, true_rims=(5, 5))
    asked = []

    def counted(view, index, craters, rims, *others):
        asked.append(len(rims) * len(craters.centres))
        return search_single_rims(view, index, craters, rims, *others)

    monkeypatch.setattr("craternav_fg.matching.identify.search.search_single_rims", counted)
    count = len(synthetic.catalog)
    for tried, rims in ((1, 1), (3 * count + 10, 3)):
        asked.clear()
        answer = identify(
            scene.mirrored(), scene.camera, synthetic, tracker(scene, rng), IdentifyOptions(tried=tried)
        )
        assert answer.status is Status.NO_ANSWER
        assert sum(asked) == rims * count


def test_a_large_index_is_searched_deeper_before_there_is_no_answer(synthetic, monkeypatch) -> None:
    examined = []

    def noted(*args):
        examined.append(args[11])
        search_triples(*args)

    monkeypatch.setattr("craternav_fg.matching.identify.search.search_triples", noted)
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    assert identify(view.ellipses_px, view.camera, synthetic).identified
    at_once = len(examined)
    assert max(examined) <= 160
    # 771,401 triples: seven times as many as this.
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 100_000)
    assert identify(view.ellipses_px, view.camera, synthetic).identified
    assert examined[at_once:] == examined[:at_once]
    assert not identify(view.mirrored(), view.camera, synthetic).identified
    assert max(examined) <= 160
    deep = IdentifyOptions(effort=Effort.DEEP)
    monkeypatch.setattr("craternav_fg.matching.identify.search._PAIRS_OF_CRATERS", 100_000)
    assert not identify(view.mirrored(), view.camera, synthetic, options=deep).identified
    # Eight times as many of the first triples.
    assert max(examined) == 8 * 7 * 160
    assert 7 * 16 in examined
    assert {16, 48, 160} <= set(examined)


def test_a_deeper_search_that_would_be_the_same_is_none(synthetic, monkeypatch) -> None:
    """In a small index, and with a known attitude."""
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    deep = IdentifyOptions(effort=Effort.DEEP)
    assert identify(view.ellipses_px, view.camera, synthetic, options=deep).status is Status.NO_ANSWER
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 100_000)
    known = tracker(view, np.random.default_rng(9))
    assert not identify(view.ellipses_px, view.camera, synthetic, known, deep).identified
    assert identify(view.ellipses_px, view.camera, synthetic, known).identified


def test_sizes_that_scatter_more_than_the_noise(synthetic) -> None:
    """By a tenth, as those of circles that people drew do: rims are found by their places."""
    rng = np.random.default_rng(8)
    exact_places = {"noise_levels_px": (1.0,), "candidates": (16,), "triples": 24}
    wide, narrow = IdentifyOptions(size_sigma_share=0.1, **exact_places), IdentifyOptions(**exact_places)
    found, at_default = 0, 0
    for _ in range(12):
        view = random_view(synthetic.catalog, ViewOptions(missing=0.3), rng, true_rims=(10, 16))
        size = np.exp(0.12 * rng.normal(size=len(view.ellipses_px)))[:, None]
        rims = view.ellipses_px * size ** np.array([0.0, 0.0, 1.0, 1.0, 0.0])
        answer = identify(rims, view.camera, synthetic, options=wide)
        assert not answer.identified or view.agrees(answer.rows)
        found += answer.identified
        at_default += identify(rims, view.camera, synthetic, options=narrow).identified
    assert found >= 9
    assert at_default <= 6


def test_the_deeper_search_expands_hypotheses_of_low_score(synthetic, monkeypatch) -> None:
    """Those of plains with few rims, and of maps most of whose craters the image does not show."""
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    rims = np.flatnonzero(view.craters >= 0)[:3]
    gTc = view.gTb @ view.camera.bTc
    right = np.concatenate(
        [[2.0], gTc[:3, :3].ravel(), gTc[:3, 3], [MOON.radius_m], rims, view.craters[rims]]
    )

    def low(*args):
        args[-1][0] = right

    monkeypatch.setattr("craternav_fg.matching.identify.search.search_triples", low)
    monkeypatch.setattr("craternav_fg.matching.identify.search._among_chosen", lambda *_: [])
    monkeypatch.setattr("craternav_fg.matching.identify.search._by_pairs", lambda *_: [])
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 100_000)
    assert not identify(view.ellipses_px, view.camera, synthetic).identified
    found = identify(view.ellipses_px, view.camera, synthetic, options=IdentifyOptions(effort=Effort.DEEP))
    assert found.identified
    assert view.agrees(found.rows)


def test_likely_and_large_rims_are_combined_wherever_they_are(synthetic, monkeypatch) -> None:
    """Among many false rims, the neighbours of a crater's rim are no craters."""
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 200_000)
    monkeypatch.setattr("craternav_fg.matching.identify.search._widely", lambda *_: [])
    options = ViewOptions(altitudes_m=(200e3, 500e3), false=0.9, missing=0.8, sigma_px=1.5)
    few = IdentifyOptions(effort=Effort.DEEP, noise_levels_px=(1.0,), candidates=(16,), triples=1)
    rng = np.random.default_rng(1)
    answered = []
    for seed in (7, 9, 12, 15):
        view = random_view(synthetic.catalog, options, np.random.default_rng(seed), true_rims=(8, 9))
        true = view.craters >= 0
        quality = np.where(true, 0.9, rng.uniform(0.02, 0.4, len(true)))
        found = identify(view.ellipses_px, view.camera, synthetic, options=few, quality=quality)
        with monkeypatch.context() as patch:
            patch.setattr("craternav_fg.matching.identify.search._among_chosen", lambda *_: [])
            patch.setattr("craternav_fg.matching.identify.search._by_pairs", lambda *_: [])
            without = identify(view.ellipses_px, view.camera, synthetic, options=few, quality=quality)
        assert view.agrees(found.rows)
        answered.append((found.identified, without.identified))
    with_them, without_them = np.sum(answered, axis=0)
    assert with_them == 4
    assert without_them <= 1


def test_a_promising_pose_is_expanded_with_finer_sizes(synthetic) -> None:
    """Small craters of plains are larger in images than on the map by a third and more."""
    coarse = {"size_factors": (1.0, 1.12, 1.25), "size_sigma_share": 0.1, "centre_share": 0.12}
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    rims = view.ellipses_px * np.array([1.0, 1.0, 1.4, 1.4, 1.0])
    evidence = []
    for fine in ((), (1.3, 1.4, 1.5)):
        given = Given(rims, view.camera, synthetic, None, IdentifyOptions(fine_size_factors=fine, **coarse))
        found = given.at_other_sizes(view.gTb @ view.camera.bTc, view.craters, 1.0)
        assert found is not None
        expanded, search_used = found
        assert view.agrees(expanded.match)
        assert search_used.log_ways == pytest.approx(np.log(3.0))
        evidence.append(expanded.log_ratio)
    assert evidence[1] > evidence[0] + 5.0


def test_an_answer_may_need_finer_sizes(synthetic, monkeypatch) -> None:
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 12))
    asked = []

    def noted(given, gTc, match, sigma_px):
        asked.append(given)
        found = given.search(1.0).expand_from(gTc.copy(), match.copy(), sigma_px)
        return (replace(found, log_ratio=20.0), given.search(1.0))

    monkeypatch.setattr(Given, "at_other_sizes", noted)
    assert identify(view.ellipses_px, view.camera, synthetic).identified
    assert not asked
    high = IdentifyOptions(log_chance=-1000.0, fine_size_factors=(1.1,), effort=Effort.PLAIN)
    none = replace(high, fine_size_factors=())
    assert not identify(view.ellipses_px, view.camera, synthetic, options=none).identified
    assert not asked
    assert not identify(view.ellipses_px, view.camera, synthetic, options=high).identified
    assert len(asked) == 1
    monkeypatch.setattr(search, "PROMISING", np.inf)
    assert not identify(view.ellipses_px, view.camera, synthetic, options=high).identified
    assert len(asked) == 1


def test_a_wide_search_also_tries_the_vertical_half_way_to_the_axis(synthetic, monkeypatch) -> None:
    """Where the estimate is far from the optical axis; circles and false rims make it uncertain."""
    tried = []
    monkeypatch.setattr(search, "_TRIPLES_OF_CANDIDATES", 200_000)
    monkeypatch.setattr(search, "_projected", lambda _, model: tried.append(model))
    monkeypatch.setattr(search, "_widely_with", lambda *_: [])
    rng = np.random.default_rng(3)
    counts = set()
    for tilt_deg in (2.0, 40.0):
        view = random_view(
            synthetic.catalog, ViewOptions(largest_tilt_deg=tilt_deg, sigma_px=0.2), rng, true_rims=(30, 60)
        )
        tried.clear()
        wide = IdentifyOptions(effort=Effort.WIDE)
        assert not identify(view.ellipses_px, view.camera, synthetic, options=wide).identified
        off_axis = [np.degrees(np.arccos(model[2])) for model in tried]
        counts.add(len(tried))
        assert (len(tried) == 2) == (off_axis[0] > 10.0)
        if len(tried) == 2:
            assert off_axis[1] == pytest.approx(0.5 * off_axis[0])
            assert tried[1][3] == tried[0][3]
            assert np.linalg.norm(tried[1][:3]) == pytest.approx(1.0)
    assert counts == {1, 2}


def test_right_craters_far_from_the_nearest_are_found_by_wide_search(synthetic, monkeypatch) -> None:
    """Rims that are larger than the map's, and off by a tenth of their size, among as many false ones."""
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 200_000)
    monkeypatch.setattr("craternav_fg.matching.identify.search._by_pairs", lambda *_: [])
    options = ViewOptions(altitudes_m=(200e3, 500e3), false=0.7, missing=0.7, sigma_px=1.0)
    coarse = IdentifyOptions(
        effort=Effort.WIDE, noise_levels_px=(1.0, 3.0), candidates=(16, 48), triples=1, size_sigma_share=0.1,
        centre_share=0.12,
    )  # fmt: skip
    for seed in (10, 7):
        rng = np.random.default_rng(seed)
        view = random_view(synthetic.catalog, options, rng, true_rims=(12, 16))
        n = len(view.craters)
        quality = np.where(view.craters >= 0, 0.8, rng.uniform(0.1, 0.8, n))
        rims = view.ellipses_px.copy()
        rims[:, 2:4] *= np.exp(rng.normal(0.15, 0.1, n))[:, None]
        rims[:, :2] += rng.normal(0.0, 0.1, (n, 2)) * np.sqrt(rims[:, 2] * rims[:, 3])[:, None]
        found = identify(rims, view.camera, synthetic, options=coarse, quality=quality)
        assert found.identified
        assert view.agrees(found.rows)
    monkeypatch.setattr("craternav_fg.matching.identify.search._widely", lambda *_: [])
    assert not identify(rims, view.camera, synthetic, options=coarse, quality=quality).identified


def test_the_optical_axis_meets_the_ground_in_nine_of_ten_images(synthetic) -> None:
    """A prior density: its mean over all attitudes is that of the uniform one."""
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    search = Search(view_of(view.ellipses_px, view.camera), synthetic, None, view.camera, IdentifyOptions())
    rng = np.random.default_rng(2)
    density, meets = [], []
    for R in Rotation.random(20_000, rng=rng).as_matrix():
        gTc = frames.pose(R, np.array([0.0, 0.0, MOON.radius_m + 2e5]))
        density.append(np.exp(search._log_prior(gTc)))
        # Below the horizon, seen from the pole.
        meets.append(-R[2, 2] > np.cos(np.arcsin(MOON.radius_m / (MOON.radius_m + 2e5))))
    density, meets = np.array(density), np.array(meets)
    assert density[meets].sum() / density.sum() == pytest.approx(0.9, abs=0.01)
    place = 4.0 * np.pi * (MOON.radius_m + 2e5) ** 2 * 2e5 * np.log(2000.0)
    assert density.mean() * place * 8.0 * np.pi**2 == pytest.approx(1.0, rel=0.02)


def test_a_pose_found_twice_is_not_ambiguous(synthetic, monkeypatch) -> None:
    """Several triples may lead to it: it was taken for its own rival."""
    view = random_view(synthetic.catalog, ViewOptions(), np.random.default_rng(8), true_rims=(8, 20))
    once = search._expanded
    monkeypatch.setattr(search, "_expanded", lambda *how: 2 * once(*how)[:1])
    found = identify(view.ellipses_px, view.camera, synthetic)
    assert found.status is Status.IDENTIFIED
    assert view.agrees(found.rows)


def test_a_small_body_is_identified_from_as_low_as_its_craters_are_small() -> None:
    """Bennu from 125 m, seventeen perfect rims or more; the search used to begin at 1 km."""
    body, rng = Body("Bennu", 245.03, 4.892, (0.0, 0.0, 0.0)), np.random.default_rng(5)
    index = TripleIndex.build(power_law_population(rng, body, 1300, (4.0, 40.0)))
    options = ViewOptions(altitudes_m=(125.0, 125.0), field_deg=44.0, sigma_px=0.0, missing=0.0, false=0.0)
    for _ in range(3):
        view = random_view(index.catalog, options, rng, true_rims=(17, 10_000))
        found = identify(view.ellipses_px, view.camera, index)
        assert found.identified
        np.testing.assert_array_equal(found.rows, view.craters)
        np.testing.assert_allclose(found.gTb[:3, 3], view.gTb[:3, 3], atol=0.05)


def test_altitudes_follow_the_sizes_of_the_craters() -> None:
    camera = square_camera(60.0)
    # Craters of kilometres: 1 km to 2000 km, however large the largest is.
    assert IdentifyOptions().searched_m(camera, np.array([500.0, 50e3])) == (1e3, 2e6)
    low_m, high_m = IdentifyOptions().searched_m(camera, np.array([2.0, 20.0]))
    # Eight radii of the smallest fill the side; the largest has two pixels.
    assert low_m == pytest.approx(8.0 * 2.0 / (2.0 * np.tan(np.radians(30.0))))
    assert high_m == pytest.approx(20.0 * camera.focal_px / 2.0)
    assert IdentifyOptions(altitudes_m=(3.0, 4.0)).searched_m(camera, np.array([500.0])) == (3.0, 4.0)


def test_pairs_of_large_rims_are_tried_where_the_map_has_many_more_craters(synthetic, monkeypatch) -> None:
    """Few neighbours of a crater are shown: the index has no triples of those that are."""
    monkeypatch.setattr("craternav_fg.matching.identify.search._TRIPLES_OF_CANDIDATES", 200_000)
    monkeypatch.setattr("craternav_fg.matching.identify.search._widely", lambda *_: [])
    options = ViewOptions(altitudes_m=(200e3, 500e3), missing=0.85, sigma_px=3.0)
    few = IdentifyOptions(effort=Effort.DEEP, triples=1)
    for seed in (2, 5, 9):
        view = random_view(synthetic.catalog, options, np.random.default_rng(seed), true_rims=(7, 12))
        found = identify(view.ellipses_px, view.camera, synthetic, options=few)
        assert found.identified
        assert view.agrees(found.rows)
    monkeypatch.setattr("craternav_fg.matching.identify.search._by_pairs", lambda *_: [])
    assert not identify(view.ellipses_px, view.camera, synthetic, options=few).identified
