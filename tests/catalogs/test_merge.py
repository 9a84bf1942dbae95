"""Catalogues merged: each crater once, ellipses kept, sources told."""

import csv
import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.files import import_catalog, write_catalog
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.merge import MergeOptions, difference, merge, same_craters
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.app import app
from craternav_fg.errors import InputError
from tests.shared_data import shared

MOON = named_body("Moon")


def _catalog(names, lat, lon, major_km, minor_km=None, body=MOON) -> Catalog:
    major = 500.0 * np.array(major_km, dtype=float)
    minor = major if minor_km is None else 500.0 * np.array(minor_km, dtype=float)
    zero = np.zeros(len(major))
    return Catalog(tuple(names), np.radians(lat), np.radians(lon), major, minor, zero, zero, body)


# 0.1 deg are 3 km.
ONE = _catalog(["a", "b", "c"], [0.0, 10.0, 20.0], [0.0, 0.0, 0.0], [20.0, 30.0, 12.0])
OTHER = _catalog(
    ["b", "x", "y", "z"], [10.05, 0.02, 20.0, 40.0], [0.0, 0.0, 0.4, 0.0], [31.0, 19.0, 12.0, 9.0],
    [29.0, 17.0, 12.0, 8.0],
)  # fmt: skip


def test_a_crater_of_two_sources_stands_once_with_its_ellipse():
    merged = merge([ONE, OTHER], ["one", "other"])
    assert merged.catalog.identifiers == ("a", "b", "c", "y", "z")
    # What was a circle has the other's ellipse and its place, under the first's name.
    assert merged.source.tolist() == [1, 1, 0, 1, 1]
    assert merged.also_in == ((0,), (0,), (), (), ())
    assert merged.catalog.semi_minor_m[0] == 8500.0
    assert merged.catalog.latitude_rad[1] == OTHER.latitude_rad[0]
    # The other way round ellipses are there from the first.
    back = merge([OTHER, ONE], ["other", "one"])
    assert back.catalog.identifiers == ("b", "x", "y", "z", "c")
    assert back.source.tolist() == [0, 0, 0, 0, 1]
    assert back.also_in == ((1,), (1,), (), (), ())


def test_heights_that_a_source_does_not_know_are_not_those_of_the_sphere():
    high = replace(ONE, height_m=np.array([-1500.0, 700.0, 300.0]))
    # All of its craters are duplicates: their ellipses are taken, and the heights stay.
    shapes = replace(OTHER.take(np.array([0, 1])), has_heights=False)
    merged = merge([high, shapes], ["high", "shapes"]).catalog
    assert merged.has_heights
    assert merged.height_m.tolist() == [-1500.0, 700.0, 300.0]
    assert merged.semi_minor_m[0] == 8500.0
    # One that is new has no height: then no rim has one.
    merged = merge([high, replace(OTHER, has_heights=False)], ["high", "other"]).catalog
    assert not merged.has_heights
    assert not merged.height_m.any()
    both = merge([high, replace(OTHER, height_m=np.full(4, 50.0))], ["high", "other"]).catalog
    assert both.has_heights
    assert both.height_m.tolist() == [50.0, 50.0, 300.0, 50.0, 50.0]


def test_a_source_that_states_no_errors_is_not_exact_beside_one_that_does():
    rng = np.random.default_rng(1)
    lat, size = np.linspace(-60.0, 60.0, 100), np.full(100, 20.0)
    one = _catalog([f"a{k}" for k in range(100)], lat, np.zeros(100), size)
    other = _catalog(
        [f"b{k}" for k in range(100)], lat + 0.02 * rng.standard_normal(100), np.zeros(100), size
    )
    exact = replace(one, errors=MapErrors(*np.full((3, 100), 1e-3)))
    extra = _catalog(["new"], [0.0], [90.0], [20.0])
    merged = merge([exact, Catalog.joined([other, extra])], ["one", "other"]).catalog
    assert merged.errors.place_m[:100].tolist() == [1e-3] * 100
    assert merged.errors.place_m[100] == pytest.approx(np.radians(0.02) * MOON.radius_m, rel=0.3)


def test_the_command_says_that_heights_are_lost(tmp_path, capsys):
    paths = [tmp_path / "one.csv", tmp_path / "other.csv"]
    write_catalog(paths[0], replace(ONE, height_m=np.full(3, 500.0)))
    write_catalog(paths[1], replace(OTHER, has_heights=False))
    for chosen, lost in ((paths, True), (paths[1:], False)):
        arguments = ["catalog", "merge", *map(str, chosen), "-o", str(tmp_path / f"{lost}.csv"), "--json"]
        app(arguments, standalone_mode=False)
        assert ("no heights of rims are written" in capsys.readouterr().err) is lost


def test_import_says_that_rims_without_errors_count_as_exact(tmp_path, capsys):
    paths = [tmp_path / "one.csv", tmp_path / "other.csv"]
    write_catalog(paths[0], replace(ONE, errors=MapErrors(*np.full((3, len(ONE)), 5.0))))
    write_catalog(paths[1], replace(OTHER, identifiers=tuple(f"x{k}" for k in range(len(OTHER)))))
    for chosen, exact in ((paths, True), (paths[:1], False), (paths[1:], False)):
        output = str(tmp_path / f"out{len(chosen)}{chosen[0].stem}.csv")
        app(["catalog", "import", *map(str, chosen), "-o", output, "--json"], standalone_mode=False)
        assert ("other.csv states no errors of rims" in capsys.readouterr().err) is exact


def test_names_that_stand_in_two_sources_are_told_apart():
    far = _catalog(["a"], [-50.0], [0.0], [5.0])
    assert merge([ONE, far], ["one", "far"]).catalog.identifiers == ("a", "b", "c", "far-a")


def test_tolerances_and_mutual_best_partners():
    near = _catalog(["p", "q"], [0.0, 0.08], [0.05, 0.0], [20.0, 20.0])
    assert same_craters(ONE, near).tolist() == [[0, 0]]
    assert same_craters(ONE, near, MergeOptions(0.1, 1.4)).tolist() == []
    small = _catalog(["p"], [0.0], [0.0], [14.0])
    assert same_craters(ONE, small).tolist() == []
    assert same_craters(ONE, small, MergeOptions(0.5, 1.5)).tolist() == [[0, 0]]
    assert same_craters(ONE, _catalog(["p"], [80.0], [0.0], [5.0])).shape == (0, 2)


def test_shift_and_scale_between_catalogues_are_found():
    rng = np.random.default_rng(1)
    n = 400
    lat, lon = rng.uniform(-40.0, 40.0, n), rng.uniform(0.0, 360.0, n)
    size = rng.uniform(10.0, 40.0, n)
    one = _catalog([str(k) for k in range(n)], lat, lon, size)
    m = 180.0 / np.pi / MOON.radius_m
    north, east = 300.0 + 200.0 * rng.standard_normal(n), -150.0 + 100.0 * rng.standard_normal(n)
    scaled = size * 1.03 * np.exp(0.02 * rng.standard_normal(n))
    lon = lon + m * east / np.cos(np.radians(lat))
    other = _catalog([f"o{k}" for k in range(n)], lat + m * north, lon, scaled)
    found = difference(one, other)
    assert len(found.pairs) > 0.95 * n
    np.testing.assert_allclose(found.shift_m, [-150.0, 300.0], atol=30.0)
    np.testing.assert_allclose(found.shift_sigma_m, [100.0, 200.0], rtol=0.15)
    assert found.scale == pytest.approx(1.03, abs=0.004)
    assert found.scale_sigma == pytest.approx(0.02, rel=0.2)
    assert difference(one.take(np.arange(2)), other) is None


def test_catalogues_of_two_bodies_are_refused():
    with pytest.raises(InputError, match=r"other: expected a sphere of 1737400 m, as in one, found 561400"):
        merge([ONE, _catalog(["p"], [0.0], [0.0], [5.0], body=named_body("Dione"))], ["one", "other"])


def test_the_command_merges_and_tells_sources(tmp_path, capsys):
    paths = [tmp_path / "one.csv", tmp_path / "other.csv"]
    for path, catalog in zip(paths, (ONE, OTHER), strict=True):
        write_catalog(path, catalog)
    out, table = tmp_path / "all.parquet", tmp_path / "sources.csv"
    arguments = ["catalog", "merge", *map(str, paths), "-o", str(out), "--sources", str(table), "--json"]
    app(arguments, standalone_mode=False)
    values = json.loads(capsys.readouterr().out)
    assert values["craters"] == 5
    assert [one["kept"] for one in values["sources"]] == [1, 4]
    assert sorted(import_catalog(out)[0].identifiers) == ["a", "b", "c", "y", "z"]
    with table.open() as stream:
        rows = {row["CRATER_ID"]: (row["SOURCE"], row["ALSO_IN"]) for row in csv.DictReader(stream)}
    assert rows["a"] == ("other", "one")
    assert rows["c"] == ("one", "")
    app(["catalog", "info", str(paths[1]), "--against", str(paths[0]), "--json"], standalone_mode=False)
    # Two shared craters tell nothing.
    assert json.loads(capsys.readouterr().out)["against"] is None


def test_parquet_files_of_others_are_read(tmp_path):
    path = tmp_path / "lu.parquet"
    columns = {
        "ID": ["7", "8"],
        "LON_E_DEG": [10.0, 350.0],
        "LAT_DEG": [1.0, -2.0],
        "DIAMETER_KM": [3.0, 4.0],
    }
    pq.write_table(pa.table({**columns, "DEPTH_M": pa.array([1.0, 2.0], pa.float32())}), path)
    catalog, report = import_catalog(path)
    assert catalog.identifiers == ("7", "8")
    np.testing.assert_allclose(catalog.semi_major_m, [1500.0, 2000.0])
    np.testing.assert_allclose(np.degrees(catalog.longitude_rad), [10.0, 350.0])
    assert report.rows == 2
    columns["LAT_DEG"] = [1.0, -120.0]
    pq.write_table(pa.table(columns), path)
    catalog, report = import_catalog(path)
    assert [row.line for row in report.skipped] == [2]
    pq.write_table(pa.table({"a": [1.0], "b": [2.0]}), path)
    with pytest.raises(InputError, match=r"lu.parquet"):
        import_catalog(path)
    pq.write_table(pa.table({**columns, "DIAMETER_KM": ["x", "y"]}), path)
    with pytest.raises(InputError, match=r"lu.parquet: expected numbers and texts: Failed to parse"):
        import_catalog(path)


def test_heads_catalogue_fills_what_the_subset_of_robbins_lacks():
    robbins = import_catalog(shared("robbins_2018_subset.csv"))[0]
    head = import_catalog(shared("moon_head_povilaitis_5km.csv"))[0]
    merged = merge([robbins, head], ["robbins", "head"])
    assert 35_500 < len(merged.catalog) < 36_500
    found = difference(robbins, head)
    # Hundreds of metres from one crater to the next, and some of them in common.
    assert np.all(np.abs(found.shift_m) < 250.0)
    assert np.all((found.shift_share > 0.03) & (found.shift_share < 0.08))
    assert found.scale == pytest.approx(1.0, abs=0.01)
