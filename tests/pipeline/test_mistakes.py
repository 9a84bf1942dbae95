"""Usual mistakes with images are told apart, on ground of the second world."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.pipeline import warnings
from craternav_fg.pipeline.mistakes import likely_mistake, turned_about_axis
from craternav_fg.pipeline.reconstruct import reconstruct
from tests.foreign.files import write
from tests.foreign.worlds import draw_world
from tests.peak_memory import run_measured


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(write(draw_world(1, "gentle", frames=2), tmp_path_factory.mktemp("foreign") / "d", 1))


def with_images(data: Dataset, folder: Path, change) -> Dataset:
    """Change the images of a data set."""
    paths = []
    for k, path in enumerate(data.image_paths):
        paths.append(folder / path.name)
        cv2.imwrite(str(paths[-1]), change(data.image(k)))
    return replace(data, image_paths=tuple(paths))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda image: image[:, ::-1], "it is mirrored left to right"),
        (lambda image: image[::-1, ::-1], "it is turned by 180 deg"),
        (lambda image: image.T, "it is transposed"),
        (lambda image: np.rot90(image), "it is turned by 90 deg clockwise"),
        (lambda image: np.rot90(image, -1), "it is turned by 90 deg anticlockwise"),
        (
            lambda image: 255 - image,
            "it is taken for a negative, or if the sun of sun.csv stands on the opposite side",
        ),
    ],
)
def test_images_spoilt_alike(data: Dataset, tmp_path: Path, change, said: str) -> None:
    assert said in likely_mistake(with_images(data, tmp_path, change), Descent.of(data))


def test_sun_and_sizes(data: Dataset) -> None:
    away = replace(data, sun=SunVectors(data.sun.stamps_ns, -data.sun.vectors))
    assert "sun.csv is reversed" in likely_mistake(away, Descent.of(data))
    c = data.catalog
    small = replace(c, semi_major_m=0.5 * c.semi_major_m, semi_minor_m=0.5 * c.semi_minor_m)
    assert "radii for diameters" in likely_mistake(replace(data, catalog=small), Descent.of(data))
    west = replace(c, longitude_rad=-c.longitude_rad)
    assert "are positive west" in likely_mistake(replace(data, catalog=west), Descent.of(data))
    south = replace(c, latitude_rad=-c.latitude_rad)
    assert "are positive south" in likely_mistake(replace(data, catalog=south), Descent.of(data))


def test_an_image_that_shows_nothing_is_not_asked(data: Dataset, tmp_path: Path) -> None:
    mirrored = with_images(data, tmp_path, lambda image: image[:, ::-1])
    cv2.imwrite(str(mirrored.image_paths[0]), np.full_like(data.image(0), 12))
    tried: list[tuple[int, int]] = []
    said = likely_mistake(mirrored, Descent.of(data), lambda *done: tried.append(done))
    assert f"found in {data.image_paths[1].name} if it is mirrored" in said
    assert tried == [(k, tried[0][1]) for k in range(len(tried))]
    assert len(tried) == tried[0][1] + 1


def test_mirrored_images_without_an_initial_state(data: Dataset, tmp_path: Path) -> None:
    mirrored = with_images(data, tmp_path, lambda image: image[:, ::-1])
    with pytest.raises(EstimationError, match=r"are identified in \d+\.png if it is mirrored"):
        reconstruct(replace(mirrored, initial=None), ["ekf"])


def test_a_camera_that_is_turned_is_recognised(data: Dataset) -> None:
    assert data.initial is not None
    gTb, camera = data.initial.gTb, data.camera
    for turn_deg, said in (([0.0, 0.0, 180.0], True), ([8.0, 5.0, 160.0], True), ([0.0, 0.0, 90.0], False)):
        turn = frames.pose(frames.rotation_exp(np.radians(turn_deg)), np.zeros(3))
        turned = gTb @ camera.bTc @ turn @ np.linalg.inv(camera.bTc)
        assert turned_about_axis(camera, gTb, turned) == said
    flipped = frames.pose(frames.rotation_exp(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    assert not turned_about_axis(camera, gTb, gTb @ camera.bTc @ flipped @ np.linalg.inv(camera.bTc))
    (text,) = warnings.replaced_states("replaced", (), "7 craters are found if it is turned by 180 deg")
    assert text.endswith("identified craters; 7 craters are found if it is turned by 180 deg")


def test_nothing_is_said_of_images_of_nothing(data: Dataset, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    grey = with_images(data, tmp_path, lambda image: rng.integers(90, 110, image.shape, dtype=np.uint8))
    assert likely_mistake(grey, Descent.of(data)) == ""


def test_the_mistake_is_in_the_warning(data: Dataset, tmp_path: Path) -> None:
    negative = with_images(data, tmp_path, lambda image: 255 - image)
    result = reconstruct(negative, ["ekf"])
    assert any("any frame" in text and "taken for a negative" in text for text in result.warnings)


def test_rims_that_are_excluded_are_not_missed(data: Dataset) -> None:
    result = reconstruct(data, ["ekf"], without=["rims"])
    assert not any("in any frame" in text or "should show" in text for text in result.warnings)
    assert any("no rim was measured in 2 of 2 frames" in text for text in result.warnings)


@pytest.mark.slow
def test_turned_images_need_no_more_memory(tmp_path: Path) -> None:
    """The search for a lost track once grew beyond 4 GB."""
    turned = write(draw_world(1, "gentle", frames=5), tmp_path / "d", 1)
    for path in (turned / "mav0" / "cam0" / "data").iterdir():
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::-1, ::-1])
    out = tmp_path / "run"
    done, peak_mb = run_measured("-m", "craternav_fg", "reconstruct", turned, "-o", out, "-e", "online,ekf")
    text = done.stderr
    # Craters are identified, as from a camera that is turned; the IMU is of one that is not.
    assert "or the camera or its images turned by 180 deg about the optical axis" in text, text
    assert len(text.splitlines()) == 1
    assert done.returncode == 2
    assert not out.exists()
    assert peak_mb < 1024.0
