"""Detection in a mosaic that is too large for one array: windows, levels, the sun's direction, duplicates.

The mosaic is searched in overlapping windows, and again on copies reduced by two, four and so on, each with
the same windows. A level is responsible for an octave of radii, so that every crater is seen in a window that
is several times larger, at a resolution that it needs. A window keeps the craters whose centre is in its
core; the cores tile the mosaic. Those near the border of a core or of an octave may be kept twice: of
duplicates, the one of the best quality stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from craternav_fg.ellipse import axes_of_chart, mean_radius, points_on
from craternav_fg.vision.detect import BlindOptions, FoundRims
from factors.arrays import BoolArray, FloatArray

# Sides of the smallest and the largest cores, multiples of the usual blocks of a file, and what a window has
# around it, px of its level. A small mosaic has about three cores along its shorter side: its light may vary.
_CORES_PX, _CORE_STEP_PX, _CORES_OF_SIDE, MARGIN_PX = (256, 1536), 128, 3, 128
# Largest radius of a level, px of the level: the margin shows such a crater whole, and ground around it.
LEVEL_RADIUS_PX = 80.0
# Largest radius searched, as a share of the mosaic's shorter side.
MAX_RADIUS_SHARE = 0.25
# A level keeps craters beyond its octave by this factor, and a window those whose centre is beyond its core
# by this share of the radius: whoever measures a rim, it is kept.
_BEYOND_OCTAVE, _BEYOND_CORE_SHARE = 1.25, 0.25
# Two rims are one crater if their centres are closer than this share of the smaller mean radius and the
# logarithms of their mean radii differ by less, as in one image (`detect`).
_SAME_CENTRE_SHARE, _SAME_LOG_RADIUS = 0.5, 0.4
# Points of a rim that are looked up in the mask, and the share of them that must be known.
_RIM_POINTS, _MIN_KNOWN_SHARE = 48, 0.5
# Standard deviation, in cores, of the neighbourhood that shares a direction towards the sun. Logarithm of the
# odds that decide: those of a probability of 0.95; of a single window they are at most those of 0.99.
_SUN_REACH_CORES, _DECIDED_LOG_ODDS, _MAX_LOG_ODDS = 1.5, float(np.log(19.0)), float(np.log(99.0))
# A window that sees the sun farther than this from where its neighbourhood sees it is outvoted.
_OUTVOTED_RAD = float(np.deg2rad(45.0))


@dataclass(frozen=True)
class Window:
    """A part of a level, in px of the level; a pixel of level k is 2^k px of the mosaic wide.

    Attributes
    ----------
    level, row, column : int
    core, outer : tuple of int
        First column and row, last column and row plus one: of the part that the window is responsible for,
        and of all that it reads.
    radii_px : tuple of float
        Smallest and largest radius that the level is responsible for, px of the mosaic.
    """

    level: int
    row: int
    column: int
    core: tuple[int, int, int, int]
    outer: tuple[int, int, int, int]
    radii_px: tuple[float, float]

    @property
    def name(self) -> str:
        """Unique in the mosaic."""
        return f"level{self.level}_row{self.row:04d}_column{self.column:04d}"

    @property
    def step(self) -> int:
        """Pixels of the mosaic that a pixel of the level is wide."""
        return int(2**self.level)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre of the core, px of the mosaic."""
        left, top, right, bottom = self.core
        return 0.5 * self.step * (left + right), 0.5 * self.step * (top + bottom)


def core_side_px(height_px: int, width_px: int) -> int:
    """Choose the side of the cores of a mosaic.

    Parameters
    ----------
    height_px, width_px : int
        Size of the mosaic.

    Returns
    -------
    int
        In px of each level.
    """
    steps = round(min(height_px, width_px) / _CORES_OF_SIDE / _CORE_STEP_PX)
    least, most = _CORES_PX
    return min(max(steps * _CORE_STEP_PX, least), most)


def mosaic_windows(height_px: int, width_px: int, min_radius_px: float, core_px: int) -> list[list[Window]]:
    """Lay windows over a mosaic.

    Parameters
    ----------
    height_px, width_px : int
        Size of the mosaic.
    min_radius_px : float
        Smallest radius to search.
    core_px : int
        Side of a core, px of its level; at the mosaic's border up to half as much more.

    Returns
    -------
    list of list of Window
        By level, the finest first; empty when the mosaic is too small for any crater.
    """
    largest = MAX_RADIUS_SHARE * min(height_px, width_px)
    levels: list[list[Window]] = []
    least, number = min_radius_px, 0
    while least < largest:
        most = LEVEL_RADIUS_PX * 2.0**number
        if most > least:
            radii = least, min(most, largest)
            size = height_px >> number, width_px >> number
            levels.append(_windows(number, size, radii, core_px))
            least = most
        number += 1
    return levels


def _windows(level: int, size: tuple[int, int], radii: tuple[float, float], core_px: int) -> list[Window]:
    height, width = size
    out = []
    for row, (top, bottom) in enumerate(_cores(height, core_px)):
        for column, (left, right) in enumerate(_cores(width, core_px)):
            outer = (
                max(left - MARGIN_PX, 0), max(top - MARGIN_PX, 0),
                min(right + MARGIN_PX, width), min(bottom + MARGIN_PX, height),
            )  # fmt: skip
            out.append(Window(level, row, column, (left, top, right, bottom), outer, radii))
    return out


def _cores(length: int, core_px: int) -> list[tuple[int, int]]:
    """Cut a side; a rest of less than half a core belongs to the last one."""
    count = max(int(np.floor(length / core_px + 0.5)), 1)
    return [(k * core_px, length if k == count - 1 else (k + 1) * core_px) for k in range(count)]


def window_options(window: Window, options: BlindOptions) -> BlindOptions:
    """Return the options with which a window is searched.

    Parameters
    ----------
    window : Window
    options : BlindOptions
        For the whole mosaic.

    Returns
    -------
    BlindOptions
        Radii in px of the level.
    """
    least, most = window.radii_px
    left, top, right, bottom = window.outer
    side = min(right - left, bottom - top)
    if least > options.min_radius_px:
        least /= _BEYOND_OCTAVE
    share = min(_BEYOND_OCTAVE * most / window.step / side, options.max_radius_share)
    return replace(options, min_radius_px=least / window.step, max_radius_share=share)


def kept_rims(rims: FoundRims, known: BoolArray, window: Window, size: tuple[int, int]) -> FoundRims:
    """Select the rims that a window is responsible for, and give them in px of the mosaic.

    Parameters
    ----------
    rims : FoundRims
        In px of the window.
    known : ndarray of bool, shape (h, w)
        Which pixels of the window have data. Rims most of whose points have none are dropped.
    window : Window
    size : tuple of int
        Height and width of the mosaic.

    Returns
    -------
    FoundRims
        Pixel (0, 0) is the middle of the mosaic's first pixel.
    """
    rims = rims.take(_known_share(rims.charts_px, known) >= _MIN_KNOWN_SHARE)
    charts = rims.charts_px.copy()
    step = float(window.step)
    charts[:, :2] = (charts[:, :2] + np.array(window.outer[:2]) + 0.5) * step - 0.5
    charts[:, [2, 4]] += np.log(step)
    scale = np.array([step, step, 1.0, 1.0, 1.0])
    moved = replace(
        rims, charts_px=charts, ellipses_px=axes_of_chart(charts),
        covariance_px=rims.covariance_px * np.outer(scale, scale),
    )  # fmt: skip
    radius = mean_radius(charts)
    least, most = window.radii_px
    of_level = (radius >= least / _BEYOND_OCTAVE) & (radius < most * _BEYOND_OCTAVE)
    left, top, right, bottom = (step * side for side in window.core)
    # A crater that the mosaic's border cuts may have its centre beyond.
    left, top = (side if side > 0.0 else -np.inf for side in (left, top))
    right = right if right <= size[1] - step else np.inf
    bottom = bottom if bottom <= size[0] - step else np.inf
    x, y = charts[:, 0], charts[:, 1]
    slack = _BEYOND_CORE_SHARE * radius
    own = (x >= left - slack) & (x < right + slack) & (y >= top - slack) & (y < bottom + slack)
    return moved.take(of_level & own)


def _known_share(charts: FloatArray, known: BoolArray) -> FloatArray:
    """Share (n,) of the points of rims that have data; those beyond the window have none."""
    columns, rows = np.moveaxis(np.rint(points_on(charts, _RIM_POINTS)).astype(np.int64), -1, 0)
    height, width = known.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    there = inside & known[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    return np.asarray(there.mean(axis=1)) if len(charts) else np.zeros(0)


def pooled_suns(windows: Sequence[Window], angles_rad: FloatArray, probability: FloatArray) -> FloatArray:
    """Find where the sun is in each window, from what it and its neighbours see.

    Parameters
    ----------
    windows : sequence of Window
        Of one level, n of them.
    angles_rad : ndarray, shape (n,)
        Direction towards the sun that each sees, in the image, from x towards y; NaN for none.
    probability : ndarray, shape (n,)
        Of this direction against its opposite; NaN where it is not estimated, which counts as certain.

    Returns
    -------
    ndarray, shape (n,)
        The window's own direction, or that of its neighbourhood if the window sees none or is outvoted; NaN
        where the neighbourhood is undecided, too.
    """
    seen = ~np.isnan(angles_rad)
    sure = np.where(np.isnan(probability), 1.0, probability)
    with np.errstate(divide="ignore"):
        log_odds = np.minimum(np.log(sure) - np.log1p(-sure), _MAX_LOG_ODDS)
    votes = np.where(seen, log_odds, 0.0) * np.exp(1j * np.where(seen, angles_rad, 0.0))
    places = np.array([window.centre_px for window in windows]).reshape(-1, 2)
    out = np.full(len(windows), np.nan)
    if not windows:
        return out
    left, _, right, _ = windows[0].core
    width = _SUN_REACH_CORES * (right - left) * windows[0].step
    tree = cKDTree(places)
    for k, place in enumerate(places):
        near = np.array(sorted(tree.query_ball_point(place, 3.0 * width)))
        weight = np.exp(-0.5 * np.sum((places[near] - place) ** 2, axis=1) / width**2)
        pooled = complex(np.sum(weight * votes[near]))
        towards = float(np.angle(pooled))
        decided = abs(pooled) >= _DECIDED_LOG_ODDS
        own = float(angles_rad[k])
        off = abs(np.angle(np.exp(1j * (towards - own)))) if seen[k] else np.inf
        out[k] = towards if decided and off > _OUTVOTED_RAD else own
    return out


def merged_rims(parts: Sequence[FoundRims]) -> FoundRims:
    """Put the rims of all windows together, the best first, each crater once.

    Parameters
    ----------
    parts : sequence of FoundRims
        In px of the mosaic; one or more.

    Returns
    -------
    FoundRims
        Without a common direction towards the sun.
    """
    joined = FoundRims(
        np.concatenate([part.ellipses_px for part in parts]),
        np.concatenate([part.charts_px for part in parts]),
        np.concatenate([part.covariance_px for part in parts]),
        np.concatenate([part.quality for part in parts]),
        np.concatenate([part.traced for part in parts]),
        np.concatenate([part.local_sun_angles_rad for part in parts]),
        float("nan"),
    )
    # Rims of equal quality are ordered by place, whichever window has found them.
    order = np.lexsort((joined.charts_px[:, 1], joined.charts_px[:, 0], -joined.quality))
    joined = joined.take(order)
    return joined.take(_distinct(joined.charts_px))


def _distinct(charts: FloatArray) -> BoolArray:
    """Mask (n,) of the rims that are no earlier one again."""
    places, radius = charts[:, :2], mean_radius(charts)
    kept = np.zeros(len(charts), dtype=np.bool_)
    if not len(charts):
        return kept
    log_radius = np.log(radius)
    tree = cKDTree(places)
    for k in range(len(charts)):
        near = np.array(tree.query_ball_point(places[k], _SAME_CENTRE_SHARE * radius[k]), dtype=np.int64)
        near = near[(near < k) & kept[near]]
        apart = np.hypot(*(places[near] - places[k]).T)
        same = apart < _SAME_CENTRE_SHARE * np.minimum(radius[near], radius[k])
        kept[k] = not np.any(same & (np.abs(log_radius[near] - log_radius[k]) < _SAME_LOG_RADIUS))
    return kept
