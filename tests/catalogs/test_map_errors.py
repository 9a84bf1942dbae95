"""Errors that a catalogue states of its rims: on disk, through merging, and from elevation models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.files import import_catalog, read_catalog, write_catalog
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.merge import MergeOptions, merge
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError

MOON = named_body("Moon")


def field(n: int = 300, seed: int = 1) -> Catalog:
    rng = np.random.default_rng(seed)
    lat, lon = rng.uniform(-0.7, 0.7, n), rng.uniform(0.0, 6.0, n)
    radius, zero = rng.uniform(2e3, 9e3, n), np.zeros(n)
    return Catalog(tuple(f"{seed}-{k}" for k in range(n)), lat, lon, radius, radius, zero, zero, MOON)


def stated(n: int) -> MapErrors:
    rng = np.random.default_rng(2)
    return MapErrors(*rng.uniform(0.0, [[300.0], [0.1], [90.0]], (3, n)))


@pytest.mark.parametrize("name", ["craters.csv", "craters.parquet"])
def test_errors_read_back_and_catalogues_without_them_have_none(tmp_path, name):
    catalog = replace(field(), errors=stated(300))
    write_catalog(tmp_path / name, catalog)
    found = read_catalog(tmp_path / name, MOON)
    order = [found.identifiers.index(one) for one in catalog.identifiers]
    for key in ("place_m", "size_share", "height_m"):
        np.testing.assert_allclose(
            getattr(found.errors, key)[order], getattr(catalog.errors, key), rtol=1e-12
        )
    write_catalog(tmp_path / f"no_{name}", field())
    assert read_catalog(tmp_path / f"no_{name}", MOON).errors is None


def renamed_column(path: Path, name: str, other: str) -> None:
    """Rename a column of a file."""
    if path.suffix == ".csv":
        path.write_text(path.read_text().replace(name, other, 1))
    else:
        table = pq.read_table(path)
        names = [other if one == name else one for one in table.column_names]
        pq.write_table(table.rename_columns(names).replace_schema_metadata(table.schema.metadata), path)


@pytest.mark.parametrize("read", [read_catalog, lambda path, body: import_catalog(path, body)[0]])
@pytest.mark.parametrize("file", ["craters.csv", "craters.parquet"])
def test_errors_of_sizes_are_read_by_their_former_name_and_not_by_both(tmp_path, read, file):
    path = tmp_path / file
    present = "SIZE_SIGMA_SHARE" if path.suffix == ".csv" else "sigma_size_share"
    former = present.removesuffix("_SHARE").removesuffix("_share")
    write_catalog(path, replace(field(), errors=stated(300)))
    expected = read(path, MOON).errors
    renamed_column(path, present, former)
    np.testing.assert_array_equal(read(path, MOON).errors.size_share, expected.size_share)
    renamed_column(path, "RIM_HEIGHT_SIGMA_M" if path.suffix == ".csv" else "sigma_height_m", present)
    with pytest.raises(InputError, match=rf"{file}.*({former}: is the former name of|{present}: .* once)"):
        read(path, MOON)


def test_negative_errors_and_missing_columns_are_refused_by_one_line(tmp_path):
    path = tmp_path / "craters.csv"
    wrong = stated(300)
    wrong.size_share[7] = -0.1
    write_catalog(path, replace(field(), errors=wrong))
    with pytest.raises(InputError, match=r"craters.csv:9: SIZE_SIGMA_SHARE: expected 0 or more"):
        read_catalog(path, MOON)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join(line.rsplit(",", 1)[0] for line in (head, *rows)) + "\n")
    with pytest.raises(InputError, match="RIM_HEIGHT_SIGMA_M: expected this column beside PLACE_SIGMA_M"):
        read_catalog(path, MOON)
    store = tmp_path / "craters.parquet"
    write_catalog(store, replace(field(), errors=wrong))
    with pytest.raises(InputError, match="sigma_size_share: expected finite numbers of 0 or more"):
        read_catalog(store, MOON)


def test_errors_go_with_their_craters():
    one, other = replace(field(), errors=stated(300)), field(50, 3)
    rows = np.array([5, 2])
    assert one.take(rows).errors.place_m.tolist() == one.errors.place_m[rows].tolist()
    joined = Catalog.joined([one, other])
    assert joined.errors.height_m[:300].tolist() == one.errors.height_m.tolist()
    assert not joined.errors.height_m[300:].any()
    assert Catalog.joined([other, other]).errors is None


def test_merging_tells_how_far_the_sources_are_off():
    """Independent errors of 4 % in place and 3 % in size show as such, whatever the size of the crater."""
    rng = np.random.default_rng(5)
    truth = field(4000, 6)
    radius = truth.semi_major_m
    size = radius * np.exp(0.03 * rng.standard_normal(len(radius)))
    shift = 0.04 * radius * rng.standard_normal((2, len(radius))) / MOON.radius_m
    moved = replace(
        truth, latitude_rad=truth.latitude_rad + shift[0], semi_major_m=size, semi_minor_m=size,
        longitude_rad=truth.longitude_rad + shift[1] / np.cos(truth.latitude_rad),
        identifiers=tuple(f"m{k}" for k in range(len(radius))),
    )  # fmt: skip
    errors = merge([truth, moved], ["truth", "moved"]).catalog.errors
    np.testing.assert_allclose(np.median(errors.place_m[:4000] / radius), 0.04, rtol=0.1)
    np.testing.assert_allclose(np.median(errors.size_share), 0.03, rtol=0.1)
    # What a source states is not replaced.
    own = replace(truth, errors=stated(4000))
    assert merge([own, moved], ["own", "moved"]).catalog.errors.place_m[3] == own.errors.place_m[3]


def test_a_source_without_errors_is_not_exact_beside_one_that_states_them():
    """They share no craters, whose differences would show them."""
    told = replace(field(), errors=stated(300))
    other = field(50, 3)
    radius = np.sqrt(told.semi_major_m * told.semi_minor_m)
    for parts, rows in (([told, other], slice(300, 350)), ([other, told], slice(0, 50))):
        errors = merge(parts, ["a", "b"]).catalog.errors
        share = np.median(told.errors.place_m / radius)
        np.testing.assert_allclose(errors.place_m[rows], share * other.semi_major_m)
        np.testing.assert_allclose(errors.size_share[rows], np.median(told.errors.size_share))


def two_sources(n: int = 300) -> CommonShift:
    """Make the shift of 10 craters of one source, and of others whose height is unknown, of another."""
    source = np.where(np.arange(n) < 10, 4, 1)
    return CommonShift(np.where(source == 4, 0.0, 60.0), np.where(source == 4, 25.0, np.nan), source)


@pytest.mark.parametrize("name", ["craters.csv", "craters.parquet"])
def test_a_common_shift_reads_back_with_or_without_errors_of_each_crater(tmp_path, name):
    for errors in (None, stated(300)):
        catalog = replace(field(), errors=errors, common_shift=two_sources())
        write_catalog(tmp_path / name, catalog)
        found = read_catalog(tmp_path / name, MOON)
        order = [found.identifiers.index(one) for one in catalog.identifiers]
        np.testing.assert_array_equal(found.common_shift.place_m[order], catalog.common_shift.place_m)
        np.testing.assert_array_equal(found.common_shift.height_m[order], catalog.common_shift.height_m)
        np.testing.assert_array_equal(found.common_shift.source[order], catalog.common_shift.source)
        assert (found.errors is None) is (errors is None)
    write_catalog(tmp_path / f"no_{name}", field())
    assert read_catalog(tmp_path / f"no_{name}", MOON).common_shift is None


def test_wrong_common_shifts_are_refused_by_one_line(tmp_path):
    path = tmp_path / "craters.csv"
    wrong = two_sources()
    wrong.height_m[4] = -2.0
    write_catalog(path, replace(field(), common_shift=wrong))
    with pytest.raises(InputError, match=r"csv:6: COMMON_HEIGHT_SIGMA_M: expected 0 or more, found -2"):
        read_catalog(path, MOON)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join(line.rsplit(",", 2)[0] for line in (head, *rows)) + "\n")
    with pytest.raises(InputError, match="COMMON_HEIGHT_SIGMA_M: expected this column beside COMMON_PLACE"):
        read_catalog(path, MOON)
    store = tmp_path / "craters.parquet"
    write_catalog(store, replace(field(), common_shift=wrong))
    with pytest.raises(InputError, match="sigma_common_height_m: expected finite numbers of 0 or more"):
        read_catalog(store, MOON)


def test_merging_keeps_the_common_shift_of_each_source():
    """Refined craters have none; those that only the unrefined source has keep its."""
    refined = replace(field(), common_shift=CommonShift.zeros(300))
    same = replace(field(), identifiers=tuple(f"old {k}" for k in range(300)))
    other = Catalog.joined([same, field(50, 3)])
    other = replace(other, common_shift=CommonShift.of_source(350, 60.0, 25.0))
    catalog = merge([refined, other], ["refined", "published"]).catalog
    assert not catalog.common_shift.place_m[:300].any()
    assert set(catalog.common_shift.place_m[300:]) == {60.0}
    ellipses = replace(other, semi_minor_m=0.9 * other.semi_minor_m)
    better = merge([refined, ellipses], ["circles", "ellipses"]).catalog
    assert set(better.common_shift.place_m) == {60.0}
    # The shapes are of the second source; its other craters belong to the same.
    assert set(better.common_shift.source) == {1}
    assert merge([field(), same], ["a", "b"]).catalog.common_shift is None


def test_merging_leaves_a_common_shift_unknown_that_a_source_does_not_state():
    stated = replace(field(), common_shift=CommonShift.of_source(300, 60.0, 25.0))
    more = Catalog.joined([replace(field(), identifiers=tuple(f"b {k}" for k in range(300))), field(50, 3)])
    for parts in ([stated, more], [more, stated]):
        shift = merge(parts, ["a", "b"]).catalog.common_shift
        kept = 300 if parts[0] is stated else 0
        assert np.count_nonzero(shift.place_m == 60.0) == np.count_nonzero(shift.height_m == 25.0) == kept
        assert (
            np.count_nonzero(np.isnan(shift.place_m))
            == np.count_nonzero(np.isnan(shift.height_m))
            == 350 - kept
        )
    joined = Catalog.joined([stated, field(50, 3)]).common_shift
    assert np.isnan(joined.place_m[300:]).all()
    # Rims of an unknown shift do not make that of the others smaller.
    assert joined.of_mean(np.ones(350)) == (60.0, 25.0)


def test_merged_sources_of_equal_sigmas_are_independent():
    parts = [replace(field(40, k), common_shift=CommonShift.of_source(40, 60.0, 25.0)) for k in range(4)]
    merged = merge(parts, ["a", "b", "c", "d"], MergeOptions(place_share=0.01)).catalog
    found = merged.common_shift.of_mean(np.ones(len(merged)))
    np.testing.assert_allclose(found, (30.0, 12.5), rtol=0.01)
    twice = merge([merged, field(1, 9)], ["merged", "one"]).catalog
    np.testing.assert_allclose(twice.common_shift.of_mean(np.ones(len(twice))), found)


def test_import_keeps_the_standard_deviations_of_a_table(tmp_path):
    path = tmp_path / "craters.csv"
    catalog = replace(field(), errors=stated(300), common_shift=two_sources())
    write_catalog(path, catalog)
    lines = path.read_text().splitlines()
    # A row without a size is skipped, and its standard deviations with it.
    cells = lines[4].split(",")
    cells[3] = ""
    lines[4] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    found, report = import_catalog(path)
    kept = np.delete(np.arange(300), 3)
    assert len(report.skipped) == 1
    np.testing.assert_allclose(found.errors.size_share, catalog.errors.size_share[kept])
    np.testing.assert_allclose(found.errors.height_m, catalog.errors.height_m[kept])
    for name in ("place_m", "height_m", "source"):
        expected = getattr(catalog.common_shift, name)[kept]
        np.testing.assert_array_equal(getattr(found.common_shift, name), expected)
    path.write_text("\n".join([lines[0], lines[1].rsplit(",", 1)[0] + ",1.5", *lines[2:]]) + "\n")
    with pytest.raises(InputError, match=r"csv:2: COMMON_SOURCE: expected a whole number, found 1\.5"):
        import_catalog(path)
    path.write_text("\n".join(line.rsplit(",", 2)[0] for line in lines) + "\n")
    with pytest.raises(InputError, match="COMMON_HEIGHT_SIGMA_M: expected this column beside COMMON_PLACE"):
        import_catalog(path)
    path.write_text("\n".join([lines[0], lines[1].rsplit(",", 2)[0] + ",-3,1"]) + "\n")
    with pytest.raises(InputError, match=r"csv:2: COMMON_HEIGHT_SIGMA_M: expected 0 or more, found -3"):
        import_catalog(path)
