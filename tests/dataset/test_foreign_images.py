"""Images of any origin are read as they are."""

import contextlib

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import InputError


@pytest.mark.parametrize(
    ("mode", "suffix", "shape", "dtype"),
    [
        ("L", "png", (20, 30), np.uint8),
        ("I;16", "png", (20, 30), np.uint16),
        ("F", "tif", (20, 30), np.float32),
        ("RGB", "jpg", (20, 30, 3), np.uint8),
        ("RGBA", "png", (20, 30, 4), np.uint8),
        ("P", "png", (20, 30, 3), np.uint8),
        ("CMYK", "tif", (20, 30, 3), np.uint8),
        ("1", "png", (20, 30), np.bool_),
    ],
)
def test_formats(tmp_path, mode, suffix, shape, dtype):
    path = tmp_path / f"image.{suffix}"
    Image.new(mode, (30, 20)).save(path)
    image = read_foreign_image(path)
    assert image.shape == shape
    assert image.dtype == dtype


def test_a_stack_of_images_and_one_to_be_shown_turned_are_refused(tmp_path):
    first, second, small = (
        Image.fromarray(np.full(shape, 7, np.uint8)) for shape in [(6, 8), (6, 8), (3, 4)]
    )
    first.save(tmp_path / "stack.tif", save_all=True, append_images=[second])
    with pytest.raises(InputError, match=r"stack\.tif: expected one image, found 2: save each as a file"):
        read_foreign_image(tmp_path / "stack.tif")
    first.save(tmp_path / "thumbnail.tif", save_all=True, append_images=[small])
    assert read_foreign_image(tmp_path / "thumbnail.tif").shape == (6, 8)
    exif = Image.Exif()
    for orientation in (1, 6):
        exif[0x0112] = orientation
        first.save(tmp_path / f"{orientation}.jpg", exif=exif)
    assert read_foreign_image(tmp_path / "1.jpg").shape == (6, 8)
    with pytest.raises(
        InputError, match="found an EXIF orientation of 6: turn the pixels, or remove the tag"
    ):
        read_foreign_image(tmp_path / "6.jpg")


@pytest.mark.parametrize(
    ("dtype", "void"), [(np.uint8, 255), (np.uint16, 0), (np.int32, -9999), (np.float32, -1e-8)]
)
def test_the_value_that_a_tiff_declares_to_mark_missing_pixels(tmp_path, dtype, void):
    pixels = np.arange(1, 49).reshape(6, 8).astype(dtype)
    pixels[2:4, 5:] = void
    image, tags = Image.fromarray(pixels), ImageFileDirectory_v2()
    for name, text in {"declared": str(void), "other": "77", "wrong": "none"}.items():
        tags[42113] = text
        image.save(tmp_path / f"{name}.tif", tiffinfo=tags)
    read = read_foreign_image(tmp_path / "declared.tif", opacity=True)
    assert read.dtype == dtype
    np.testing.assert_array_equal(read[..., 0], pixels)
    np.testing.assert_array_equal(read[..., 1] == 0, pixels == dtype(void))
    for name, opacity in (("declared", False), ("other", True), ("wrong", True)):
        plain = read_foreign_image(tmp_path / f"{name}.tif", opacity=opacity)
        np.testing.assert_array_equal(plain, pixels)


def test_a_pixel_is_missing_where_all_channels_are(tmp_path):
    pixels = np.full((6, 8, 3), 90, np.uint8)
    pixels[1, 1, 0], pixels[2, 2] = 0, 0
    tags = ImageFileDirectory_v2()
    tags[42113] = "0"
    Image.fromarray(pixels).save(tmp_path / "colour.tif", tiffinfo=tags)
    read = read_foreign_image(tmp_path / "colour.tif", opacity=True)
    assert np.argwhere(read[..., 3] == 0).tolist() == [[2, 2]]


@pytest.mark.parametrize("name", ["stack.tif", "void.tif", "one.tif", "one.png", "one.jpg", "one.gif"])
def test_any_byte_may_be_wrong(tmp_path, name):
    path = tmp_path / name
    image = Image.fromarray(np.full((6, 8), 7, np.uint8))
    others = {"save_all": True, "append_images": [image]} if name.startswith("stack") else {}
    if name == "void.tif":
        others["tiffinfo"] = ImageFileDirectory_v2()
        others["tiffinfo"][42113] = "7"
    image.save(path, **others)
    sound = path.read_bytes()
    for place in range(len(sound)):
        for value in (0, 255, sound[place] ^ 1, sound[place] ^ 128):
            path.write_bytes(sound[:place] + bytes([value]) + sound[place + 1 :])
            with contextlib.suppress(InputError):
                read_foreign_image(path, opacity=True)
