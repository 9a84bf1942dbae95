"""Figures of a catalogue: what a region holds, and sizes without an area that nobody knows."""

import numpy as np
import numpy.typing as npt
import pytest

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import CraternavError
from craternav_fg.plots import catalogs
from tests.plots.test_trajectories import MOON


def catalog(east_km: npt.ArrayLike, semi_axes_km: npt.ArrayLike) -> Catalog:
    """Circles on the equator, at distances from the meridian."""
    longitude = 1e3 * np.asarray(east_km, dtype=float) / MOON.radius_m
    semi_m = 1e3 * np.asarray(semi_axes_km, dtype=float)
    zero = np.zeros(len(longitude))
    names = tuple(f"C{k}" for k in range(len(zero)))
    return Catalog(names, zero, longitude, semi_m, semi_m, zero, zero, MOON)


def title_of(found: Catalog) -> str:
    return catalogs.draw_region(found, 0.0, 0.0, 20e3).axes[0].get_title().split(" around")[0]


def test_a_region_counts_the_rims_that_reach_into_it() -> None:
    # The second's centre is outside, the third and the fourth end before the border at 20 km.
    found = catalog([3.0, 45.0, 45.0, -28.0], [1.0, 26.0, 24.0, 7.0])
    figure = catalogs.draw_region(found, 0.0, 0.0, 20e3)
    assert title_of(found) == "2 craters"
    np.testing.assert_allclose(
        np.sort(figure.axes[0].collections[0].get_offsets()[:, 0]), [3.0, 45.0], rtol=1e-6
    )
    # Inside a crater whose rim is beyond the window.
    inside = catalogs.draw_region(catalog([10.0], [58.0]), 0.0, 0.0, 20e3)
    assert "no crater here" not in "".join(text.get_text() for text in inside.axes[0].texts)
    assert title_of(catalog([10.0], [58.0])) == "1 crater"
    empty = catalogs.draw_region(catalog([90.0], [5.0]), 0.0, 0.0, 20e3)
    assert "no crater here" in empty.axes[0].texts[0].get_text()


def test_a_region_tells_all_craters_and_how_many_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogs, "_MAX_RIMS_IN_REGION", 3)
    found = catalog(np.linspace(-15.0, 15.0, 7), np.full(7, 1.0))
    title = catalogs.draw_region(found, 0.0, 0.0, 20e3).axes[0].get_title()
    assert title.startswith("7 craters around")
    assert "the largest 3 drawn" in title
    three = catalogs.draw_region(found.take(np.arange(3)), 0.0, 0.0, 20e3).axes[0].get_title()
    assert "drawn" not in three


def test_sizes_are_counted() -> None:
    """A regional catalogue covers a part of the body that nobody states."""
    axes = catalogs.draw_globe(catalog(np.linspace(-15.0, 15.0, 7), np.arange(1.0, 8.0))).axes[1]
    assert axes.get_ylabel() == "larger craters"
    assert axes.get_lines()[0].get_ydata().tolist() == [7, 6, 5, 4, 3, 2, 1]


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(CraternavError, match="found an empty catalogue"):
        catalogs.draw_globe(catalog([], []))
