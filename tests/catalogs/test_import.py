import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.catalogs.columns import ImportOptions
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.errors import InputError

MOON = Body("Moon", 1737400.0, 4.902800118e12, (0.0, 0.0, 2.6616995e-6))
ROBBINS = (
    "CRATER_ID,LAT_CIRC_IMG,LON_CIRC_IMG,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_CIRC_IMG,DIAM_ELLI_MAJOR_IMG,"
    "DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG,ARC_IMG"
)


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "craters.csv"
    path.write_bytes(text.encode(encoding))
    return path


def globe(rng, n=1200, scale=1.0):
    """Latitude and longitude, deg, and diameters, km times a scale, all over the Moon."""
    latitude, longitude = np.degrees(np.arcsin(rng.uniform(-1, 1, n))), rng.uniform(-180, 180, n)
    return np.stack([latitude, longitude, scale * 4.0 * rng.random(n) ** -0.5], axis=1)


def table(header, rows):
    return header + "\n" + "\n".join(",".join(f"{value:.8g}" for value in row) for row in rows) + "\n"


def refused(path, match, body=MOON, **options):
    with pytest.raises(InputError, match=match) as caught:
        import_catalog(path, body, ImportOptions(**options))
    assert "\n" not in str(caught.value)


def test_rows_without_an_ellipse_are_kept_as_circles(tmp_path):
    path = written(
        tmp_path,
        f"{ROBBINS}\nA,10,200,10.1,200.1,5,6,4.5,30,0.9\nB,-20,300,,,8,,,,0.2\nC,-20,301,,,,,,,0.2\n",
    )
    catalog, report = import_catalog(path, MOON)
    assert catalog.identifiers == ("A", "B")
    assert (report.rows, report.circles, report.numbered) == (3, 1, False)
    assert [(row.line, row.identifier) for row in report.skipped] == [(4, "C")]
    np.testing.assert_allclose(catalog.semi_major_m, [3000.0, 4000.0])
    np.testing.assert_allclose(catalog.semi_minor_m, [2250.0, 4000.0])
    np.testing.assert_allclose(np.degrees(catalog.latitude_rad), [10.1, -20.0])
    np.testing.assert_allclose(np.degrees(catalog.longitude_rad), [200.1, 300.0])


def test_rows_without_a_height_are_not_put_on_the_sphere(tmp_path):
    header = f"{ROBBINS},RIM_HEIGHT_M\n"
    rows = [f"{name},10,{lon},10.1,{lon},5,6,4.5,30,0.9" for name, lon in (("A", 200), ("B", 210))]
    catalog, report = import_catalog(written(tmp_path, f"{header}{rows[0]},-2500\n{rows[1]},\n"), MOON)
    assert (catalog.identifiers, catalog.height_m.tolist(), catalog.has_heights) == (("A",), [-2500.0], True)
    assert [(row.identifier, row.reason) for row in report.skipped] == [
        ("B", "RIM_HEIGHT_M: expected a rim above the body's centre, found none")
    ]
    catalog, report = import_catalog(written(tmp_path, f"{header}{rows[0]},\n{rows[1]},\n"), MOON)
    assert (catalog.height_m.tolist(), catalog.has_heights, report.skipped) == ([0.0, 0.0], False, ())


def test_heights_in_a_column_of_another_name_are_read(tmp_path):
    body = Body("Bennu", 245.03, 4.892, (0.0, 0.0, 4.06e-4))
    path = written(tmp_path, "lat,lon,diameter_m,elevation\n10,20,30,-12.5\n-40,50,20,8\n")
    assert not import_catalog(path, body)[0].has_heights
    catalog, report = import_catalog(path, body, ImportOptions(height="elevation"))
    assert (catalog.height_m.tolist(), catalog.has_heights) == ([-12.5, 8.0], True)
    assert report.columns.endswith("height elevation (m)")
    refused(path, "altitude: expected this column, found lat, lon", body, height="altitude")
    path = written(tmp_path, "lat,lon,diameter_m,height_km\n10,20,30,-0.0125\n-40,50,20,0.008\n")
    catalog, report = import_catalog(path, body, ImportOptions(height="height_km"))
    assert catalog.height_m.tolist() == [-12.5, 8.0]
    assert report.columns.endswith("height height_km (km)")
    path = written(tmp_path, "lat,lon,diameter_m,depth_m\n10,20,30,5\n-40,50,20,8\n")
    refused(path, "depth_m: expected heights .* this column's name says depth", body, height="depth_m")
    path = written(tmp_path, "lat,lon,diameter_m,r\n10,20,30,240.5\n-40,50,20,253.03\n")
    refused(
        path, "r: expected heights above the sphere .* distances from the body's centre", body, height="r"
    )


@pytest.mark.parametrize(
    ("text", "radius_m"),
    [
        ("LON_DEG,LAT_DEG,DIAM_KM\n-160,20,12\n", 6000.0),  # Head, Povilaitis
        ("Diameter (km),Latitude,Longitude\n12,20,-160\n", 6000.0),
        (
            ",Long,Lat,Radius (deg),Diameter (km),D_range,p,Name\n1,-160,20,0.2,12.1,1,1,Č\n",
            6050.0,
        ),  # Salamuniccar
        ("Lon_E;Lat;Diameter_m;Depth_m_\n-160;20;12000;800\n", 6000.0),
        ("# lon\tlat\tradius (deg)\n\n-160\t20\t0.1\n", 0.1 * np.pi / 180 * 1737400.0),
        ("\n\nid, lat, lon, diameter_km\nX, 20, 200, 12\n", 6000.0),
    ],
)
def test_circles_under_the_names_that_others_give(tmp_path, text, radius_m):
    catalog, report = import_catalog(written(tmp_path, text), MOON)
    assert np.degrees(catalog.latitude_rad[0]) == pytest.approx(20.0)
    assert np.degrees(catalog.longitude_rad[0]) % 360.0 == pytest.approx(200.0)
    assert catalog.semi_major_m[0] == pytest.approx(radius_m)
    assert catalog.semi_minor_m[0] == catalog.semi_major_m[0]
    assert report.numbered == (catalog.identifiers != ("X",))


def test_a_table_below_its_description(tmp_path):
    # As LU1319373 (Wang, Wu 2021) has it, in metres.
    about = "The catalogue, with Longitude and Latitude\n" + "of craters, in degrees, east\n" * 14
    columns = "ID\tLongitude(degree)\tLatitude(degree)\tDiameter(m)\tDepth(m)\tSource"
    path = written(tmp_path, f"{about}{columns}\nA\t200\t20\t12000\t1\t0\n\nB\t200\t99\t1\t1\t0\nC\t1\n")
    catalog, report = import_catalog(path, MOON)
    assert catalog.identifiers == ("A",)
    assert np.degrees(catalog.latitude_rad[0]) == pytest.approx(20.0)
    assert catalog.semi_major_m[0] == 6000.0
    assert report.columns == (
        "latitude Latitude(degree), longitude Longitude(degree) (east), size Diameter(m) (m)"
    )
    assert [row.line for row in report.skipped] == [19, 20]
    refused(written(tmp_path, path.read_text() + "D\t1\t2\t3x\t4\t5\n"), r"craters\.csv:21: Diameter\(m\)")


def test_what_the_gazetteer_says_of_longitudes(tmp_path):
    rows = "1,10,20,5,{0}\n2,11,21,6,{0}\n"
    header = "Feature_ID,Center_Latitude,Center_Longitude,Diameter,Coordinate_System\n"
    west = written(tmp_path, header + rows.format('"Planetographic, +West, 0 - 360"'))
    refused(west, r"craters\.csv:2: Coordinate_System: .* positive east, found .*West.*: --west-longitudes\?")
    catalog, _ = import_catalog(west, MOON, ImportOptions(west_longitudes=True))
    np.testing.assert_allclose(np.degrees(catalog.longitude_rad), [340.0, 339.0])
    east = written(tmp_path, header + rows.format('"Planetocentric, +East, 0 - 360"'))
    assert len(import_catalog(east, MOON)[0]) == 2
    refused(east, "expected longitudes positive west, as --west-longitudes says", west_longitudes=True)
    refused(written(tmp_path, header + rows.format("IAU 1980 West")), "found 'IAU 1980 West'")


def test_the_gazetteer_counts_latitudes_from_an_ellipsoid(tmp_path):
    # On Mars up to 0.34 deg, 20 km, from planetocentric ones; on the Moon they are the same.
    header = "Center_Latitude,Center_Longitude,Diameter,Coordinate_System\n"
    path = written(tmp_path, f'{header}10,20,5,"Planetographic, +East, 0 - 360"\n')
    mars = Body("Mars", 3396190.0, 4.2828e13, (0.0, 0.0, 7.088e-5))
    refused(path, r"craters\.csv:2: Coordinate_System: .*planetocentric.*'Planetographic", mars)
    assert len(import_catalog(path, MOON)[0]) == 1


def test_planetographic_latitudes(tmp_path):
    name = "planetographic_lat"
    path = written(tmp_path, f"{name},lon,diam_km\n10,20,5\n")
    refused(path, rf"craters\.csv:1: {name}: .* says planetographic", latitude=name)


def test_all_lines_have_more_cells_than_the_header(tmp_path):
    path = written(tmp_path, "lat,lon,diam_km,kind\n1,2,3,crater, craters\n4,5,6,crater, craters\n")
    refused(path, "found none in 2 rows, the first left out is line 2: expected 4 columns, found 5")


def test_longitudes_to_the_west(tmp_path):
    # A mirror image of the body: nothing would ever be identified on it.
    path = written(tmp_path, "id,lat,Lon_W,diam_km\nA,20,200,12\n")
    refused(path, r"craters\.csv:1: Lon_W: expected longitudes positive east", longitude="Lon_W")
    # By name, as notebooks give it.
    catalog, report = import_catalog(str(path), MOON, ImportOptions(longitude="Lon_W", west_longitudes=True))
    np.testing.assert_allclose(np.degrees(catalog.longitude_rad), [160.0])
    assert "Lon_W (west)" in report.columns
    both = written(tmp_path, "id,lat,Lon_E,Lon_W,diam_km\nA,20,160,200,12\n")
    refused(both, r"craters\.csv:1: Lon_E: expected .* positive west, .* says east", west_longitudes=True)


def test_a_preamble_says_that_longitudes_count_to_the_west(tmp_path):
    for words in ("Longitudes are west-positive", "positive_longitude_direction, POSITIVE_WEST"):
        path = written(tmp_path, f"# Craters\n# {words}\nlat,lon,diam_km\n20,200,12\n")
        refused(path, r"craters\.csv:2: expected longitudes positive east, found '.*': --west-longitudes\?")
        catalog, _ = import_catalog(path, MOON, ImportOptions(west_longitudes=True))
        np.testing.assert_allclose(np.degrees(catalog.longitude_rad), [160.0])


@pytest.mark.parametrize("name", ["R", "Crater radius (km)", "mean_radius"])
def test_sizes_that_are_named_are_radii_if_they_say_so(tmp_path, name):
    path = written(tmp_path, f"lat,lon,{name}\n20,200,6\n")
    catalog, report = import_catalog(path, MOON, ImportOptions(diameter=name))
    assert catalog.semi_major_m[0] == 6000.0
    assert report.columns.endswith("(km of radius)")


def test_sizes_in_other_units(tmp_path):
    for name in ("diam_mi", "diam_deg", "Diameter (px)"):
        path = written(tmp_path, f"lat,lon,{name}\n20,200,6\n")
        refused(path, "expected sizes in km or m, this column's name says", diameter=name)
    catalog, _ = import_catalog(path, MOON, ImportOptions(diameter=name, unit="km"))
    assert catalog.semi_major_m[0] == 3000.0
    catalog, _ = import_catalog(written(tmp_path, "lat,lon,diamm\n20,200,6000\n"), MOON)
    assert catalog.semi_major_m[0] == 3000.0


def test_columns_of_robbins_in_small_letters(tmp_path):
    path = written(tmp_path, f"{ROBBINS.lower()}\nA,10,200,10.1,200.1,5,6,4.5,30,0.9\n")
    catalog, _ = import_catalog(path, MOON)
    assert (catalog.identifiers, catalog.semi_minor_m[0]) == (("A",), 2250.0)


def test_sizes_that_are_radii(tmp_path):
    path = written(tmp_path, "id,lat,lon,Radius_km\nA,20,200,6\n")
    catalog, report = import_catalog(path, MOON)
    assert catalog.semi_major_m[0] == 6000.0
    assert report.columns.endswith("size Radius_km (km of radius)")


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b'{"type": "FeatureCollection"}', r"craters\.csv: expected a table as text, found JSON"),
        (b"SQLite format 3\x00\x10", r"craters\.csv: expected a table as text, found a database"),
        (b"PK\x03\x04...", r"craters\.csv: .* a zip archive or a spreadsheet: unpack it"),
        (b"\x1f\x8b...", r"craters\.csv: .* a compressed file"),
        (
            "\ufeffid,lat\n".encode("utf-16-le"),
            r"craters\.csv: .* text, found one in UTF-16: save it in UTF-8",
        ),
        (b"PAR1\x15", r"craters\.csv: .* a Parquet file: its name must end in \.parquet"),
        (b"\x89PNG\r\n\x1a\n\0\0", r"craters\.csv:2: expected a table as text, found binary data"),
        (b"id,lat,lon,diam\rA,1,2,3\r", r"craters\.csv:1: .* line feed, found a carriage return alone"),
        (b"\n \n", r"craters\.csv:1: .* column names in its first line, found nothing"),
        (
            b"1,2,3\n4,5,6\n",
            r"craters\.csv:1: expected column names in the first line, found numbers: 1, 2, 3",
        ),
    ],
)
def test_what_is_no_table_with_names(tmp_path, content, match):
    path = tmp_path / "craters.csv"
    path.write_bytes(content)
    refused(path, match)
    refused(tmp_path, "expected a file, found a folder")


def test_major_and_minor_diameters_swapped(tmp_path):
    rows = "".join(f"{k},10,200,10,200,5,4,6,30,1\n" for k in range(30))
    refused(
        written(tmp_path, f"{ROBBINS}\n{rows}"),
        r"craters\.csv:2: DIAM_ELLI_MINOR_IMG: .* of 30 rows: major and minor diameters are swapped",
    )


def test_columns_that_are_named(tmp_path):
    path = written(tmp_path, "NAME,PHI,LAMBDA,SIZE,LAT\nX,20,200,12000,7\n")
    refused(path, r"craters\.csv:1: no column of a longitude .* NAME, PHI, LAMBDA, SIZE, LAT: name it")
    options = {"latitude": "PHI", "longitude": "LAMBDA", "diameter": "SIZE", "identifier": "NAME"}
    catalog, _ = import_catalog(path, MOON, ImportOptions(**options, unit="m"))
    assert catalog.identifiers == ("X",)
    assert np.degrees(catalog.latitude_rad[0]) == pytest.approx(20.0)
    assert catalog.semi_major_m[0] == 6000.0
    refused(path, r"craters\.csv:1: DIAM: expected this column, found NAME, PHI", diameter="DIAM")


def test_text_that_is_no_utf8(tmp_path):
    path = written(tmp_path, "id,lat,lon,diam_km\nAbb\xe9,20,200,12\n", "latin-1")
    assert import_catalog(path, MOON)[0].identifiers == ("Abbé",)


def test_broken_lines_are_counted_where_they_stand(tmp_path):
    path = written(
        tmp_path, "\nid,lat,lon,diam_km\nA,1,2,3\n\nB,1,2,3,C,4,5,6\nD,99,2,3\nD,9,2\nE,8,2,3\nE,7,2,3\n"
    )
    catalog, report = import_catalog(path, MOON)
    assert catalog.identifiers == ("A", "E")
    assert report.rows == 6
    assert [(row.line, row.identifier) for row in report.skipped] == [(5, ""), (6, "D"), (7, ""), (9, "E")]
    assert report.skipped[0].reason == "expected 4 columns, found 8"
    assert "found 99" in report.skipped[1].reason
    assert "'E' again" in report.skipped[3].reason


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("A,1,2,3\n \nB,1,3,3\n\nC,1\n", [3, 6]),
        ("A,1,2,3\r\n\t\r\n\r\nC,1\r\nB,1,3,3\r\n", [3, 5]),
    ],
)
def test_lines_of_spaces_count_as_rows(tmp_path, text, lines):
    path = tmp_path / "craters.csv"
    path.write_bytes(f"id,lat,lon,diam_km\n{text}".encode())
    catalog, report = import_catalog(path, MOON)
    assert catalog.identifiers == ("A", "B")
    assert [row.line for row in report.skipped] == lines


def test_a_cell_that_is_no_number(tmp_path):
    path = written(tmp_path, "id,lat,lon,diam_km\nA,1,2,3\n\nB,1,2E,3\n")
    refused(path, r"craters\.csv:4: lon: expected a number, found '2E'")


def test_latitude_and_longitude_swapped(tmp_path):
    rows = globe(np.random.default_rng(1))
    path = written(tmp_path, table("lon,lat,diam_km", rows))
    refused(
        path, r"craters\.csv:\d+: lat: expected -90 to 90 deg, found .* in lon no more than 90: .* swapped"
    )
    assert len(import_catalog(path, MOON, ImportOptions(latitude="lon", longitude="lat"))[0]) == 1200


def test_metres_taken_for_kilometres(tmp_path):
    path = written(tmp_path, table("lat,lon,diam", globe(np.random.default_rng(2), scale=1000.0)))
    refused(path, r"craters\.csv:2: diam: expected 0 to 3474\.8 km, found .* of 1200 rows: wrong unit")
    small = written(tmp_path, table("lat,lon,diam", globe(np.random.default_rng(2), scale=200.0)))
    refused(small, r"craters\.csv: diam: .* cover a body .* times over.* wrong unit")


def test_radians_taken_for_degrees(tmp_path):
    rows = globe(np.random.default_rng(4), 12000)
    rows[:, :2] = np.radians(rows[:, :2])
    path = written(tmp_path, table("lat,lon,diam", rows))
    refused(path, r"craters\.csv: diam: .* times over where they lie.* wrong unit .*deg, rad")


def test_kilometres_taken_for_metres(tmp_path):
    path = written(tmp_path, table("lat,lon,diam_m", globe(np.random.default_rng(3))))
    refused(path, r"craters\.csv: diam_m: craters all over a body .* wrong unit")
    # The same sizes around one place are a survey of small craters.
    rows = globe(np.random.default_rng(3)) * [0.01, 0.01, 1.0]
    assert len(import_catalog(written(tmp_path, table("lat,lon,diam_m", rows)), MOON)[0]) == 1200


def test_the_catalogue_of_another_body(tmp_path):
    rows = globe(np.random.default_rng(4), scale=40.0)
    path = written(tmp_path, table("lat,lon,diam_km", rows))
    assert len(import_catalog(path, MOON)[0]) > 1190
    refused(path, "or another body", Body("Dione", 561400.0, 1.0, (0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", r"craters\.csv:1: expected a table with column names"),
        ("lat,lon,diam_km,lat\n1,2,3,4\n", r"craters\.csv:1: lat: expected each column once"),
        ("lat,lon,diam_km\n", r"craters\.csv: expected at least one crater, found none in 0 rows"),
        (
            "lat,lon,diam_km\n1,2,12000\n",
            r"none in 1 rows, .* line 2: diam_km: .*wrong unit \(km, m\)",
        ),
        (
            ROBBINS.replace("DIAM_ELLI_MINOR_IMG,", "") + "\n",
            r"craters\.csv:1: DIAM_ELLI_MINOR_IMG: expected",
        ),
    ],
)
def test_what_is_no_catalogue(tmp_path, text, match):
    refused(written(tmp_path, text), match)


def test_a_missing_file(tmp_path):
    refused(tmp_path / "none.csv", r"none\.csv: file is missing")
