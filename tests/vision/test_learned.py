"""Blind detection by the learned judgement: on renders, and on photographs that people annotated."""

import numpy as np
import pytest

from craternav_fg.bench import detect_real
from craternav_fg.errors import InputError
from craternav_fg.evaluation.annotation import Matches, match_circles, scores
from craternav_fg.reproduce.detection_accuracy import accuracy
from craternav_fg.simulation.scenes import HARD, scene
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import Candidates
from craternav_fg.vision.judge import crater_probability
from craternav_fg.vision.learned import LearnedOptions, find_rims_learned, lit_candidates
from tests.shared_data import FOLDER


@pytest.fixture(scope="module")
def scenes():
    """Of the simulator, on whose ground the network was not trained."""
    return [scene(seed) for seed in (0, 1)]


def test_plain_ground_has_the_same_rims(scenes):
    figures = accuracy(scenes, find_rims_learned)
    assert figures["recall"] >= 0.95
    assert figures["centre_px"] <= 0.15


def test_hard_ground_has_more_of_them():
    figures = accuracy([scene(seed, HARD) for seed in (0, 1)], find_rims_learned)
    assert figures["recall"] >= 0.9


def test_probability_does_not_depend_on_the_camera(scenes):
    """Turned, mirrored and darker images have the same probabilities."""
    image, _ = filled(brightness(scenes[0].image))
    found, _ = lit_candidates(image, None, LearnedOptions())
    sun = found.sun_angle_rad
    seen = crater_probability(image, found, sun)
    assert np.ptp(seen) > 0.8
    x, y = found.xy_px.T
    mirrored = Candidates(
        np.column_stack([image.shape[1] - 1.0 - x, y]), found.radius_px, found.correlation, np.pi - sun,
        found.slope_contrast,
    )  # fmt: skip
    flipped = crater_probability(np.ascontiguousarray(image[:, ::-1]), mirrored, np.pi - sun)
    assert np.quantile(np.abs(flipped - seen), 0.99) < 0.02
    dark = crater_probability(0.5 * image, found, sun)
    assert np.quantile(np.abs(dark - seen), 0.9) < 0.1


def test_scores_of_marks_that_are_known():
    """Three of four marked craters found, one false mark, one crater too small to count."""
    circles = np.array(
        [[50, 50, 20], [150, 50, 20], [50, 150, 20], [150, 150, 20], [200, 200, 9]], dtype=float
    )
    found = np.array([[50, 50, 21, 21, 0], [153, 50, 18, 22, 0], [50, 150, 20, 20, 0], [100, 100, 15, 15, 0]])
    quality = np.array([0.9, 0.8, 0.6, 0.7])
    matches = match_circles(found, quality, circles)
    result = scores(matches, 12.0, 0.5)
    assert (result.recall, result.precision) == (0.75, 0.75)
    assert scores(matches, 12.0, 0.75).precision == 1.0
    # Right down to two of four, then a false one, then the third at three of four marks.
    assert result.average_precision == pytest.approx(0.25 + 0.25 + 0.25 * 0.75)
    assert result.recall_at_90 == 0.5
    both = scores(Matches.joined([matches, matches]), 12.0, 0.5)
    assert (both.recall, both.precision) == (0.75, 0.75)


def test_real_images_need_their_annotation(tmp_path):
    with pytest.raises(InputError, match="expected annotated images"):
        detect_real.run(tmp_path, 0.5, lambda *_: None)
    (tmp_path / "annotated" / "nac").mkdir(parents=True)
    (tmp_path / "annotated" / "nac" / "one.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"one\.txt: file is missing"):
        detect_real.run(tmp_path, 0.5, lambda *_: None)


@pytest.mark.slow
def test_photographs_that_people_annotated():
    if not (FOLDER / "annotated").is_dir():
        pytest.skip("needs shared/data/annotated beside the project")
    rows = {
        (r.kind, r.method, r.min_radius_px): r.scores for r in detect_real.run(FOLDER, 0.5, lambda *_: None)
    }
    for radius_px in detect_real.RADII_PX:
        learned, rules = (rows["nac", method, radius_px] for method in ("learned", "template"))
        assert learned.recall > 2.3 * rules.recall
        assert learned.average_precision > 0.68
        assert learned.calibration_error < 0.06
        assert rows["hrsc", "learned", radius_px].average_precision > 0.8
