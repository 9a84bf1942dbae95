"""Fit of the quality of proposals, on made-up evidence."""

import numpy as np
import pytest

from craternav_fg.dataset.annotated_images import annotated_images
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.training.marked import samples, weights
from craternav_fg.vision.network_detect import QUALITY_WEIGHTS
from tests.shared_data import FOLDER


def test_weights_are_found_again():
    rng = np.random.default_rng(3)
    true = np.array([1.3, -0.5, -4.0, 1.0])
    n = 20000
    evidence = np.column_stack([rng.normal(0.0, 2.0, (n, 2)), rng.uniform(0.0, 1.0, n), np.ones(n)])
    right = rng.random(n) < 1.0 / (1.0 + np.exp(-evidence @ true))
    np.testing.assert_allclose(weights(evidence, right), true, atol=0.25)


@pytest.mark.slow
def test_the_shipped_quality_holds_on_each_half_of_the_images():
    """Mean quality and share of marked craters, on images that are a half of those of the fit."""
    if not (FOLDER / "annotated").is_dir():
        pytest.skip("needs shared/data/annotated beside the project")
    images = [one for one in annotated_images(FOLDER) if one.kind == "nac"]
    for half in (images[::2], images[1::2]):
        parts = [samples(read_foreign_image(one.path), one.circles_px) for one in half]
        evidence, right = (np.concatenate(values) for values in zip(*parts, strict=True))
        quality = 1.0 / (1.0 + np.exp(-evidence @ QUALITY_WEIGHTS))
        assert abs(quality.mean() - right.mean()) < 0.04
