"""Images that were processed before they came here: equalised, enlarged by repeating lines, or blurred."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import InputError
from craternav_fg.vision.image_blur import blur_px
from factors.arrays import FloatArray, IntArray

# Images that are looked at, evenly spread: a descent's images were all processed alike.
_MAX_IMAGES = 8
# Of images that tell anything, so many show it: chance gives one that looks alike.
_LEAST_SHARE, _LEAST_IMAGES = 0.9, 2
# Largest distance of the cumulated histogram from the straight line of equal shares. Equalised images are
# within 0.005, and within 0.035 once compressed as JPEG; photographs and rendered images, also brightened,
# darkened or of another gamma, are beyond 0.1.
_MAX_FROM_LINE = 0.05
# A histogram of fewer levels fits the line by chance; so does that of a few bright pixels on black.
_LEAST_LEVELS, _LEAST_LIT_SHARE = 32, 0.05
# Of rows that an enlargement repeated, nearly all are as many times there as the others, or once more.
_REGULAR_SHARE = 0.95
# Repeated by chance, as in noiseless dark images, more than `1 - _REGULAR_SHARE` of the rows would be there
# thrice where the mean is as large as this.
_LEAST_FACTOR = 1.4
# Different rows that tell how often each is there.
_LEAST_ROWS = 8


@dataclass(frozen=True)
class ProcessedImages:
    """What the pixels of a data set's images show of earlier processing.

    Attributes
    ----------
    looked_at : int
        Number of images that were looked at.
    equalised : int
        Those whose histogram was made flat; 0 unless nearly all are.
    repeated : mapping of str to (int, float)
        For "rows" or "columns" that repeat: the number of images in which they do, and how many times each
        is there on average. Empty unless they do in nearly all.
    blur_px : float, optional
        Median width of the point-spread function that their spectra show, see `vision.image_blur`.
    """

    looked_at: int = 0
    equalised: int = 0
    repeated: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    blur_px: float | None = None


def processed_images(dataset: Dataset) -> ProcessedImages:
    """Look at some of a data set's images for traces of processing.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    ProcessedImages
        Without a finding where the rims are given. Images that cannot be read are passed over: they are named
        where their rims are measured.
    """
    if dataset.measurements is not None:
        return ProcessedImages()
    flat: list[bool | None] = []
    widths: list[float | None] = []
    factors: dict[str, list[float | None]] = {"rows": [], "columns": []}
    for index in np.unique(np.linspace(0, len(dataset) - 1, _MAX_IMAGES).astype(int)).tolist():
        try:
            image = dataset.image(index)
        except InputError:
            continue
        flat.append(has_flat_histogram(image))
        factors["rows"].append(repetition(image))
        factors["columns"].append(repetition(image.T))
        widths.append(blur_px((255.0 / dataset.camera.full_scale * image).astype(np.float32)))
    repeated = {}
    for name, values in factors.items():
        count = _nearly_all([None if value is None else value > 1.0 for value in values])
        if count:
            repeated[name] = (count, float(np.median([value for value in values if value and value > 1.0])))
    told = [one for one in widths if one is not None]
    width = float(np.median(told)) if len(told) >= _LEAST_IMAGES else None
    return ProcessedImages(len(flat), _nearly_all(flat), repeated, width)


def has_flat_histogram(image: ImageArray) -> bool | None:
    """Whether all grey levels between an image's darkest and brightest have equal shares of its pixels.

    The darkest level does not count: black sky and shadows stay together there when an image is equalised.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (height, width)

    Returns
    -------
    bool or None
        None where the image has too few levels to tell.
    """
    counts = np.bincount(image.ravel())
    levels: IntArray = np.flatnonzero(counts)
    shares: FloatArray = counts[levels[1:]] / max(int(counts[levels[1:]].sum()), 1)
    lit = 1.0 - counts[levels[0]] / image.size
    if len(levels) < _LEAST_LEVELS or lit < _LEAST_LIT_SHARE:
        return None
    line = (levels[1:] - levels[0]) / (levels[-1] - levels[0])
    # A level is anywhere between the shares below it without and with its own: programs differ.
    upper = np.cumsum(shares)
    outside = np.maximum(np.maximum(upper - shares - line, line - upper), 0.0)
    return bool(outside.max() < _MAX_FROM_LINE)


def repetition(image: ImageArray) -> float | None:
    """How many times each row of an image is there, if it was enlarged by repeating them.

    Noise makes any two rows of a camera differ. An enlargement repeats them evenly: each is there n times, or
    n and n + 1 times where the factor is not an integer. Rows of one grey level do not count: in the dark all
    are alike.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (height, width)

    Returns
    -------
    float or None
        Mean number; 1 if they do not repeat evenly; None where too few rows are different to tell.
    """
    # The first run of equal rows, and the last, may be cut by the image's edge.
    starts = np.flatnonzero((image[1:] != image[:-1]).any(axis=1)) + 1
    lengths: IntArray = np.diff(starts)
    first = image[starts[:-1]]
    lengths = lengths[(first != first[:, :1]).any(axis=1)]
    if len(lengths) < _LEAST_ROWS:
        return None
    mean = float(lengths.mean())
    regular = np.isin(lengths, (int(mean), int(mean) + 1)).mean()
    return mean if mean >= _LEAST_FACTOR and regular >= _REGULAR_SHARE else 1.0


def _nearly_all(found: Sequence[bool | None]) -> int:
    """How many images show a trace; 0 unless nearly all do that tell."""
    told = [one for one in found if one is not None]
    enough = len(told) >= _LEAST_IMAGES and sum(told) >= _LEAST_SHARE * len(told)
    return sum(told) if enough else 0
