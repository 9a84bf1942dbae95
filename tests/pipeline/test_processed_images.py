"""Images that were equalised, or enlarged by repeating rows or columns; and right ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray, write_image
from craternav_fg.pipeline import input_warnings
from craternav_fg.pipeline.processed_images import (
    ProcessedImages,
    has_flat_histogram,
    has_own_levels_in_corners,
    processed_images,
    repetition,
)
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.vision.image_blur import blur_px
from tests.cli.calls import call
from tests.foreign.files import write
from tests.foreign.worlds import draw_world
from tests.shared_data import shared

PHOTOGRAPHS = (
    "images/eros_near_m0126865998.png",
    "images/eros_near_m0157063318.png",
    *(f"apollo15/AS15-M-{number}_SML.png" for number in ("0295", "0297", "0300")),
)
Change = Callable[[ImageArray], np.ndarray]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(write(draw_world(1, "gentle", frames=2), tmp_path_factory.mktemp("foreign") / "d", 1))


@pytest.fixture(scope="module")
def image(data: Dataset) -> ImageArray:
    return data.image(0)


def jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)


def clahe(image: np.ndarray, clip: float = 4.0, tiles: int = 8) -> np.ndarray:
    return cv2.createCLAHE(clip, (tiles, tiles)).apply(image)


def looked_up(image: np.ndarray, curve: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Apply a curve from 0 to 1 by a table, which leaves gaps between grey levels where it is steep."""
    return np.rint(255.0 * curve(np.arange(256) / 255.0)).astype(np.uint8)[image]


def to_bits(image: np.ndarray, bits: int) -> np.ndarray:
    """Levels of more bits, with noise below the former ones."""
    noise = np.random.default_rng(1).random(image.shape)
    return ((image + noise) * 2.0 ** (bits - 8)).astype(np.uint16)


def ranked(image: np.ndarray) -> np.ndarray:
    """Each pixel's rank among all, in 16 bits."""
    ranks = np.empty(image.size, dtype=np.uint16)
    order = np.argsort(to_bits(image, 16), axis=None, kind="stable")
    ranks[order] = np.arange(image.size) * 65535 // image.size
    return ranks.reshape(image.shape)


RIGHT: dict[str, Change] = {
    "as it is": np.asarray,
    "JPEG": lambda image: jpeg(image, 40),
    "low contrast": lambda image: (90 + image * 0.25).astype(np.uint8),
    "few levels": lambda image: image // 32,
    "nearly black": lambda image: (image * 0.02).astype(np.uint8),
    "brightened": lambda image: looked_up(image, lambda x: x ** (1.0 / 2.2)),
    "darkened": lambda image: looked_up(image, lambda x: x**2.2),
    "companded": lambda image: looked_up(image, lambda x: np.log1p(50.0 * x) / np.log(51.0)),
    "stretched": lambda image: np.clip(3.0 * (image.astype(float) - 30.0), 0.0, 255.0).astype(np.uint8),
    "negative": lambda image: 255 - image,
    "12 bits": lambda image: to_bits(image, 12),
    "16 bits": lambda image: to_bits(image, 16),
}
EQUALISED: dict[str, Change] = {
    "OpenCV": cv2.equalizeHist,
    "Pillow": lambda image: np.asarray(ImageOps.equalize(Image.fromarray(image))),
    "JPEG": lambda image: jpeg(cv2.equalizeHist(image), 60),
    "16 bits": ranked,
    "black sky": lambda image: cv2.equalizeHist(np.where(np.arange(len(image))[:, None] < 120, 0, image)),
}


@pytest.mark.parametrize("name", RIGHT)
def test_right_images_are_not_told(image: ImageArray, name: str) -> None:
    changed = RIGHT[name](image)
    assert not has_flat_histogram(changed)
    assert not has_own_levels_in_corners(changed)
    assert not repetition(changed) or repetition(changed) == repetition(changed.T) == 1.0


@pytest.mark.parametrize("name", EQUALISED)
def test_equalised_images_are_found(image: ImageArray, name: str) -> None:
    assert has_flat_histogram(EQUALISED[name](image))


@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_photographs(name: str) -> None:
    photograph = cv2.imread(str(shared(name)), cv2.IMREAD_GRAYSCALE)
    for change in RIGHT.values():
        assert not has_flat_histogram(change(photograph))
        assert not has_own_levels_in_corners(change(photograph))
    assert repetition(photograph) == repetition(photograph.T) == 1.0
    assert has_flat_histogram(cv2.equalizeHist(photograph))


@pytest.mark.parametrize("phase_deg", [60.0, 65.0, 70.0, 75.0])
def test_a_smooth_sphere_on_black_sky_is_not_equalised(phase_deg: float) -> None:
    y, x = np.mgrid[-1.3:1.3:480j, -1.3:1.3:480j]
    z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    light = np.sin(np.radians(phase_deg)) * x + np.cos(np.radians(phase_deg)) * z
    sphere = np.rint(240.0 * np.where(z > 0.0, np.maximum(light, 0.0), 0.0)).astype(np.uint8)
    assert not has_flat_histogram(sphere)


def test_flat_blocks_of_a_compressed_image_are_no_enlargement(image: ImageArray) -> None:
    blocks = np.repeat(np.repeat(image[::8, ::8], 8, axis=0), 8, axis=1)
    assert repetition(blocks) == 1.0


def test_few_levels_and_few_pixels_do_not_tell() -> None:
    even = np.resize(np.arange(31, dtype=np.uint8), (100, 100))
    assert has_flat_histogram(even) is None
    assert has_flat_histogram(np.zeros((9, 9), dtype=np.uint8)) is None
    hot = np.zeros((100, 100), dtype=np.uint8)
    hot.ravel()[::30] = np.random.default_rng(1).integers(1, 256, len(hot.ravel()[::30]))
    assert has_flat_histogram(hot) is None


@pytest.mark.parametrize(("clip", "tiles"), [(2.0, 8), (4.0, 8), (40.0, 8), (3.0, 4)])
def test_local_equalisation_shows_in_the_corners(image: ImageArray, clip: float, tiles: int) -> None:
    assert has_own_levels_in_corners(clahe(image, clip, tiles))
    # One table for all of the image leaves gaps as well, which single other pixels do not fill.
    stretched = looked_up(image, lambda x: np.clip(3.0 * (x - 0.25), 0.0, 1.0))
    stretched[100, :256] = np.arange(256)
    assert has_own_levels_in_corners(stretched) is False
    # A single corner that is not black.
    dark = image.copy()
    dark[200:] = dark[:, 200:] = 0
    assert has_own_levels_in_corners(clahe(dark, clip, tiles)) is None


def test_flat_blocks_of_a_strong_compression_are_no_sign_of_local_equalisation() -> None:
    rng = np.random.default_rng(1)
    blocks = np.repeat(np.repeat(4 * rng.integers(10, 40, (64, 64), dtype=np.uint8), 8, axis=0), 8, axis=1)
    blocks[100:400] = rng.integers(0, 256, (300, 512))
    assert has_own_levels_in_corners(blocks) is None


@pytest.mark.parametrize("factor", [1.5, 2.0, 2.5, 3.0])
def test_enlarged_rows_are_counted(image: ImageArray, factor: float) -> None:
    rows = (np.arange(470) / factor).astype(int)
    # From an odd row on, as of a cropped image.
    enlarged = image[rows][1:]
    assert repetition(enlarged) == pytest.approx(factor, abs=0.02)
    assert repetition(enlarged.T) == 1.0


def test_rows_that_repeat_unevenly_were_not_enlarged() -> None:
    rng = np.random.default_rng(1)
    rows = rng.integers(0, 256, (400, 50), dtype=np.uint8)
    assert repetition(rows[np.sort(rng.integers(0, 400, 400))]) == 1.0
    # A hot column on black: its rows are alike.
    hot = np.zeros((400, 50), dtype=np.uint8)
    hot[:, 7] = 90
    assert repetition(hot) is None
    hot[:100] = rows[:100]
    assert repetition(hot) == 1.0
    assert repetition(np.repeat(rows[:9], 2, axis=0)) is None
    # Rows of one grey level each, as of a ramp.
    assert repetition(np.repeat(np.arange(200, dtype=np.uint8), 2)[:, None] * np.ones(50, np.uint8)) is None


def with_images(data: Dataset, folder: Path, images: list[np.ndarray]) -> Dataset:
    """Give a data set other images, of any number."""
    paths = tuple(folder / f"{k}.png" for k in range(len(images)))
    for path, image in zip(paths, images, strict=True):
        write_image(path, image)
    return replace(data, image_paths=paths, stamps_ns=np.arange(len(images)))


def seen(data: Dataset) -> ProcessedImages:
    """What is seen of images beside their blur."""
    return replace(processed_images(data), blur_px=None)


def test_nearly_all_images_must_show_it(data: Dataset, image: ImageArray, tmp_path: Path) -> None:
    flat = cv2.equalizeHist(image)
    black = np.zeros_like(image)
    assert seen(with_images(data, tmp_path, [flat, image] * 10)) == ProcessedImages(8)
    assert seen(with_images(data, tmp_path, [flat])) == ProcessedImages(1)
    some = with_images(data, tmp_path, [black, flat, flat, black])
    assert seen(some) == ProcessedImages(4, equalised=2)
    found = seen(with_images(data, tmp_path, [clahe(image)] * 3))
    assert found == ProcessedImages(3, locally_equalised=3)
    some = with_images(data, tmp_path, [black, flat, flat, black])
    some.image_paths[1].write_bytes(b"")
    some.image_paths[3].unlink()
    assert seen(some) == ProcessedImages(2)
    doubled = np.repeat(image[::2], 2, axis=0)
    found = seen(with_images(data, tmp_path, [doubled] * 20))
    assert found == ProcessedImages(8, repeated={"rows": (8, 2.0)})
    measured = replace(with_images(data, tmp_path, [flat] * 3), measurements=())
    assert seen(measured) == ProcessedImages()


def test_what_is_said() -> None:
    assert input_warnings.equalised_images(ProcessedImages(8)) == []
    assert input_warnings.repeated_lines(ProcessedImages(8)) == []
    (text,) = input_warnings.equalised_images(ProcessedImages(8, equalised=7))
    assert text.startswith("7 of 8 images that were looked at have all grey levels equally often")
    (text,) = input_warnings.equalised_images(ProcessedImages(8, equalised=7, locally_equalised=8))
    assert text.startswith("7 of 8 images")
    (text,) = input_warnings.equalised_images(ProcessedImages(8, locally_equalised=8))
    assert text.startswith("8 of 8 images that were looked at lack grey levels in their corners")
    (text,) = input_warnings.repeated_lines(
        ProcessedImages(8, repeated={"rows": (8, 2.0), "columns": (7, 1.5)})
    )
    assert text.startswith("of 8 images that were looked at, 8 have each of their rows 2 times and ")
    assert "and 7 have each of their columns 1.5 times, as in" in text


def test_blurrier_images_than_the_camera_states_are_told(
    data: Dataset, image: ImageArray, tmp_path: Path
) -> None:
    stated_px = data.camera.psf_sigma_px
    for bits in (8, 12):
        deep = replace(data, camera=replace(data.camera, bit_depth=bits))
        for more_px, told in ((0.0, False), (0.5, False), (2.0, True)):
            one = cv2.GaussianBlur(image, (0, 0), more_px) if more_px else image
            folder = tmp_path / f"{bits} {more_px}"
            folder.mkdir()
            some = with_images(deep, folder, [one if bits == 8 else to_bits(one, bits)] * 2)
            found = processed_images(some)
            assert found.blur_px == pytest.approx(np.hypot(stated_px, more_px), abs=0.45)
            assert bool(input_warnings.blurred_images(found, stated_px)) == told
    assert input_warnings.blurred_images(ProcessedImages(8), 0.7) == []


@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_photographs_are_told_only_once_blurred(name: str) -> None:
    photograph = cv2.imread(str(shared(name)), cv2.IMREAD_GRAYSCALE).astype(np.float32)
    for more_px, told in ((0.0, False), (2.0, True)):
        width = blur_px(cv2.GaussianBlur(photograph, (0, 0), more_px) if more_px else photograph)
        assert bool(input_warnings.blurred_images(ProcessedImages(8, blur_px=width), 0.7)) == told


def test_check_and_reconstruct_warn(tmp_path: Path) -> None:
    folder = write(draw_world(1, "gentle", frames=2), tmp_path / "d", 1)
    data = Dataset.open(folder)
    said = ("equally often", "have each of their rows 2 times")
    sound = (call("check", folder).err, "\n".join(reconstruct(data, ["ekf"]).warnings))
    for path in data.image_paths:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        write_image(path, cv2.equalizeHist(np.repeat(image[::2], 2, axis=0)))
    spoilt = (call("check", folder).err, "\n".join(reconstruct(data, ["ekf"]).warnings))
    for text in said:
        assert not any(text in warnings for warnings in sound)
        assert all(text in warnings for warnings in spoilt)
