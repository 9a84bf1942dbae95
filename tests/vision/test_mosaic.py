"""Windows of mosaics, the sun of neighbours, and duplicates."""

import itertools

import numpy as np
import pytest

from craternav_fg.ellipse import axes_of_chart
from craternav_fg.vision.detect import BlindOptions, FoundRims
from craternav_fg.vision.mosaic import (
    LEVEL_RADIUS_PX,
    MARGIN_PX,
    core_side_px,
    kept_rims,
    merged_rims,
    mosaic_windows,
    pooled_suns,
    window_options,
)


def rims(circles, quality):
    """Rims (n, 3): centre x, y, radius, px."""
    x, y, radius = np.array(circles, dtype=np.float64).reshape(-1, 3).T
    charts = np.column_stack([x, y, np.log(radius), np.zeros(len(x)), np.log(radius)])
    return FoundRims(
        axes_of_chart(charts), charts, np.tile(np.eye(5), (len(x), 1, 1)),
        np.array(quality, dtype=np.float64), np.ones(len(x), np.bool_), np.zeros(len(x)), 0.0,
    )  # fmt: skip


@pytest.mark.parametrize("size", [(900, 1300), (5000, 4100), (64, 9000)])
def test_cores_tile_each_level_and_octaves_join(size):
    levels = mosaic_windows(*size, 8.0, 512)
    assert levels[0][0].radii_px[0] == 8.0
    assert levels[-1][0].radii_px[1] == min(size) / 4
    for fine, coarse in itertools.pairwise(levels):
        assert fine[0].radii_px[1] == coarse[0].radii_px[0]
    for windows in levels:
        step = windows[0].step
        seen = np.zeros((size[0] // step, size[1] // step), dtype=int)
        for window in windows:
            left, top, right, bottom = window.core
            seen[top:bottom, left:right] += 1
            # The largest craters are whole in the window, wherever in the core they are.
            west, north, east, south = window.outer
            assert west in (0, left - MARGIN_PX)
            assert east in (seen.shape[1], right + MARGIN_PX)
            assert 0 <= north <= top < bottom <= south <= seen.shape[0]
            assert window.radii_px[1] / step <= LEVEL_RADIUS_PX < MARGIN_PX
        assert np.all(seen == 1)
    assert mosaic_windows(30, 1000, 8.0, 256) == []


def test_small_mosaics_have_several_windows_and_large_ones_large():
    assert core_side_px(512, 1024) == 256
    assert core_side_px(2000, 9000) == 640
    assert core_side_px(20_000, 9000) == 1536


def test_radii_of_a_level_are_searched_in_its_pixels():
    (fine,), (coarse,), *_ = mosaic_windows(1200, 1200, 8.0, 2000)
    options = window_options(fine, BlindOptions())
    assert options.min_radius_px == 8.0
    assert options.max_radius_share * 1200.0 >= 80.0
    options = window_options(coarse, BlindOptions(min_quality=0.3))
    assert options.min_quality == 0.3
    assert 30.0 < options.min_radius_px < 40.0
    assert options.max_radius_share * 600.0 >= 80.0


def test_a_window_keeps_its_own_in_pixels_of_the_mosaic():
    levels = mosaic_windows(4000, 4000, 8.0, 512)
    window = levels[1][1 + len(levels[1]) // 2]
    left, top, right, bottom = window.core
    west, north, _, _ = window.outer
    middle = 0.5 * (left + right) - west, 0.5 * (top + bottom) - north
    found = rims(
        # Its own; too small, a little too small; far outside the core, and just outside.
        [
            (*middle, 60.0),
            (*middle, 20.0),
            (*middle, 35.0),
            (10.0, middle[1], 50.0),
            (120.0, middle[1], 50.0),
        ],
        np.full(5, 0.9),
    )
    known = np.ones((1000, 1000), np.bool_)
    kept = kept_rims(found, known, window, (4000, 4000))
    np.testing.assert_allclose(kept.ellipses_px[:, 2], [120.0, 70.0, 100.0])
    # The middle of the first pixel of a reduced copy is between those of the mosaic.
    np.testing.assert_allclose(kept.ellipses_px[0, :2], [left + right + 0.5, top + bottom + 0.5])
    np.testing.assert_allclose(np.diag(kept.covariance_px[0]), [4.0, 4.0, 1.0, 1.0, 1.0])
    # Most of the first rim's points without data; a third of the last one's.
    known[:, int(middle[0]) - 5 :] = False
    known[: int(middle[1]) + 45] = False
    assert len(kept_rims(found.take(np.array([0])), known, window, (4000, 4000))) == 0
    known[:] = True
    known[:, int(middle[0]) + 35 :] = False
    assert len(kept_rims(found.take(np.array([0])), known, window, (4000, 4000))) == 1


def test_of_duplicates_the_best_stays_and_neighbours_of_other_sizes_do():
    first = rims([(100.0, 100.0, 30.0), (100.0, 100.0, 12.0), (300.0, 100.0, 20.0)], [0.7, 0.6, 0.9])
    second = rims([(103.0, 98.0, 31.0), (329.0, 100.0, 20.0)], [0.8, 0.5])
    one, other = merged_rims([first, second]), merged_rims([second, first])
    expected = [(300.0, 20.0), (103.0, 31.0), (100.0, 12.0), (329.0, 20.0)]
    np.testing.assert_allclose(one.ellipses_px[:, [0, 2]], expected)
    np.testing.assert_array_equal(one.charts_px, other.charts_px)
    assert len(merged_rims([first.take(np.zeros(3, np.bool_))])) == 0


def test_neighbours_decide_where_a_window_does_not():
    windows = mosaic_windows(2000, 5000, 8.0, 500)[0]
    column = np.array([window.column for window in windows])
    right_half = column >= 5
    angle, sure = np.where(right_half, 0.0, np.pi), np.full(len(windows), 0.99)
    undecided, outvoted = (int(k) for k in np.flatnonzero(column == 8)[:2])
    angle[undecided], sure[undecided] = np.nan, 0.7
    angle[outvoted], sure[outvoted] = np.pi, 0.96
    found = pooled_suns(windows, angle, sure)
    assert abs(np.angle(np.exp(1j * found[undecided]))) < 0.3
    assert abs(np.angle(np.exp(1j * found[outvoted]))) < 0.3
    others = np.setdiff1d(np.arange(len(windows)), [undecided, outvoted])
    far = others[np.abs(column[others] - 4.5) > 1.0]
    np.testing.assert_array_equal(found[far], angle[far])
    # Nobody knows.
    assert np.isnan(pooled_suns(windows, np.full(len(windows), np.nan), np.full(len(windows), 0.6))).all()


def test_a_sun_without_a_probability_counts_as_certain():
    windows = mosaic_windows(2000, 2000, 100.0, 500)[0]
    angle = np.full(len(windows), 1.0)
    angle[0] = np.nan
    found = pooled_suns(windows, angle, np.full(len(windows), np.nan))
    np.testing.assert_allclose(found, 1.0)
