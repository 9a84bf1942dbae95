"""Images of any origin are read as they are."""

import numpy as np
import pytest
from PIL import Image

from craternav_fg.dataset.foreign_images import read_foreign_image


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
