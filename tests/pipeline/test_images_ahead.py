"""Images that are read ahead."""

import numpy as np
import pytest

from craternav_fg.errors import InputError
from craternav_fg.pipeline.images_ahead import ImagesAhead


class Images:
    """Five images, of which one is damaged; notes what is read."""

    def __init__(self) -> None:
        self.read: list[int] = []

    def __len__(self) -> int:
        return 5

    def image(self, frame: int) -> np.ndarray:
        self.read.append(frame)
        if frame == 3:
            raise InputError("003.png", "image is damaged")
        return np.full((2, 2), frame, np.uint8)


def test_each_image_is_read_once_and_fails_where_it_is_asked_for() -> None:
    data = Images()
    ahead = ImagesAhead(data)  # type: ignore[arg-type]
    for k in (0, 0, 1, 2):
        assert (ahead.image(k) == k).all()
    for _ in range(2):
        with pytest.raises(InputError, match=r"003.png: image is damaged"):
            ahead.image(3)
    assert (ahead.image(4) == 4).all()
    # A failure is no result: the file may be there when it is asked for.
    assert data.read.count(3) == 3
    assert data.read.count(4) == 1


def test_images_in_any_order() -> None:
    data = Images()
    ahead = ImagesAhead(data)  # type: ignore[arg-type]
    assert [int(ahead.image(k)[0, 0]) for k in (4, 0, 2, 1)] == [4, 0, 2, 1]
