"""`craternav catalog`: import, info, near, plot; and what they say of bad input."""

import json
import resource

import matplotlib.image
import numpy as np
import pytest

from craternav_fg.catalogs.common_shift import unknown_height_sigma_m
from craternav_fg.catalogs.files import import_catalog
from tests.catalogs.test_dem import write
from tests.cli.calls import call

ROWS = "LAT_DEG,LON_DEG,DIAM_KM\n" + "\n".join(
    f"{-60.0 + 0.5 * k:.3f},{(17.0 * k) % 360.0:.3f},{4.0 + 0.02 * k:.3f}" for k in range(240)
)


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("catalog")
    (folder / "table.csv").write_text(ROWS + "\n-60.001,0.001,4.0\n99,0,4\n")
    done = call("catalog", "import", folder / "table.csv", "-o", folder / "craters.parquet", "--json")
    assert done.code == 0, done.err
    return folder, json.loads(done.out)


def test_import(imported):
    _, found = imported
    assert found["craters"] == 241
    file = found["files"][0]
    assert (file["rows"], file["imported"], file["skipped"], file["numbered"]) == (242, 241, 1, True)
    assert file["first_skipped"][0]["line"] == 243
    assert found["duplicates"] == 1
    assert sorted(found["first_duplicates"][0]) == ["2", "242"]


def test_info_and_near(imported):
    folder, found = imported
    done = call("catalog", "info", folder / "craters.parquet", "--json")
    about = json.loads(done.out)
    assert (
        about.items()
        >= {key: found[key] for key in ("craters", "duplicates", "crossed_rims", "body")}.items()
    )
    done = call(
        "catalog", "near", folder / "craters.parquet", "--distance-km", "1", "--json", "--", "-60", "360"
    )
    near = json.loads(done.out)
    assert [crater["identifier"] for crater in near["craters"]] == ["2", "242"]
    assert near["craters"][1]["distance_km"] == pytest.approx(0.0343, abs=1e-3)
    shown = call("catalog", "near", folder / "craters.parquet", "-60", "0")
    assert "242" in shown.out
    assert about["longitude_deg"] == [0.0, 360.0]


def test_a_region_and_its_longest_identifier_are_shown_whole(tmp_path):
    """Latitudes and longitudes of a region that are swapped show only here."""
    name = "-".join(["a_very_long_name"] * 6)
    rows = f"id,lat,lon,diam_km,target\n{name},-2,350,5,Moon\nB,3,-20,6,Moon\nC,1,12,6,Moon\n"
    (tmp_path / "region.csv").write_text(rows)
    shown = call("catalog", "info", tmp_path / "region.csv").out
    assert "longitudes  340.00 to 12.00 deg, eastwards" in shown
    shown = call("catalog", "near", tmp_path / "region.csv", "-2", "350", "--distance-km", "9").out
    begin, end = (shown.index(text) for text in ("a_very", "1 craters within"))
    first = "".join(line.split()[0] for line in shown[begin:end].splitlines() if line.strip())
    assert first == name


def test_what_counts_as_exact_is_said(tmp_path):
    path, rows = tmp_path / "region.csv", ["id,lat,lon,diam_km,target", "B,3,-20,6,Moon"]
    path.write_text("\n".join(rows) + "\n")
    assert (
        "errors      none of each crater: places and sizes are exact, unless rims show otherwise"
        in call("catalog", "info", path).out
    )
    rows = [f"{row},{more}" for row, more in zip(rows, ("RIM_HEIGHT_M", "150"), strict=True)]
    path.write_text("\n".join(rows) + "\n")
    assert "none of each crater: places, sizes and heights are exact" in call("catalog", "info", path).out
    names = "PLACE_SIGMA_M,SIZE_SIGMA_SHARE,RIM_HEIGHT_SIGMA_M"
    rows = [f"{row},{more}" for row, more in zip(rows, (names, "20,.01,30"), strict=True)]
    path.write_text("\n".join(rows) + "\n")
    shown = call("catalog", "info", path).out
    assert "exact" not in shown
    assert "height 30 m" in shown


@pytest.mark.parametrize("place", [(), ("--latitude-deg", "-30", "--longitude-deg", "290")])
def test_plot(imported, place, tmp_path):
    folder, _ = imported
    done = call("catalog", "plot", folder / "craters.parquet", "-o", tmp_path / "a.png", *place)
    assert done.code == 0, done.err
    picture = matplotlib.image.imread(tmp_path / "a.png")
    assert min(picture.shape[:2]) > 300
    assert np.ptp(picture[..., :3]) > 0.5


def test_pairs_that_meet(imported, tmp_path):
    folder, found = imported
    pairs = tmp_path / "pairs.csv"
    done = call("catalog", "info", folder / "craters.parquet", "--pairs", pairs)
    assert done.code == 0, done.err
    rows = [line.split(",") for line in pairs.read_text().splitlines()]
    assert rows[0][:3] == ["kind", "crater_id", "other_id"]
    assert [sorted(row[1:3]) for row in rows if row[0] == "duplicate"] == [["2", "242"]]
    assert float(rows[1][5]) == pytest.approx(0.0343, abs=1e-3)
    crossed = {name for row in rows if row[0] == "crossing" for name in row[1:3]}
    assert len(crossed) == found["crossed_rims"]


def test_negative_places_need_no_dashes(imported):
    folder, _ = imported
    shown = call("catalog", "near", folder / "craters.parquet", "-60", "-360", "--distance-km", "1")
    assert shown.code == 2  # out of range, but understood
    shown = call("catalog", "near", folder / "craters.parquet", "-60", "-0.001", "--distance-km", "1")
    assert "2 craters within 1 km" in shown.out


def test_what_was_skipped_and_assumed_is_said(imported, tmp_path):
    folder, _ = imported
    done = call("catalog", "import", folder / "table.csv", "-o", tmp_path / "a.parquet")
    assert "read: latitude LAT_DEG, longitude LON_DEG (east), size DIAM_KM (km)" in done.out
    assert "1 row skipped: LAT_DEG: expected -90 to 90 deg, line 243: found 99" in done.out
    assert "the Moon is assumed (--body gives another)" in done.err
    done = call(
        "catalog", "import", folder / "table.csv", "-o", tmp_path / "b.parquet", "--body", "Mercury", "--json"
    )
    assert json.loads(done.out)["body_radius_m"] == 2439400.0
    both = (tmp_path / "a.parquet", tmp_path / "b.parquet")
    done = call("catalog", "import", *both, "-o", tmp_path / "c.parquet")
    assert done.code == 2
    assert "expected Moon of 1737400 m, as in" in done.err


def test_places_in_radians_and_heights_in_km_are_warned_of(tmp_path):
    rows = "".join(
        f"{np.arcsin(-0.99 + 0.0495 * k):.6f},{0.15 * k:.6f},{4.0 + 0.02 * k:.3f},{0.01 * k:.2f}\n"
        for k in range(41)
    )
    (tmp_path / "table.csv").write_text("LAT_DEG,LON_DEG,DIAM_KM,RIM_HEIGHT_M\n" + rows)
    output = tmp_path / "craters.parquet"
    done = call("catalog", "import", tmp_path / "table.csv", "-o", output, "--body", "Moon")
    assert done.code == 0, done.err
    told = " ".join(done.err.split())
    assert "the catalogue's latitudes are -1.43 to 1.43 deg" in told
    assert "RIM_HEIGHT_M of the catalogue is at most 0.4 m" in told


@pytest.mark.parametrize("name", ["craters.parquet", "craters.csv", "figure.png", "pairs.csv"])
def test_a_full_disk_is_one_line_and_leaves_what_was_there(imported, tmp_path, name):
    folder, _ = imported
    output = tmp_path / name
    output.write_text("before")
    arguments = {
        "craters": ("import", folder / "table.csv", "-o", output),
        "figure": ("plot", folder / "craters.parquet", "-o", output),
        "pairs": ("info", folder / "craters.parquet", "--pairs", output),
    }[output.stem]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20, limits[1]))
    try:
        done = call("catalog", *arguments, "--force")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert done.code == 2
    assert done.err.endswith(f"{name}: cannot be written: File too large\n")
    assert list(tmp_path.iterdir()) == [output]
    assert output.read_text() == "before"


def test_known_errors_are_one_line_and_leave_nothing(imported, tmp_path):
    folder, _ = imported
    cases = [
        (("import", folder / "table.csv", "-o", tmp_path / "x.txt"), "expected a name that ends in"),
        (("import", folder / "table.csv", "-o", folder / "table.csv"), "would be overwritten"),
        (
            ("import", folder / "table.csv", "-o", tmp_path / "x.csv", "--diameter", "D"),
            "table.csv:1: D: expected",
        ),
        (("info", folder / "craters.parquet", "--body-radius-m", "561400"), "found one of Moon on 1737400 m"),
        (("plot", folder / "craters.parquet", "--latitude-deg", "3"), "expected both"),
        (
            ("near", folder / "craters.parquet", 0, 0, "--body-radius-m", "1737.4"),
            "as its metadata say: the radius given is in km",
        ),
        (
            ("info", folder / "table.csv", "--body-radius-m", "1737.4"),
            "wrong unit (km, m) of the sizes or of the body's radius, 1737.4 m",
        ),
    ]
    for arguments, match in cases:
        done = call("catalog", *arguments)
        assert done.code == 2
        assert match in done.err
        assert done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "inf"])
@pytest.mark.parametrize(
    "command",
    [
        ("catalog", "import", "a.csv"),
        ("catalog", "merge", "a.csv", "b.csv", "-o", "c.parquet"),
        ("catalog", "refine", "a.csv", "-o", "c.parquet"),
        ("evaluate", "dem", "run"),
    ],
    ids=" ".join,
)
def test_a_unit_of_heights_that_is_no_length_is_refused(command, unit):
    done = call(*command, "--dem", "model.tif", "--dem-unit-m", unit)
    assert done.code == 2
    assert done.err.startswith("craternav: --dem-unit-m: expected metres, more than 0, found")


@pytest.fixture
def north(tmp_path):
    """Two craters, and an elevation model of the north alone, 2 km high."""
    (tmp_path / "two.csv").write_text("ID,LAT_DEG,LON_DEG,DIAM_KM,TARGET\nA,40,10,8,Moon\nB,-40,10,8,Moon\n")
    write(tmp_path / "north.tif", np.full((90, 360), 2000.0, np.float32), (-180.0, 90.0, 1.0, 1.0))
    return tmp_path


def test_craters_beyond_an_elevation_model_get_no_heights_from_it(north):
    done = call("catalog", "import", north / "two.csv", "-o", north / "o.csv", "--dem", north / "north.tif")
    assert done.code == 0, done.err
    assert done.err.count("1 of 2 craters reach beyond it, and are put on the sphere, heights unknown") == 1
    found, _ = import_catalog(north / "o.csv")
    a, b = found.identifiers.index("A"), found.identifiers.index("B")
    assert found.height_m[a] > 1900.0
    assert found.height_m[b] == 0.0
    # The model shows that heights are as large as 2 km.
    assert found.common_shift.height_m[b] == pytest.approx(found.height_m[a], rel=1e-6)
    assert found.common_shift.height_m[b] > unknown_height_sigma_m(found.body.radius_m)
    assert not found.common_shift.height_m[a] > 0.0


def test_a_rim_that_reaches_beyond_an_elevation_model_gets_no_height_from_it(north):
    (north / "two.csv").write_text("ID,LAT_DEG,LON_DEG,DIAM_KM,TARGET\nA,40,10,8,Moon\nB,0.05,10,8,Moon\n")
    done = call("catalog", "import", north / "two.csv", "-o", north / "o.csv", "--dem", north / "north.tif")
    assert "1 of 2 craters reach beyond it" in done.err
    found, _ = import_catalog(north / "o.csv")
    assert found.height_m[found.identifiers.index("B")] == 0.0


def test_a_catalogue_keeps_its_own_heights_beyond_an_elevation_model(north):
    call("catalog", "import", north / "two.csv", "-o", north / "o.csv", "--dem", north / "north.tif")
    high = write(north / "high.tif", np.full((90, 360), 3000.0, np.float32), (-180.0, 0.0, 1.0, 1.0))
    done = call("catalog", "import", north / "o.csv", "-o", north / "p.csv", "--dem", high)
    assert "1 of 2 craters reach beyond it, and keep the catalogue's heights" in done.err
    before, after = (import_catalog(north / name)[0] for name in ("o.csv", "p.csv"))
    a, b = after.identifiers.index("A"), after.identifiers.index("B")
    assert after.height_m[a] == before.height_m[before.identifiers.index("A")]
    assert after.height_m[b] > 2900.0


def test_an_elevation_model_of_other_ground_is_refused(north):
    far = write(north / "far.tif", np.full((8, 8), 1.0, np.float32), (100.0, 8.0, 1.0, 1.0))
    done = call("catalog", "import", north / "two.csv", "-o", north / "o.csv", "--dem", far)
    assert done.code == 2
    assert "far.tif: expected ground of the 2 craters, found that of none" in done.err
    assert not (north / "o.csv").exists()
