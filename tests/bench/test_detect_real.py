"""Scores of blind detection against what people marked: of a made-up case, and of folders without images."""

import numpy as np
import pytest

from craternav_fg.bench import detect_real
from craternav_fg.errors import InputError
from craternav_fg.evaluation.annotation import Matches, match_circles, scores


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
    # In the order of quality: of the first, second, none, third; the last two are not found.
    assert matches.found_by.tolist() == [0, 1, 3, -1, -1]
    joined = Matches.joined([matches, matches])
    assert joined.found_by.tolist() == [0, 1, 3, -1, -1, 4, 5, 7, -1, -1]
    both = scores(joined, 12.0, 0.5)
    assert (both.recall, both.precision) == (0.75, 0.75)


def test_wear_is_the_order_of_contrast():
    """Six bowls, each fainter than the one before, and one that is too small."""
    image = np.full((120, 420), 100.0, np.float32)
    y, x = np.mgrid[:120, :420]
    circles = [[40.0 + 60.0 * k, 60.0, 20.0] for k in range(6)]
    for k, (u, v, r) in enumerate(circles):
        rho = np.hypot(x - u, y - v) / r
        image += np.where(rho < 1.0, (x - u) / r * (40.0 - 6.0 * k) * rho, 0.0).astype(np.float32)
    found = detect_real.wear_classes(image, np.array([*circles[::-1], [210.0, 10.0, 6.0]]))
    assert found.tolist() == [2, 2, 1, 1, 0, 0, -1]


def test_real_images_need_their_annotation(tmp_path):
    with pytest.raises(InputError, match="expected annotated images"):
        detect_real.run(tmp_path, 0.5, lambda *_: None)
    (tmp_path / "annotated" / "nac").mkdir(parents=True)
    (tmp_path / "annotated" / "nac" / "one.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"one\.txt: file is missing"):
        detect_real.run(tmp_path, 0.5, lambda *_: None)
