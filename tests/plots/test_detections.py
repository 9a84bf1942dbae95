"""Overlays of detected rims."""

from pathlib import Path

import cv2
import numpy as np

from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.detect import FoundRims


def test_the_arrow_points_towards_the_sun(tmp_path: Path) -> None:
    """The sun is to the right, and the tip of an arrow is its broad end."""
    none = np.empty(0)
    rims = FoundRims(
        np.empty((0, 5)), np.empty((0, 5)), np.empty((0, 5, 5)), none, none.astype(bool), none, 0.0
    )
    write_overlay(tmp_path / "a.png", np.zeros((900, 900), np.uint8), rims)
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture is not None
    rows, columns = np.nonzero(np.ptp(picture.astype(int), axis=2) > 20)
    middle = 0.5 * (columns.min() + columns.max())
    assert np.ptp(rows[columns > middle]) > 3 * np.ptp(rows[columns < middle])
