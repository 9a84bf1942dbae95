"""Errors that a catalogue states of its rims: on disk, through merging, and from elevation models."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.files import read_catalog, write_catalog
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.merge import merge
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
    for key in ("place_m", "size", "height_m"):
        np.testing.assert_allclose(
            getattr(found.errors, key)[order], getattr(catalog.errors, key), rtol=1e-12
        )
    write_catalog(tmp_path / f"no_{name}", field())
    assert read_catalog(tmp_path / f"no_{name}", MOON).errors is None


def test_negative_errors_and_missing_columns_are_refused_by_one_line(tmp_path):
    path = tmp_path / "craters.csv"
    wrong = stated(300)
    wrong.size[7] = -0.1
    write_catalog(path, replace(field(), errors=wrong))
    with pytest.raises(InputError, match=r"craters.csv:9: SIZE_SIGMA: expected 0 or more"):
        read_catalog(path, MOON)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join(line.rsplit(",", 1)[0] for line in (head, *rows)) + "\n")
    with pytest.raises(InputError, match="RIM_HEIGHT_SIGMA_M: expected this column beside PLACE_SIGMA_M"):
        read_catalog(path, MOON)
    store = tmp_path / "craters.parquet"
    write_catalog(store, replace(field(), errors=wrong))
    with pytest.raises(InputError, match="sigma_size: expected finite numbers of 0 or more"):
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
    np.testing.assert_allclose(np.median(errors.size), 0.03, rtol=0.1)
    # What a source states is not replaced.
    own = replace(truth, errors=stated(4000))
    assert merge([own, moved], ["own", "moved"]).catalog.errors.place_m[3] == own.errors.place_m[3]
