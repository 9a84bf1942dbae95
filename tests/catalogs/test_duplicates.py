import numpy as np

from craternav_fg.catalogs.duplicates import repeated_craters
from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.scenes import MOON


def catalog(*craters: tuple[float, float, float]) -> Catalog:
    """Circles: east and north of a place at latitude 60 deg, m, and radius, m."""
    east, north, radius_m = np.array(craters).T
    latitude = np.radians(60.0) + north / MOON.radius_m
    longitude = 3.0 + east / (MOON.radius_m * np.cos(latitude))
    n = len(craters)
    names = tuple(f"C{k}" for k in range(n))
    return Catalog(names, latitude, longitude, radius_m, radius_m, np.zeros(n), np.zeros(n), MOON)


def test_later_entries_of_a_crater_are_found() -> None:
    found = repeated_craters(
        catalog(
            (0.0, 0.0, 1000.0),
            (5000.0, 0.0, 800.0),
            # The first again, exactly and nearly.
            (0.0, 0.0, 1000.0),
            (60.0, -60.0, 1050.0),
            # The second again.
            (5070.0, 0.0, 790.0),
        )
    )
    assert found.tolist() == [2, 3, 4]


def test_craters_beside_and_within_others_are_no_repetitions() -> None:
    found = repeated_craters(
        catalog(
            (0.0, 0.0, 1000.0),
            # Concentric and smaller; of the same size and aside; a small one at the first one's middle.
            (0.0, 0.0, 880.0),
            (0.0, 120.0, 1000.0),
            (30.0, 0.0, 100.0),
        )
    )
    assert found.tolist() == []
    assert repeated_craters(catalog((0.0, 0.0, 1000.0))).tolist() == []
