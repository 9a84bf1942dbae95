"""Refinement that is interrupted, and on workers elsewhere."""

from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.mapping import refine_chunks
from craternav_fg.mapping.refine import RefineOptions, refine_on_dem
from craternav_fg.mapping.refine_chunks import DemFile, KeptChunks, refine_in_chunks
from craternav_fg.workers import Workers
from tests.mapping.test_refine import MOON, world

pytest.importorskip("rasterio")
OPTIONS = RefineOptions(min_diameter_steps=25.0)


@pytest.fixture(scope="module")
def ground(tmp_path_factory):
    one = world(tmp_path_factory.mktemp("dem"), 1, 2.5, 0.8)
    # Heights of the model, too.
    circles = replace(one.circles, has_heights=False)
    model = DemFile(str(one.path), 1.0, MOON.radius_m)
    return circles, model, refine_on_dem(circles, model.read(), OPTIONS)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(refine_chunks, "CHUNK", 16)


def same(found, expected):
    assert found.outcomes == expected.outcomes
    for name, column in expected.columns().items():
        np.testing.assert_array_equal(found.columns()[name], column)
    for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m"):
        np.testing.assert_array_equal(getattr(found.catalog, name), getattr(expected.catalog, name))
    np.testing.assert_array_equal(found.catalog.errors.place_m, expected.catalog.errors.place_m)


def test_an_interrupted_refinement_goes_on_where_it_was(ground, tmp_path, monkeypatch):
    circles, model, expected = ground
    kept = KeptChunks.beside(tmp_path / "better.parquet", circles, model, OPTIONS)

    def interrupt(done, total):
        if done > 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        refine_in_chunks(circles, model, OPTIONS, kept, interrupt)
    before = len(list(kept.folder.glob("*.npz")))
    assert 2 <= before < 5
    measured = []

    def counted(catalog, dem, options):
        measured.append(len(catalog))
        return original(catalog, dem, options)

    original = refine_chunks.measure_rims
    monkeypatch.setattr(refine_chunks, "measure_rims", counted)
    again = KeptChunks.beside(tmp_path / "better.parquet", circles, model, OPTIONS)
    same(refine_in_chunks(circles, model, OPTIONS, again), expected)
    assert len(measured) == 5 - before
    again.remove()
    assert not kept.folder.exists()


def test_another_catalogue_or_other_options_begin_anew(ground, tmp_path):
    circles, model, _ = ground
    moved = replace(circles, longitude_rad=circles.longitude_rad + 1e-9)
    cases = [(circles, OPTIONS), (moved, OPTIONS), (circles, RefineOptions())]
    folders = {KeptChunks.beside(tmp_path / "x.parquet", one, model, how).folder for one, how in cases}
    assert len(folders) == 3


def test_workers_give_the_same(ground, tmp_path):
    circles, model, expected = ground
    kept = KeptChunks(tmp_path / "kept")
    done = []
    with ThreadPoolExecutor(2) as threads:
        workers = Workers(threads, 2, (BrokenExecutor,))
        found = refine_in_chunks(circles, model, OPTIONS, kept, lambda *both: done.append(both), workers)
    same(found, expected)
    assert done[-1] == (70, 70)


@pytest.mark.slow
def test_tasks_travel_to_other_processes(ground, tmp_path):
    circles, model, expected = ground
    with ProcessPoolExecutor(1) as pool:
        workers = Workers(pool, 2, (BrokenExecutor,))
        same(
            refine_in_chunks(circles, model, OPTIONS, KeptChunks(tmp_path / "kept"), None, workers), expected
        )
