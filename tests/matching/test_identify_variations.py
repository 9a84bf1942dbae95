"""Poses that are right but for a few wrong pairs: they are found again, or said to be uncertain."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.matching.identify import answer, expansion
from craternav_fg.matching.identify.expansion import Expanded, Search
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.view import view_of
from craternav_fg.simulation.catalog_views import ViewOptions, random_view
from factors.kernels.gauss_newton import screw_between

# Rims whose places scatter with their size, as those of circles on worn ground do.
REAL = IdentifyOptions(
    centre_share=0.12, size_sigma_share=0.1, noise_levels_px=(1.0, 3.0), candidates=(16, 48),
    focal_sigma_share=0.0, principal_sigma_px=0.0,
)  # fmt: skip


def test_wrong_craters_on_one_side_are_left(synthetic) -> None:
    """One of 1000 scenes at 3 px was answered so: far rims taken for other craters, at a noise of 8 px."""
    rng = np.random.default_rng()
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {
            "state": 200200957707476522165901572288625743487,
            "inc": 72763549156770659863042999813056722643,
        },
        "has_uint32": 0,
        "uinteger": 536245512,
    }
    scene = random_view(synthetic.catalog, ViewOptions(sigma_px=3.0), rng, true_rims=(9, 10_000))
    assert scene.agrees(identify(scene.ellipses_px, scene.camera, synthetic).rows)
    kept = [2, 3, 6, 7, 11, 21, 24, 30, 31, 33, 34, 38, 39, 41, 42, 45, 47, 48, 50]
    wrong = {
        4: 4647, 9: 14379, 10: 15982, 13: 18919, 16: 5997, 22: 3498, 27: 8000, 28: 787, 32: 4616, 37: 19150,
    }  # fmt: skip
    match = np.full(len(scene.craters), -1)
    match[kept] = scene.craters[kept]
    match[list(wrong)] = list(wrong.values())
    search = Search(
        view_of(scene.ellipses_px, scene.camera), synthetic, None, scene.camera, IdentifyOptions()
    )
    found = search.best_variation(Expanded(scene.gTb, match, np.eye(6), np.full(3, 8.0), 34.0))
    true = scene.craters >= 0
    assert np.mean(found.match[true] == scene.craters[true]) > 0.9


@pytest.fixture(scope="module")
def distorted(synthetic):
    """Rims in a corner of an image, and one far from them that is another crater's at a tilted pose."""
    options = ViewOptions(altitudes_m=(300e3, 300e3), false=0.0, missing=0.0, largest_tilt_deg=5.0)
    scene = random_view(synthetic.catalog, options, np.random.default_rng(5), true_rims=(60, 400))
    places = scene.ellipses_px[:, :2]
    near = np.argsort(np.linalg.norm(places - 150.0, axis=1))[:10]
    # Tilted about the ground that these rims show.
    ground = synthetic.craters.centres[scene.craters[near]].mean(axis=0)
    turn = frames.rotation_exp(np.radians(6.0) * scene.gTb[:3, 0])
    tilted = frames.pose(turn, ground - turn @ ground) @ scene.gTb
    rows, charts = synthetic.catalog.visible(scene.camera, tilted, min_semi_minor_px=5.0)
    ellipses = axes_of_chart(pixel_chart(charts, scene.camera))
    small = (ellipses[:, 0] > 700.0) & (ellipses[:, 1] > 700.0) & ~np.isin(rows, scene.craters[near])
    far = np.flatnonzero(small)[np.argmin(ellipses[small, 2])]
    rims = np.concatenate([scene.ellipses_px[near], ellipses[far][None]])
    match = np.append(scene.craters[near], rows[far])
    search = Search(view_of(rims, scene.camera, 0.1, 0.12), synthetic, None, scene.camera, REAL)
    return scene, search, tilted, match


def test_a_wrong_crater_that_outweighs_the_others_is_left(distorted, monkeypatch) -> None:
    """Over real ground one small rim of 17 moved a pose by 11 km, and its evidence was e^24 lower."""
    scene, search, tilted, match = distorted
    wrong_is_left, errors_m = [], []
    for left_out in (expansion._LEFT_OUT, 0):
        monkeypatch.setattr(expansion, "_LEFT_OUT", left_out)
        start = search.expand_from(tilted.copy(), match.copy(), 3.0)
        found = search.best_variation(start)
        wrong_is_left.append(found.match[-1] != match[-1])
        errors_m.append(float(np.linalg.norm(found.gTc[:3, 3] - scene.gTb[:3, 3])))
    assert wrong_is_left == [True, False]
    assert errors_m[0] < 0.5 * errors_m[1]


def test_a_pair_that_outweighs_the_others_widens_the_covariance(distorted, monkeypatch) -> None:
    """In case it is wrong."""
    scene, search, tilted, match = distorted
    nees = []
    for usual in (answer._MOST_EXCESS, np.inf):
        monkeypatch.setattr(answer, "_MOST_EXCESS", usual)
        wrong = search.expand_from(tilted.copy(), match.copy(), 3.0)
        assert wrong.match[-1] == match[-1]
        found = answer.answer(wrong, search, np.arange(len(match)), len(match), scene.camera, 0.0)
        error = np.empty(6)
        screw_between(found.gTb, scene.gTb, error)
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert nees[0] < 16.0
    assert nees[1] > 2.0 * nees[0]


def test_a_pose_that_the_rims_hardly_determine_is_none(distorted, synthetic, monkeypatch) -> None:
    """Three rims close together fit somewhere else as well, at a noise of a few pixels."""
    scene, search, _, match = distorted
    three = Search(
        view_of(scene.ellipses_px[np.isin(scene.craters, match[:3])], scene.camera, 0.1, 0.12), synthetic,
        None, scene.camera, REAL,
    )  # fmt: skip
    rows = scene.craters[np.isin(scene.craters, match[:3])]
    assert three.expand_from(scene.gTb.copy(), rows.copy(), 3.0) is None
    monkeypatch.setattr(expansion, "_MAX_ATTITUDE_SIGMA_RAD", np.inf)
    uncertain = three.expand_from(scene.gTb.copy(), rows.copy(), 3.0)
    assert np.trace(np.linalg.inv(uncertain.N)[:3, :3]) > 0.1**2
    monkeypatch.undo()
    assert search.expand_from(scene.gTb.copy(), np.append(match[:-1], -1), 3.0) is not None
