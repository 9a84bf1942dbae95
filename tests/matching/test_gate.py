"""Matching with a prior, on drawn scenes: what is right is known, and images have their own tests."""

import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.matching import gate_search
from craternav_fg.matching.gate import GateOptions, match_rims
from craternav_fg.matching.gate_search import GateSearch
from tests.machine import slowness

MOON = Body("Moon", 1737400.0, 4.902800118e12, (0.0, 0.0, 0.0))
bTc = frames.pose(frames.rotation_exp(np.array([0.1, -0.05, 1.5])), np.array([1.2, -0.3, 0.8]))
CAMERA = Camera(1024, 1024, 1267.0, 1267.0, 511.5, 511.5, bTc)
ALTITUDE_M = 50e3


def field(rng, count=150, half_rad=0.03, smallest_m=900.0):
    """Craters around 0, 0, larger ones fewer."""
    major = smallest_m * (1.0 - 0.95 * rng.random(count)) ** -0.5
    return Catalog(
        tuple(f"C{k}" for k in range(count)),
        rng.uniform(-half_rad, half_rad, count), rng.uniform(-half_rad, half_rad, count), major,
        major * rng.uniform(0.75, 1.0, count), rng.uniform(0.0, np.pi, count),
        200.0 * rng.standard_normal(count), MOON,
    )  # fmt: skip


def view(rng, altitude_m=ALTITUDE_M):
    """Pose of b that looks at the field, a little aslant."""
    z = frames.rotation_exp(0.2 * rng.standard_normal(3)) @ np.array([-1.0, 0.0, 0.0])
    x = np.cross(z, rng.standard_normal(3))
    x /= np.linalg.norm(x)
    gTc = frames.pose(
        np.stack([x, np.cross(z, x), z], axis=-1), np.array([MOON.radius_m + altitude_m, 0.0, 0.0])
    )
    return gTc @ frames.inverse(CAMERA.bTc)


def noise_of(charts, sigma_px=0.5):
    """Covariances (n, 5, 5) of rims whose axes and centres are good to some pixels."""
    sigma = sigma_px / CAMERA.focal_px
    size = np.exp(charts[:, [2, 4]])
    scale = np.column_stack(
        [np.full((len(charts), 2), sigma), sigma / size[:, 0], 2.0 * sigma * size[:, 1] / size[:, 0] ** 2,
         sigma / size[:, 1]]
    )  # fmt: skip
    return scale[:, :, None] ** 2 * np.eye(5)


def scene(rng, catalog, false_share=0.2, missing_share=0.25, altitude_m=ALTITUDE_M):
    """Return a pose, its rims in some order, and the crater of each, -1 for false ones."""
    gTb = view(rng, altitude_m)
    rows, charts = catalog.visible(CAMERA, gTb, min_semi_minor_px=10.0)
    keep = rng.random(len(rows)) > missing_share
    rows, charts = rows[keep], charts[keep]
    false = charts[rng.permutation(len(charts))[: int(false_share * len(charts))]].copy()
    false[:, :2] = rng.uniform(-0.35, 0.35, (len(false), 2))
    charts = np.concatenate([charts, false])
    covariances = noise_of(charts)
    charts = charts + np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances), rng.standard_normal((len(charts), 5))
    )
    truth = np.concatenate([rows, np.full(len(false), -1)])
    order = rng.permutation(len(charts))
    return gTb, charts[order], covariances[order], truth[order]


def wrong_prior(rng, gTb, sigma_rad, sigma_m):
    """Prediction off by three of its standard deviations, in some direction, and its covariance."""
    e = rng.standard_normal(6)
    e *= 3.0 / np.linalg.norm(e)
    prior = gTb.copy()
    prior[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(sigma_rad * e[:3])
    prior[:3, 3] += sigma_m * e[3:]
    return prior, np.diag([sigma_rad**2] * 3 + [sigma_m**2] * 3)


@pytest.mark.parametrize(
    ("sigma_deg", "sigma_m", "scenes"),
    [(0.05, 20.0, 40), (0.5, 200.0, 40), (3.0, 1000.0, 40), (25.0, 4000.0, 12)],
)
def test_priors_wrong_by_three_sigma(sigma_deg, sigma_m, scenes):
    rng = np.random.default_rng(11)
    catalog = field(rng)
    right = wrong = real = 0
    for _ in range(scenes):
        gTb, charts, covariances, truth = scene(rng, catalog)
        prior, covariance = wrong_prior(rng, gTb, np.radians(sigma_deg), sigma_m)
        found = match_rims(charts, covariances, CAMERA, catalog, prior, covariance)
        real += np.count_nonzero(truth >= 0)
        right += np.count_nonzero((found.craters == truth) & (truth >= 0))
        wrong += np.count_nonzero((found.craters >= 0) & (found.craters != truth))
        if np.count_nonzero(found.craters >= 0) > 4:
            error = np.concatenate(
                [frames.rotation_log(found.gTb[:3, :3].T @ gTb[:3, :3]), gTb[:3, 3] - found.gTb[:3, 3]]
            )
            assert error @ np.linalg.solve(found.pose_covariance, error) < 40.0
    assert real > 8 * scenes
    assert right / real >= 0.98
    assert wrong / (right + wrong) <= 0.002


def test_craters_that_the_catalogue_has_twice_end_no_search():
    """No attitude follows from two craters in one direction, for which two large neighbours may be taken."""
    rng = np.random.default_rng(12)
    catalog = field(rng)
    large = catalog.take(np.array([0, 1]))
    aside = np.array([0.0, 800.0]) / MOON.radius_m
    size_m = np.full(2, 4000.0)
    large = replace(
        large, identifiers=("D0", "D1"), latitude_rad=aside, longitude_rad=np.zeros(2), semi_major_m=size_m,
        semi_minor_m=size_m, height_m=np.zeros(2),
    )  # fmt: skip
    catalog = Catalog.joined([catalog, large])
    twice = Catalog.joined([catalog, replace(large.take(np.array([0])), identifiers=("D0b",))])
    gTb, charts, covariances, truth = scene(rng, catalog, 0.0, 0.0)
    assert {len(catalog) - 2, len(catalog) - 1} <= set(truth.tolist())
    prior, covariance = wrong_prior(rng, gTb, np.radians(1.0), 400.0)
    found = match_rims(charts, covariances, CAMERA, twice, prior, covariance)
    others = truth < len(catalog) - 2
    assert np.count_nonzero(found.craters[others] == truth[others]) >= 0.9 * np.count_nonzero(others)


@pytest.mark.parametrize("up_m", [-11.5e3, pytest.param(-7e3, marks=pytest.mark.slow), 11.5e3])
def test_an_altitude_known_to_half_of_itself(up_m):
    """Predicted below the ground, at an eighth of the altitude, or at more than twice it."""
    rng = np.random.default_rng(17)
    catalog = field(rng, 120, 0.006, 250.0)
    for _ in range(3):
        gTb, charts, covariances, truth = scene(rng, catalog, altitude_m=8e3)
        prior, covariance = wrong_prior(rng, gTb, np.radians(15.0), 0.0)
        covariance[3:, 3:] = 4e3**2 * np.eye(3)
        prior[0, 3] += up_m
        found = match_rims(charts, covariances, CAMERA, catalog, prior, covariance)
        np.testing.assert_array_equal(found.craters, truth)


def test_rims_smaller_than_any_crater_confirm_nothing_and_hinder_nothing():
    """Rough ground seen from near: what is found there is mostly smaller than what the catalogue knows."""
    rng = np.random.default_rng(18)
    catalog = field(rng)
    matched = 0
    for _ in range(10):
        gTb, charts, covariances, truth = scene(rng, catalog, 0.0, 0.0)
        few = rng.permutation(len(charts))[:3]
        small = np.column_stack(
            [rng.uniform(-0.35, 0.35, (300, 2)), np.full(300, -6.2), np.zeros(300), np.full(300, -6.2)]
        )
        every = np.concatenate([charts[few], small])
        prior, covariance = wrong_prior(rng, gTb, np.radians(5.0), 3000.0)
        found = match_rims(
            every, np.concatenate([covariances[few], noise_of(small)]), CAMERA, catalog, prior, covariance
        )
        assert np.all((found.craters[:3] == truth[few]) | (found.craters[:3] == -1))
        assert np.all(found.craters[3:] == -1)
        matched += np.count_nonzero(found.craters >= 0)
    assert matched >= 24


def test_what_two_craters_claim_is_given_to_neither():
    rng = np.random.default_rng(12)
    catalog = field(rng)
    gTb, charts, covariances, truth = scene(rng, catalog, 0.0, 0.0)
    prior, covariance = wrong_prior(rng, gTb, np.radians(0.5), 200.0)
    twin = catalog.take(truth[3:4])
    moved = Catalog(
        ("twin",), twin.latitude_rad + 10.0 / MOON.radius_m, twin.longitude_rad, twin.semi_major_m + 5.0,
        twin.semi_minor_m, twin.angle_rad, twin.height_m, MOON,
    )  # fmt: skip
    alone = match_rims(charts, covariances, CAMERA, catalog, prior, covariance)
    assert alone.craters[3] == truth[3]
    assert not alone.ambiguous.any()
    found = match_rims(charts, covariances, CAMERA, Catalog.joined([catalog, moved]), prior, covariance)
    assert found.craters[3] == -1
    assert found.ambiguous[3]
    np.testing.assert_array_equal(np.delete(found.craters, 3), np.delete(alone.craters, 3))


def test_a_rim_that_is_off_by_a_percent_of_its_size_is_its_craters_all_the_same():
    rng = np.random.default_rng(5)
    catalog = field(rng)
    gTb = view(rng)
    truth, charts = catalog.visible(CAMERA, gTb, min_semi_minor_px=20.0)
    covariances = noise_of(charts, 0.05)
    largest = int(np.argmax(charts[:, 4]))
    charts[largest, 2] += 0.012
    charts[largest, 4] -= 0.012
    prior, covariance = wrong_prior(rng, gTb, np.radians(0.5), 200.0)
    found = match_rims(charts, covariances, CAMERA, catalog, prior, covariance)
    np.testing.assert_array_equal(found.craters, truth)
    # Ten times the scatter of its points: by that alone it would be nobody's.
    strict = match_rims(charts, covariances, CAMERA, catalog, prior, covariance, GateOptions(floor_share=0.0))
    assert strict.craters[largest] == -1


def test_two_rims_of_one_crater_are_given_to_neither():
    rng = np.random.default_rng(13)
    catalog = field(rng)
    gTb, charts, covariances, truth = scene(rng, catalog, 0.0, 0.0)
    prior, covariance = wrong_prior(rng, gTb, np.radians(0.5), 200.0)
    again = np.concatenate([charts, charts[5:6]])
    found = match_rims(
        again, np.concatenate([covariances, covariances[5:6]]), CAMERA, catalog, prior, covariance
    )
    assert found.craters[5] == found.craters[-1] == -1
    assert np.count_nonzero(found.craters >= 0) >= len(truth) - 2


def test_a_rim_that_the_others_contradict_passes_the_prior_but_not_the_joint_gate():
    rng = np.random.default_rng(14)
    catalog = field(rng)
    gTb, charts, covariances, truth = scene(rng, catalog, 0.0, 0.0)
    # Off by ten pixels: within what the prior allows, not within what the other rims leave of it.
    charts[2, 0] += 10.0 / CAMERA.focal_px
    prior, covariance = wrong_prior(rng, gTb, np.radians(0.5), 200.0)
    found = match_rims(charts, covariances, CAMERA, catalog, prior, covariance)
    assert found.craters[2] == -1
    assert np.count_nonzero(found.craters == truth) >= len(truth) - 2
    alone = match_rims(charts[2:3], covariances[2:3], CAMERA, catalog.take(truth[2:3]), prior, covariance)
    assert alone.craters[0] == 0


@pytest.mark.parametrize(("sigma_deg", "sigma_m", "scenes"), [(3.0, 1000.0, 15), (25.0, 4000.0, 5)])
def test_mirrored_images_are_of_no_place(sigma_deg, sigma_m, scenes):
    rng = np.random.default_rng(15)
    catalog = field(rng)
    matched = 0
    for _ in range(scenes):
        gTb, charts, covariances, _ = scene(rng, catalog)
        prior, covariance = wrong_prior(rng, gTb, np.radians(sigma_deg), sigma_m)
        mirrored = charts * [-1.0, 1.0, 1.0, -1.0, 1.0]
        matched += np.count_nonzero(
            match_rims(mirrored, covariances, CAMERA, catalog, prior, covariance).craters >= 0
        )
    assert matched == 0


def test_nothing_in_nothing_out():
    rng = np.random.default_rng(16)
    catalog = field(rng)
    gTb, charts, covariances, _ = scene(rng, catalog)
    covariance = np.diag([1e-4] * 3 + [1e4] * 3)
    none = match_rims(charts[:0], covariances[:0], CAMERA, catalog, gTb, covariance)
    assert none.craters.shape == (0,)
    away = gTb.copy()
    away[:3, 3] *= -1.0
    lost = match_rims(charts, covariances, CAMERA, catalog, away, covariance, GateOptions())
    assert np.all(lost.craters == -1)
    np.testing.assert_array_equal(lost.gTb, away)


@pytest.mark.slow
def test_a_prediction_that_says_nothing_is_searched_in_bounded_memory_and_time():
    """1500 craters in reach: two million pairs of craters for each two rims are too many to hold."""
    rng = np.random.default_rng(8)
    catalog = field(rng, count=1500, half_rad=0.02, smallest_m=600.0)
    gTb = view(rng)
    charts = catalog.visible(CAMERA, gTb, min_semi_minor_px=10.0)[1]
    charts = charts[rng.choice(len(charts), 12, replace=False)]
    charts[:, :2] = rng.uniform(-0.35, 0.35, (12, 2))
    covariance = np.diag(np.repeat([1.0**2, (0.2 * ALTITUDE_M) ** 2], 3))
    tracemalloc.start()
    began = time.process_time()
    found = match_rims(charts, noise_of(charts), CAMERA, catalog, gTb, covariance)
    seconds = time.process_time() - began
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert not (found.craters >= 0).any()
    assert peak < 1 << 28
    assert seconds / slowness() < 30.0


def test_a_view_of_one_of_two_places_that_look_alike_is_of_neither():
    rng = np.random.default_rng(21)
    group = field(rng, 25, 0.012)
    between_rad = 0.004
    twin = Catalog(
        tuple(f"T{k}" for k in range(25)), group.latitude_rad + between_rad, group.longitude_rad,
        group.semi_major_m, group.semi_minor_m, group.angle_rad, group.height_m, MOON,
    )  # fmt: skip
    gTb = view(rng)
    truth, charts = group.visible(CAMERA, gTb, min_semi_minor_px=10.0)
    covariances = noise_of(charts)
    # Half-way to where the twin looks the same.
    middle = gTb.copy()
    middle[:3] = frames.rotation_exp(np.array([0.0, -0.5 * between_rad, 0.0])) @ gTb[:3]
    covariance = np.diag([0.01**2] * 3 + [3000.0**2] * 3)
    alone = match_rims(charts, covariances, CAMERA, group, middle, covariance)
    np.testing.assert_array_equal(alone.craters, truth)
    both = Catalog.joined([group, twin])
    found = match_rims(charts, covariances, CAMERA, both, middle, covariance)
    assert (found.craters == -1).all()
    assert found.ambiguous.all()
    np.testing.assert_array_equal(found.gTb, middle)
    # A better prediction tells them apart.
    near = match_rims(charts, covariances, CAMERA, both, gTb, np.diag([0.01**2] * 3 + [500.0**2] * 3))
    np.testing.assert_array_equal(near.craters, truth)


def test_rims_that_all_scatter_more_than_they_state_are_their_craters_all_the_same():
    rng = np.random.default_rng(31)
    catalog = field(rng)
    gTb = view(rng)
    truth, charts = catalog.visible(CAMERA, gTb, min_semi_minor_px=15.0)
    assert len(truth) > 12
    covariances = noise_of(charts)
    # Half as much again as what they state.
    off = 1.5 * np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.standard_normal(charts.shape))
    prior, covariance = wrong_prior(rng, gTb, np.radians(0.5), 200.0)
    options = GateOptions(floor_share=0.0)
    found = match_rims(charts + off, covariances, CAMERA, catalog, prior, covariance, options)
    assert ((found.craters == truth) | (found.craters == -1)).all()
    assert np.count_nonzero(found.craters == truth) >= len(truth) - 2
    # Among rims that are as good as they state, one such is left out.
    one = charts.copy()
    one[4] += 6.0 * np.linalg.cholesky(covariances[4]) @ np.array([1.0, 0.0, 1.0, 0.0, 0.0])
    found = match_rims(one, covariances, CAMERA, catalog, prior, covariance, options)
    assert np.flatnonzero(found.craters != truth).tolist() == [4]


@pytest.mark.parametrize("seed", range(3))
def test_seeds_together_and_one_pair_at_a_time_give_the_same_hypotheses(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    catalog = field(rng)
    gTb, charts, covariances, _ = scene(rng, catalog)
    covariance = np.diag([0.02**2] * 3 + [2000.0**2] * 3)
    search = GateSearch(charts, covariances, CAMERA, catalog, gTb, covariance, GateOptions())
    pairs, starts, possible = search._hypotheses()
    monkeypatch.setattr(gate_search, "_CHUNK", 0)
    again, same_starts, same_possible = search._hypotheses()
    assert len(pairs) > 50
    np.testing.assert_array_equal(again, pairs)
    np.testing.assert_allclose(same_starts, starts, rtol=1e-12)
    assert same_possible == possible
    # Each pair of seeds has all its craters.
    assert len(np.unique(pairs[:, ::2], axis=0)) > 20
