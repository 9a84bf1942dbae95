"""Images that are copies of earlier ones: a buffer that was read twice, or a file copied over another."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np


def repeated_images(paths: Sequence[Path]) -> dict[int, int]:
    """Find the images whose files are the same, byte for byte, as an earlier one's.

    The noise of a camera makes any two of its images differ: a copy was not taken at its stamp. Images of one
    grey level, as of the night side or wholly overexposed, are alike without being copies.

    Parameters
    ----------
    paths : sequence of Path
        Of the frames' images.

    Returns
    -------
    dict of int to int
        Index of the first such frame, by the index of each later one.
    """
    by_size: dict[int, list[int]] = {}
    for index, path in enumerate(paths):
        if path.is_file():
            by_size.setdefault(path.stat().st_size, []).append(index)
    first: dict[bytes, int] = {}
    repeated: dict[int, int] = {}
    for same_size in by_size.values():
        for index in same_size if len(same_size) > 1 else ():
            content = paths[index].read_bytes()
            digest = hashlib.sha256(content).digest()
            if first.setdefault(digest, index) != index and not _is_uniform(content):
                repeated[index] = first[digest]
    return dict(sorted(repeated.items()))


def _is_uniform(content: bytes) -> bool:
    """Whether a file is an image of a single grey level."""
    image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    return image is not None and bool(image.min() == image.max())
