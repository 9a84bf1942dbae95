"""Craters in the maps of a run: those along the whole track."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from craternav_fg.reports.crater_map import near_track, outlines
from craternav_fg.reports.recording import catalogue_rims
from tests.plots.test_ground_track import craters, orbit
from tests.plots.test_trajectories import MOON


def test_craters_along_the_whole_orbit_are_found() -> None:
    """A quarter of a revolution: 400 km are 13 deg of longitude."""
    catalog = craters([-14.0, -12.0, 45.0, 88.0, 102.0, 105.0, 225.0])
    for frames_count in (3, 80):
        rows = near_track(catalog, orbit(0.25, frames_count), MOON, 4.0)
        # Half the distance of the frames is added: 22 deg of three.
        assert rows.tolist() == ([1, 2, 3, 4] if frames_count == 80 else [0, 1, 2, 3, 4, 5])
    assert near_track(craters([]), orbit(0.25), MOON, 4.0).tolist() == []


def test_outlines_are_closed_and_as_large_as_the_rims() -> None:
    catalog = craters([0.0, 45.0])
    rims = outlines(catalog, np.array([1]), 25)
    np.testing.assert_allclose(rims[:, 0], rims[:, -1], atol=1e-6)
    away_m = np.linalg.norm(rims - catalog.centres[[1], None], axis=-1)
    np.testing.assert_allclose([away_m.max(), away_m.min()], [9e3, 7e3])


def test_a_recording_holds_the_craters_of_the_whole_track() -> None:
    run: Any = SimpleNamespace(trajectories={"smoother": orbit(0.25)})
    dataset: Any = SimpleNamespace(catalog=craters([-14.0, 2.0, 45.0, 88.0]), body=MOON)
    assert len(catalogue_rims(run, dataset)) == 3
