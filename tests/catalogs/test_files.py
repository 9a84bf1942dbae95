import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.catalogs.files import import_catalog, read_catalog, write_catalog
from craternav_fg.errors import InputError
from tests.shared_data import shared

MOON = Body("Moon", 1737400.0, 4.902800118e12, (0.0, 0.0, 2.6616995e-6))
HEADER = "CRATER_ID,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_ELLI_MAJOR_IMG,DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG"


def written(tmp_path, *rows, header=HEADER):
    path = tmp_path / "craters.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_values_in_kilometres_and_degrees(tmp_path):
    path = written(tmp_path, "00-1-000001,45.0,350.0,4.0,3.0,90.0")
    catalog = read_catalog(path, MOON)
    assert catalog.semi_major_m[0] == 2000.0
    assert catalog.semi_minor_m[0] == 1500.0
    assert catalog.height_m[0] == 0.0
    x, y, z = catalog.centres[0]
    assert z == pytest.approx(1737400.0 * np.sqrt(0.5))
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(-10.0)
    # 90 deg from east is north: the major axis has no part along east.
    east = np.array([-np.sin(np.radians(350.0)), np.cos(np.radians(350.0)), 0.0])
    assert catalog.axes[0, 0] @ east == pytest.approx(0.0, abs=1e-9)
    assert catalog.axes[0, 0, 2] > 0.0


@pytest.mark.parametrize("turn_deg", [-360.0, 0.0, 180.0])
def test_longitudes_of_any_one_turn(tmp_path, turn_deg):
    """Of -360 to 0 or of 180 to 540 deg, half of a table was left out, or all of it refused."""
    longitudes = np.array([0.0, 10.0, 170.0, 190.0, 350.0, 360.0])
    shifted = (
        longitudes + turn_deg if turn_deg < 0.0 else np.where(longitudes < turn_deg, 360.0, 0.0) + longitudes
    )
    rows = [f"{k},{10 * k},{deg},4.0,3.0,90.0" for k, deg in enumerate(shifted)]
    for read in (read_catalog, lambda *of: import_catalog(*of)[0]):
        found = np.degrees(read(written(tmp_path, *rows), MOON).longitude_rad)
        assert ((found >= -180.0) & (found <= 360.0)).all()
        np.testing.assert_allclose(np.cos(np.radians(found - longitudes)), 1.0, atol=1e-12)


def test_rows_that_are_no_rim_are_reported(tmp_path):
    path = written(
        tmp_path,
        "A,1.0,2.0,4.0,3.0,90.0",
        "no-ellipse,1.0,2.0,,,",
        "",
        "outside,95.0,2.0,4.0,3.0,90.0",
        "swapped,1.0,2.0,3.0,4.0,90.0",
        "A,1.0,2.0,4.0,3.0,90.0",
        "B,1.0,541.0,4.0,3.0,90.0",
        "C,1.0,2.0,4.0,0.0,90.0",
        "D,-1.0,-2.0,4.0,3.0,0.0",
    )
    catalog, report = import_catalog(path, MOON)
    skipped = report.skipped
    assert catalog.identifiers == ("A", "D")
    assert report.rows == 8
    assert [(row.line, row.identifier) for row in skipped] == [
        (3, "no-ellipse"),
        (5, "outside"),
        (6, "swapped"),
        (7, "A"),
        (8, "B"),
        (9, "C"),
    ]
    assert skipped[0].reason.startswith("DIAM_ELLI_ANGLE_IMG")
    assert "found 95" in skipped[1].reason
    assert "major" in skipped[2].reason
    assert "again" in skipped[3].reason


def test_a_data_set_refuses_such_rows(tmp_path):
    path = written(tmp_path, "A,1.0,2.0,4.0,3.0,90.0", "B,1.0,2.0,,3.0,90.0")
    with pytest.raises(InputError, match=r"craters\.csv:3: DIAM_ELLI_MAJOR_IMG: expected a number, found ''"):
        read_catalog(path, MOON)


def test_a_file_without_any_ellipse(tmp_path):
    path = written(tmp_path, "B,1.0,2.0,,,")
    with pytest.raises(InputError, match="none in 1 rows"):
        import_catalog(path, MOON)


def test_a_file_of_another_kind(tmp_path):
    path = written(tmp_path, "1,2,3", header="LON_DEG,LAT_DEG,DIAM_KM")
    with pytest.raises(InputError, match=r"craters\.csv:1: LON_DEG: expected only the columns CRATER_ID"):
        read_catalog(path, MOON)


def test_a_rim_below_the_centre_of_the_body(tmp_path):
    path = written(tmp_path, "A,1.0,2.0,4.0,3.0,90.0,-2e6", header=HEADER + ",RIM_HEIGHT_M")
    with pytest.raises(InputError, match=r"craters\.csv:2: RIM_HEIGHT_M"):
        read_catalog(path, MOON)


def test_published_columns():
    path = shared("robbins_2018_full_columns_sample.csv")
    catalog, report = import_catalog(path, MOON)
    assert len(catalog) + len(report.skipped) == 7
    row = catalog.identifiers.index("00-1-000001")
    assert catalog.semi_major_m[row] == pytest.approx(144720.0)
    assert np.degrees(catalog.latitude_rad[row]) == pytest.approx(44.4083)


def test_the_subset_of_robbins(tmp_path):
    catalog, report = import_catalog(shared("robbins_2018_subset.csv"), MOON)
    assert len(catalog) + len(report.skipped) == 21433
    assert len(report.skipped) < 100
    assert catalog.semi_major_m.min() > 1900.0
    write_catalog(tmp_path / "craters.csv", catalog)
    again = read_catalog(tmp_path / "craters.csv", MOON)
    np.testing.assert_allclose(again.axes, catalog.axes, rtol=0.0, atol=1e-8)


def test_a_column_of_zeros_is_no_height(tmp_path):
    """As exact heights, it moved descents by 60 to 230 m, with standard deviations of a few metres."""
    rows = [f"{k},{k}.0,{10 * k}.0,4.0,3.0,90.0" for k in range(10)]
    heights, errors = ",RIM_HEIGHT_M", ",PLACE_SIGMA_M,SIZE_SIGMA_SHARE,RIM_HEIGHT_SIGMA_M"
    for read in (read_catalog, lambda *of: import_catalog(*of)[0]):
        zeros = written(tmp_path, *(f"{row},0.0" for row in rows), header=HEADER + heights)
        assert not read(zeros, MOON).has_heights
        # A few craters may lie on the sphere; one height is enough; stated errors make zeros heights.
        few = written(tmp_path, *(f"{row},0" for row in rows[:9]), header=HEADER + heights)
        assert read(few, MOON).has_heights
        some = written(tmp_path, *(f"{row},{k}" for k, row in enumerate(rows)), header=HEADER + heights)
        assert read(some, MOON).has_heights
        stated = [f"{row},0,1,0.01,5" for row in rows]
        assert read(written(tmp_path, *stated, header=HEADER + heights + errors), MOON).has_heights
        common = ",COMMON_PLACE_SIGMA_M,COMMON_HEIGHT_SIGMA_M,COMMON_SOURCE"
        stated = [f"{row},0,1,5,0" for row in rows]
        assert read(written(tmp_path, *stated, header=HEADER + heights + common), MOON).has_heights
