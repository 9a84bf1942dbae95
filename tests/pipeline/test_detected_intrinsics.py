"""Intrinsics by rims that nothing predicted: what is off is named, and nothing else."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline import input_warnings
from craternav_fg.pipeline.detected_intrinsics import DetectedIntrinsics, detected_intrinsics
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.simulation.scenario import simulate

SMALL = """
base = "lunar_descent"
seed = 11
[camera]
width_px = 640
height_px = 640
[trajectory]
duration_s = 24.0
frame_interval_s = 8.0
[trajectory.start]
altitude_m = 12000.0
downrange_m = -18000.0
vertical_speed_m_s = -100.0
ground_speed_m_s = 400.0
[craters]
min_apparent_px = 30.0
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("intrinsics")
    (folder / "small.toml").write_text(SMALL)
    return Dataset.open(simulate(folder / "small.toml", folder / "data"))


def by_rims(data: Dataset, rims: int = 0) -> DetectedIntrinsics | None:
    """Ask images of which as many rims as given were measured."""
    assert data.truth is not None
    one = RimSet(np.arange(rims), np.zeros((rims, 5)), np.tile(np.eye(5), (rims, 1, 1)))
    frames = [FrameMeasurement(int(stamp), one, None) for stamp in data.stamps_ns]
    expected = [12] * len(frames)
    return detected_intrinsics(data, Relocaliser(data), frames, expected, data.truth.gTb)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c, ""),
        (lambda c: replace(c, fx_px=1.02 * c.fx_px, fy_px=1.02 * c.fy_px), "focal length 2 +- "),
        (lambda c: replace(c, fx_px=0.98 * c.fx_px, fy_px=0.98 * c.fy_px), "% larger than the camera's"),
        (lambda c: replace(c, cx_px=c.cx_px + 6.0), "principal point (-5"),
    ],
)
def test_what_is_off_is_named(data: Dataset, change: Callable[[Camera], Camera], said: str) -> None:
    texts = input_warnings.deviating_intrinsics(by_rims(replace(data, camera=change(data.camera))))
    assert len(texts) == bool(said)
    assert said in "".join(texts)


def test_images_are_asked_only_where_rims_are_missing(data: Dataset) -> None:
    wrong = replace(data, camera=replace(data.camera, cx_px=data.camera.cx_px + 6.0))
    assert by_rims(wrong, rims=3) is None
    assert detected_intrinsics(wrong, Relocaliser(wrong), [], None, np.zeros((0, 4, 4))) is None
    unknown = replace(wrong, catalog=replace(wrong.catalog, has_heights=False))
    assert by_rims(unknown) is None
