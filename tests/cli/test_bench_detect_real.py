"""`craternav bench detect-real` on made-up annotated images."""

import json

import cv2
import numpy as np
import pytest

from craternav_fg.simulation.scenes import Ground, scene
from tests.cli.calls import call


@pytest.fixture(scope="module")
def annotated(tmp_path_factory):
    """A rendered image in place of a NAC mosaic, and boxes as people mark them."""
    one = scene(3, Ground(size_px=512))
    folder = tmp_path_factory.mktemp("real") / "annotated" / "nac"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "one.png"), one.image)
    x, y, a, b, _ = one.ellipses_px[(one.ellipses_px[:, 3] > 6.0)].T
    inside = (x > 0.0) & (x < 511.0) & (y > 0.0) & (y < 511.0)
    side = 2.0 * np.sqrt(a * b)
    rows = np.column_stack([0.0 * x, x + 0.5 - 0.5 * side, y + 0.5 - 0.5 * side, side, side])[inside]
    np.savetxt(folder / "one.txt", rows, fmt="%.3f", delimiter=",", header="ID,X,Y,W,H", comments="")
    return folder.parent.parent


def test_sizes_and_wear_are_told_and_nothing_is_nan(annotated):
    done = call("bench", "detect-real", "--data", annotated, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out, parse_constant=pytest.fail)
    sizes = {(row["method"], row["min_radius_px"]): row for row in result["by_size"]}
    assert sizes["network", 12.0]["recall"] > 0.9
    # No crater is so large.
    assert sizes["network", 104.0]["log_radius"] is None
    worn = [row for row in result["by_wear"] if row["method"] == "network"]
    assert len(worn) == 3
    assert sum(row["marked"] for row in worn) >= 5
    words = call("bench", "detect-real", "--data", annotated)
    assert "low contrast" in words.out
    assert "nan" not in words.out
