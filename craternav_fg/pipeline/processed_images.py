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
# Local equalisation treats a corner of this share of width and height alike, to the middle of its tile: there
# are 8 tiles across an image as a rule.
_CORNER_SHARE = 1 / 16
# Share of a corner's pixels whose grey level is there without its neighbours. It is 0.02 at most in images
# that were not equalised locally, 0.3 and more, seldom 0.1, in those that were.
_LEAST_ISOLATED = 0.1
# Corners that tell: so many, each with so many pixels for each level, and not of a few levels. Where more
# pixels are equal to the next one, a strong compression has left flat blocks.
_LEAST_CORNERS, _LEAST_PER_LEVEL, _LEAST_CORNER_LEVELS, _MOST_EQUAL = 2, 20, 4, 0.5
# Share of lit pixels of an image without black sky, and least share of levels that a table leaves out.
_MOST_SKY, _LEAST_GAPS = 0.9, 0.02
# Of rows that an enlargement repeated, nearly all are as many times there as the others, or once more.
_REGULAR_SHARE = 0.95
# Repeated by chance, as in noiseless dark images, more than `1 - _REGULAR_SHARE` of the rows would be there
# thrice where the mean is as large as this.
_LEAST_FACTOR = 1.4
# Rows that are there more often are the flat blocks of a JPEG file, of eight rows each.
_LARGEST_FACTOR = 6.0
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
    locally_equalised : int
        Those that were equalised tile by tile, as their corners show; 0 unless nearly all are.
    repeated : mapping of str to (int, float)
        For "rows" or "columns" that repeat: the number of images in which they do, and how many times each
        is there on average. Empty unless they do in nearly all.
    blur_px : float, optional
        Median width of the point-spread function that their spectra show, see `vision.image_blur`.
    """

    looked_at: int = 0
    equalised: int = 0
    locally_equalised: int = 0
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
    local: list[bool | None] = []
    widths: list[float | None] = []
    factors: dict[str, list[float | None]] = {"rows": [], "columns": []}
    for index in np.unique(np.linspace(0, len(dataset) - 1, _MAX_IMAGES).astype(int)).tolist():
        try:
            image = dataset.image(index)
        except InputError:
            continue
        flat.append(has_flat_histogram(image))
        local.append(has_own_levels_in_corners(image))
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
    return ProcessedImages(len(flat), _nearly_all(flat), _nearly_all(local), repeated, width)


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
    # A sphere on black sky may have all levels equally often, but has them all: a table leaves some out.
    gaps = 1.0 - len(levels) / float(levels[-1] - levels[0] + 1)
    return bool(outside.max() < _MAX_FROM_LINE and (lit > _MOST_SKY or gaps > _LEAST_GAPS))


def has_own_levels_in_corners(image: ImageArray) -> bool | None:
    """Whether the corners of an image lack every other grey level, which the image has elsewhere.

    Local equalisation (CLAHE) spreads the levels of each tile by a table of its own, which leaves gaps.
    Between the middles of tiles it mixes their tables, which fills the gaps; only corners show a single
    table. One table for the whole image, as of a gamma correction, leaves the same gaps everywhere.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (height, width)

    Returns
    -------
    bool or None
        None where too few corners have enough pixels for each level to tell.
    """
    height, width = (max(int(_CORNER_SHARE * size), 1) for size in image.shape)
    everywhere = np.bincount(image.ravel(), minlength=int(image.max()) + 2)
    shares = []
    for corner in (
        image[:height, :width],
        image[:height, -width:],
        image[-height:, :width],
        image[-height:, -width:],
    ):
        counts = np.bincount(corner.ravel(), minlength=len(everywhere))
        levels: IntArray = np.flatnonzero(counts)
        dense = corner.size >= _LEAST_PER_LEVEL * len(levels) and len(levels) >= _LEAST_CORNER_LEVELS
        if not dense or np.count_nonzero(corner[:, 1:] == corner[:, :-1]) > _MOST_EQUAL * corner.size:
            continue
        inner = levels[levels > 0]
        alone = counts[inner - 1] + counts[inner + 1] == 0
        # As frequent as the level itself.
        elsewhere = everywhere[inner - 1] + everywhere[inner + 1] >= everywhere[inner]
        shares.append(counts[inner[alone & elsewhere]].sum() / corner.size)
    return bool(np.median(shares) > _LEAST_ISOLATED) if len(shares) >= _LEAST_CORNERS else None


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
    enlarged = _LEAST_FACTOR <= mean <= _LARGEST_FACTOR and regular >= _REGULAR_SHARE
    return mean if enlarged else 1.0


def _nearly_all(found: Sequence[bool | None]) -> int:
    """How many images show a trace; 0 unless nearly all do that tell."""
    told = [one for one in found if one is not None]
    enough = len(told) >= _LEAST_IMAGES and sum(told) >= _LEAST_SHARE * len(told)
    return sum(told) if enough else 0
