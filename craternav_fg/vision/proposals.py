"""Craters that the network proposes, and the quarter of the image that the sun is in.

The network is asked for each direction towards the sun and each octave of radii apart (`pyramid`). Lit from
the wrong side bowls look like domes, which it does not propose: the quarter in which it sees most is the
sun's.

Levels are half an octave apart, so that most craters are seen at two resolutions. Their log odds are the mean
of the two best: what looks like a crater at one resolution alone is less likely one.
"""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.vision.crater_network import cells
from craternav_fg.vision.pyramid import LEAST_PX, MOST_PX, STRIDE_PX, level, levels, normalised, turned_back
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

QUARTERS = 4
# Least logarithm of the odds of a circle of a level, and of a proposal. A level that does not see a crater is
# counted with the first.
_LEAST_SEEN, _LEAST_LOG_ODDS = -4.0, -3.5
# Two circles of different levels are the same crater if their centres are closer than this share of the
# larger radius and the logarithms of their radii differ by less.
_SAME_CENTRE_SHARE, _SAME_LOG_RADIUS = 0.5, 0.55
# Levels of an octave.
_LEVELS_OF_OCTAVE = 2
# Peaks are highest within this window, cells.
_PEAK_WINDOW = 3
# Logarithm of the odds of the better of two opposite quarters, over `sun_excess`. It
# is kept below the fitted 6 of `craternav_fg.training.judgement`: noise shows small differences, too.
SUN_EVIDENCE_WEIGHT = 2.0
# Logarithm of the odds at which a quarter is not asked against another any more, and pixels of the levels
# that all quarters may be asked for.
SURE_LOG_ODDS, _COARSE_PX = float(np.log(99.0)), 120_000


class SunQuarter(NamedTuple):
    """The quarter of the image that the sun is in.

    Attributes
    ----------
    quarters : int
        See `pyramid.quarters_to_right`.
    log_odds : float
        Logarithm of its odds against the opposite one, at least 0.
    """

    quarters: int
    log_odds: float

    @property
    def probability(self) -> float:
        """Of it against the opposite one: 0.5 to 1."""
        return float(1.0 / (1.0 + np.exp(-self.log_odds)))


class Proposals:
    """What the network sees in an image, evaluated when it is asked for.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    min_radius_px, max_radius_px : float
        Radii searched.
    """

    def __init__(self, image: Float32Array, min_radius_px: float, max_radius_px: float) -> None:
        factor = min_radius_px / LEAST_PX
        height, width = image.shape
        count = levels((round(height / factor), round(width / factor)), max_radius_px / factor)
        enough = min(image.shape) >= STRIDE_PX * factor
        shrunk: list[Float32Array] = []
        for k in range(_LEVELS_OF_OCTAVE * count if enough else 0):
            if k < _LEVELS_OF_OCTAVE:
                shrunk.append(level(image, float(np.log2(factor) + k / _LEVELS_OF_OCTAVE)))
            else:
                shrunk.append(level(shrunk[-_LEVELS_OF_OCTAVE], 1.0))
        self._shape = height, width
        self._values = [normalised(values) for values in shrunk]
        # Smaller craters are seen at one level only.
        self._seen_twice_px = min_radius_px * 2.0 ** (1.0 / _LEVELS_OF_OCTAVE)
        self._seen: dict[tuple[int, int], FloatArray] = {}

    def circles(self, quarters: int) -> FloatArray:
        """Return the network's proposals for light from a quarter; a crater may be proposed several times.

        Parameters
        ----------
        quarters : int
            See `pyramid.quarters_to_right`.

        Returns
        -------
        ndarray, shape (n, 4)
            Centre x, y and radius, px; logarithm of the odds of a crater.
        """
        of_levels = [self._level(quarters, k) for k in range(len(self._values))]
        number = np.repeat(np.arange(len(of_levels)), [len(circles) for circles in of_levels])
        circles = _agreed(np.concatenate([np.empty((0, 4)), *of_levels]), number, self._seen_twice_px)
        return circles[circles[:, 3] > _LEAST_LOG_ODDS]

    def sun_quarter(self, voted: int | None = None) -> SunQuarter:
        """Find the quarter that the sun is in, from the largest craters on until the image shows it.

        Parameters
        ----------
        voted : int, optional
            Quarter that the shading shows: only it and the opposite one are asked for. Else all are.

        Returns
        -------
        SunQuarter
        """
        support = np.zeros(QUARTERS)
        asked = list(range(QUARTERS)) if voted is None else [voted, _opposite(voted)]
        best = asked[0]
        for number in reversed(self._octaves()):
            if self._values[number].size > _COARSE_PX:
                asked = [quarters for quarters in asked if quarters in (best, _opposite(best))]
            for quarters in asked:
                support[quarters] += self._support(quarters, number)
            best = max(asked, key=support.__getitem__)
            asked = [q for q in asked if q == best or _log_odds(support[best], support[q]) < SURE_LOG_ODDS]
            if len(asked) == 1:
                break
        return SunQuarter(best, _log_odds(support[best], support[_opposite(best)]))

    def support(self, quarters: int) -> float:
        """Return the number of craters that are seen lit from a quarter, as sum of their probabilities.

        Parameters
        ----------
        quarters : int
            See `pyramid.quarters_to_right`.
        """
        return sum(self._support(quarters, number) for number in self._octaves())

    def _octaves(self) -> range:
        """Numbers of levels an octave apart, which see each crater once."""
        return range(0, len(self._values), _LEVELS_OF_OCTAVE)

    def _support(self, quarters: int, number: int) -> float:
        return float(np.sum(1.0 / (1.0 + np.exp(-self._level(quarters, number)[:, 3]))))

    def _level(self, quarters: int, number: int) -> FloatArray:
        if (quarters, number) not in self._seen:
            values = self._values[number]
            # An even image, as of a night side, shows nothing, and would take as long as any other.
            seen = values.any()
            found = (
                _peaks(cells(np.ascontiguousarray(np.rot90(values, quarters)))) if seen else np.empty((0, 4))
            )
            scale = np.array([whole / part for whole, part in zip(self._shape, values.shape, strict=True)])
            found[:, :2] = (turned_back(found[:, :2], quarters, values.shape) + 0.5) * scale[::-1] - 0.5
            found[:, 2] *= np.sqrt(np.prod(scale))
            self._seen[quarters, number] = found
        return self._seen[quarters, number]


def sun_excess(support: float, opposite: float) -> float:
    """Difference of the `Proposals.support` of a quarter and the opposite one, over its deviation."""
    return (support - opposite) / float(np.sqrt(support + opposite + 1.0))


def _opposite(quarters: int) -> int:
    return (quarters + 2) % QUARTERS


def _log_odds(support: float, opposite: float) -> float:
    return SUN_EVIDENCE_WEIGHT * sun_excess(support, opposite)


def _peaks(seen: Float32Array) -> FloatArray:
    """Circles (n, 4) of a level: x, y, radius, px of the level, logarithm of the odds."""
    log_odds = seen[0]
    top = cv2.dilate(log_odds, np.ones((_PEAK_WINDOW, _PEAK_WINDOW), np.uint8))
    rows, columns = np.nonzero((log_odds >= top) & (log_odds > _LEAST_SEEN))
    _, x, y, log_radius = seen[:, rows, columns].astype(np.float64)
    return np.column_stack(
        [
            (columns + 0.5 + x) * STRIDE_PX - 0.5,
            (rows + 0.5 + y) * STRIDE_PX - 0.5,
            np.exp(log_radius) * np.sqrt(LEAST_PX * MOST_PX),
            log_odds[rows, columns],
        ]
    )


@njit(cache=True, error_model="numpy")
def _agreed(circles: FloatArray, number: IntArray, seen_twice_px: float) -> FloatArray:
    """Give each circle (n, 4) the mean with the best of another level that is the same crater.

    Log odds count alike, places and radii by their probabilities.
    """
    out = circles.copy()
    for i in range(len(circles)):
        if circles[i, 2] < seen_twice_px:
            continue
        other, best = -1, _LEAST_SEEN
        for j in range(len(circles)):
            if number[j] == number[i] or circles[j, 3] <= best:
                continue
            near = _SAME_CENTRE_SHARE * max(circles[i, 2], circles[j, 2])
            dx, dy = circles[j, 0] - circles[i, 0], circles[j, 1] - circles[i, 1]
            if dx * dx + dy * dy >= near * near:
                continue
            if abs(np.log(circles[j, 2] / circles[i, 2])) < _SAME_LOG_RADIUS:
                other, best = j, circles[j, 3]
        out[i, 3] = 0.5 * (circles[i, 3] + best)
        if other >= 0:
            ours, theirs = 1.0 / (1.0 + np.exp(-circles[i, 3])), 1.0 / (1.0 + np.exp(-best))
            for c in range(3):
                out[i, c] = (ours * circles[i, c] + theirs * circles[other, c]) / (ours + theirs)
    return out
