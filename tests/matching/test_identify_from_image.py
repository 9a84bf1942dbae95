"""Identification of images: which rims are detected where the first do not suffice."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.bench.identify_ground import (
    REMOVED_DEG,
    Answer,
    Fault,
    answer,
    published_catalog,
    run,
    summaries,
    without_regions,
)
from craternav_fg.matching.identify import from_image
from craternav_fg.matching.identify.from_image import identify_image
from craternav_fg.matching.identify.options import Effort
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.ground_views import GroundView, RealGround
from craternav_fg.simulation.scenes import MOON
from craternav_fg.vision.detect import FoundRims
from tests.cli.calls import call
from tests.shared_data import FOLDER, shared
from tests.vision.test_shading_maps import SUN_RAD as GROUND_SUN_RAD
from tests.vision.test_shading_maps import rough_ground

SUN_RAD = 0.7
IMAGE = np.zeros((8, 8), np.uint8)


@pytest.fixture(scope="module")
def index():
    return TripleIndex.build(synthetic_catalog(MOON, np.random.default_rng(0), count=2000))


@pytest.fixture(scope="module")
def view(index):
    return random_view(index.catalog, ViewOptions(), np.random.default_rng(5), true_rims=(16, 24))


def rims_of(ellipses):
    n = len(ellipses)
    unknown = np.full(n, SUN_RAD)
    return FoundRims(
        ellipses, ellipses, np.zeros((n, 5, 5)), np.full(n, 0.9), np.ones(n, bool), unknown, SUN_RAD
    )


@pytest.fixture
def detector(monkeypatch):
    """Answers in turn; notes direction towards the sun and minimum quality."""
    asked, answers = [], []

    def detect(image, sun_angle_rad=None, options=None):
        asked.append((sun_angle_rad, options and (options.min_quality, options.min_radius_px)))
        return answers[len(asked) - 1]

    monkeypatch.setattr(from_image, "find_rims_network", detect)
    return asked, answers


def test_rims_that_are_identified_are_detected_once(index, view, detector):
    asked, answers = detector
    answers.append(rims_of(view.ellipses_px))
    rims, found = identify_image(IMAGE, view.camera, index)
    assert found.identified
    assert view.agrees(found.rows)
    assert rims is answers[0]
    assert asked == [(None, None)]


def test_the_sun_may_be_on_the_other_side(index, view, detector):
    asked, answers = detector
    mirrored, right = rims_of(view.mirrored()), rims_of(view.ellipses_px)
    answers += [mirrored, right]
    rims, found = identify_image(IMAGE, view.camera, index)
    assert found.identified
    assert rims is right
    assert asked == [(None, None), (pytest.approx(SUN_RAD + np.pi), None)]


def test_less_likely_and_smaller_rims_come_last_and_without_an_answer_the_first_are_given(
    index, view, detector
):
    asked, answers = detector
    mirrored = rims_of(view.mirrored())
    answers += [mirrored, rims_of(view.mirrored()[:6]), mirrored, mirrored]
    rims, found = identify_image(IMAGE, view.camera, index)
    assert not found.identified
    assert rims is mirrored
    assert len(found.rows) == len(mirrored.ellipses_px)
    assert [(sun is None, quality) for sun, quality in asked] == [
        (True, None), (False, None), (False, (0.05, 5.0)), (False, (0.05, 5.0)),
    ]  # fmt: skip
    assert asked[3][0] - asked[2][0] == pytest.approx(np.pi)


def test_the_ground_shows_the_suns_axis_in_an_image_without_rims(index, view, detector):
    asked, answers = detector
    right = rims_of(view.ellipses_px)
    answers += [rims_of(np.empty((0, 5)))] * 2 + [right]
    image = rough_ground(np.random.default_rng(1)).astype(np.float32)
    rims, found = identify_image(image, view.camera, index)
    assert found.identified
    assert rims is right
    assert [at for at, _ in asked] == [
        None, pytest.approx(GROUND_SUN_RAD, abs=0.1), pytest.approx(GROUND_SUN_RAD + np.pi, abs=0.1),
    ]  # fmt: skip
    assert [least for _, least in asked] == [None, (0.05, 5.0), (0.05, 5.0)]


def test_an_image_without_rims(index, view, detector):
    _, answers = detector
    answers += [rims_of(np.empty((0, 5)))] * 3
    rims, found = identify_image(IMAGE, view.camera, index)
    assert not found.identified
    assert len(rims.quality) == 0


def test_rims_are_searched_deeper_once_no_others_are_found_at_once(index, view, detector, monkeypatch):
    """In the same order, as they were detected."""
    asked, answers = detector
    answers += [rims_of(view.ellipses_px[:n]) for n in (4, 5, 6, 7)]
    searched = []

    def noted(ellipses_px, traced, camera, index, attitude, options, quality, maps):
        searched.append((len(ellipses_px), options.effort))
        right = searched[-1] == (6, Effort.DEEP)
        mirrored = view.mirrored()[: len(ellipses_px)]
        return identify(view.ellipses_px if right else mirrored, camera, index)

    monkeypatch.setattr(from_image, "identify_detected", noted)
    rims, found = identify_image(IMAGE, view.camera, index)
    assert found.identified
    assert rims is answers[2]
    assert len(asked) == 4
    before = [(n, effort) for effort in (Effort.PLAIN, Effort.WIDE) for n in (4, 5, 6, 7)]
    assert searched == [*before, *((n, Effort.DEEP) for n in (4, 5, 6))]


def test_answers_are_grouped():
    nan = float("nan")
    answers = [
        Answer("gld100_mare", 70e3, 20.0, 30, True, False, 400.0, 0.1),
        Answer("gld100_mare", 150e3, 60.0, 3, False, False, nan, 2.0),
        Answer("gld100_mixed", 150e3, 60.0, 20, True, True, 9e5, 0.1),
    ]
    groups = {one.name: one for one in summaries(answers)}
    assert list(groups) == [
        "gld100_mare", "gld100_mixed", "60 to 90 km", "135 to 200 km", "sun 10 to 30 deg",
        "sun 50 to 70 deg", "all",
    ]  # fmt: skip
    assert groups["all"][1:5] == (3, 2, 1, 20.0)
    assert groups["all"].error_m == 400.0
    assert np.isnan(groups["gld100_mixed"].error_m)


@pytest.mark.parametrize("fault", [None, *Fault])
def test_every_answer_is_wrong_where_no_right_one_exists(index, view, monkeypatch, fault):
    given = []

    def identified(image, camera, index):
        given.append((image, camera.cx_px))
        return rims_of(view.ellipses_px), identify(view.ellipses_px, view.camera, index)

    monkeypatch.setattr("craternav_fg.bench.identify_ground.identify_image", identified)
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    camera = replace(view.camera, width_px=4, cx_px=1.0)
    found = answer("gld100_mare", GroundView(image, view.gTb, 1e5, 45.0), camera, index, fault)
    assert found.identified
    assert found.wrong is (fault is not None)
    mirrored = fault is Fault.MIRRORED
    np.testing.assert_array_equal(given[0][0], image[:, ::-1] if mirrored else image)
    assert given[0][1] == (2.0 if mirrored else 1.0)


def test_regions_are_removed_from_the_map(index):
    catalog = index.catalog
    up = catalog.centres / np.linalg.norm(catalog.centres, axis=1, keepdims=True)
    left = without_regions(catalog, up[:2])
    near = np.degrees(np.arccos(np.clip(up @ up[:2].T, -1.0, 1.0))).min(axis=1) < REMOVED_DEG
    assert 0 < near.sum() < len(catalog)
    assert left.identifiers == tuple(np.array(catalog.identifiers)[~near])


def test_the_benchmark_names_the_folder_it_needs(tmp_path):
    result = call("bench", "identify-ground")
    assert result.code == 2
    assert "expected --data, the folder of the public files" in result.err
    result = call("bench", "identify-ground", "--data", tmp_path)
    assert result.code == 2
    assert "lu1319381.parquet: not found" in result.err


@pytest.mark.slow
def test_images_of_real_ground_among_the_whole_catalogue():
    """Eight rendered images, the whole Moon's published catalogue: all are answered."""
    for name in ("southern_highlands", "imbrium_copernicus", "posidonius"):
        shared(f"gld100/gld100_256ppd_{name}.tif")
    shared("gld100/gld100_16ppd_global.tif"), shared("lu1319381.parquet")
    answers = run(FOLDER, 8, lambda done, total: None)
    assert sum(one.identified for one in answers) >= 7
    assert not any(one.wrong for one in answers)
    assert np.median([one.error_m for one in answers if one.identified]) < 3e3


@pytest.mark.slow
def test_three_craters_that_leave_the_attitude_uncertain_are_no_answer():
    """The first rims are three right craters in a row, with a pose 18 km off; later ones are 37 craters."""
    shared("gld100/gld100_256ppd_posidonius.tif"), shared("gld100/gld100_16ppd_global.tif")
    shared("lu1319381.parquet")
    ground = RealGround("gld100_mixed", FOLDER)
    index = TripleIndex.build(published_catalog(FOLDER))
    view = ground.view(np.random.default_rng([37, 53]))
    found = answer("gld100_mixed", view, ground.camera, index)
    assert found.identified
    assert found.error_m < 1e3
