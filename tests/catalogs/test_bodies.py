import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.files import import_catalog, read_catalog, write_catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from tests.catalogs.population import power_law_population
from tests.dataset.conftest import folder, with_images  # noqa: F401
from tests.shared_data import shared

MOON = Body("Moon", 1737400.0, 4.902800118e12, (0.0, 0.0, 2.6616995e-6))
DIONE = Body("Dione", 561400.0, 7.3116e10, (0.0, 0.0, 2.65706e-5))
ROBBINS = "CRATER_ID,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_ELLI_MAJOR_IMG,DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG"
ROWS = "00-1-000001,1,2,6,5,30\n07-1-226685,3,4,8,7,60\n"


def written(folder_path, text, name="craters.csv"):
    path = folder_path / name
    path.write_text(text)
    return path


def test_a_csv_of_ours_carries_its_body(tmp_path):
    body = Body("Ball, small", 250123.5, 1.0, (0.0, 0.0, 0.0))
    drawn = power_law_population(np.random.default_rng(1), body, 50, (400.0, 60e3))
    write_catalog(tmp_path / "a.csv", drawn)
    catalog, report = import_catalog(tmp_path / "a.csv")
    assert catalog.body == body
    assert report.body_by == "BODY_RADIUS_M says"
    assert read_catalog(tmp_path / "a.csv", body).identifiers == drawn.identifiers
    for read in (read_catalog, import_catalog):
        with pytest.raises(
            InputError, match=r"BODY_RADIUS_M: .* 561400 m \(Dione\), found one of Ball, small"
        ):
            read(tmp_path / "a.csv", DIONE)
    # Another sphere of the same body would shift all heights.
    with pytest.raises(InputError, match=r"250123\.5 m"):
        read_catalog(tmp_path / "a.csv", Body("Ball, small", 250124.0, 1.0, (0.0, 0.0, 0.0)))


def test_rows_of_several_bodies(tmp_path):
    path = written(tmp_path, "id,lat,lon,diam_km,Target\nA,1,2,3,Moon\nB,1,2,3,Mars\n")
    with pytest.raises(InputError, match="Target: expected one body, found Mars and Moon"):
        import_catalog(path)


@pytest.mark.parametrize(
    ("text", "name", "found", "by"),
    [
        (f"{ROBBINS}\n{ROWS}", "craters.csv", "Moon", "identifiers"),
        ("id,lat,lon,diam_km,Target\nA,1,2,3,Dione\n", "craters.csv", "Dione", "Target"),
        ("id,lat,lon,diam_km\nA,1,2,3\n", "dione_craters.csv", "Dione", "its name"),
        ("id,lat,lon,diam_km\nA,1,2,3\n", "Lunar-20km.csv", "Moon", "its name"),
        ("id,lat,lon,diam_km\nA,1,2,3\n", "moon_and_mercury.csv", "Moon", ""),
        ("id,lat,lon,diam_km\nA,1,2,3\n", "craters.csv", "Moon", ""),
    ],
)
def test_a_table_tells_its_body(tmp_path, text, name, found, by):
    path = written(tmp_path, text, name)
    catalog, report = import_catalog(path)
    assert catalog.body.name == found
    assert by in report.body_by
    assert (by == "") == (report.body_by == "")
    other = DIONE if found == "Moon" else MOON
    if by:
        with pytest.raises(InputError, match=rf"sphere of .* \({other.name}\), found one of {found}"):
            import_catalog(path, other)
    else:
        assert import_catalog(path, other)[0].body == other


def test_bodies_known_by_name():
    assert named_body("lunar").radius_m == 1737400.0
    assert named_body("Ceres", 469700.0).radius_m == 469700.0
    for name, radius_m in (("mars", 3396190.0), ("Ceres", 470e3), ("VESTA", 255e3), ("Charon", 606e3)):
        assert named_body(name).radius_m == radius_m
    with pytest.raises(InputError, match=r"--body: expected --body-radius-m beside 'Haumea'"):
        named_body("Haumea")


def test_short_words_of_a_file_name_are_no_body(tmp_path):
    path = tmp_path / "craters_io.csv"
    path.write_text("id,lat,lon,diam_km\nA,1,2,3\n")
    assert import_catalog(path)[0].body.name == "Moon"


def test_a_named_body_without_a_known_sphere(tmp_path):
    path = written(tmp_path, "id,lat,lon,diam_km,Target\nA,1,2,3,Haumea\n")
    with pytest.raises(InputError, match=r"is of Haumea, .* not known: give --body-radius-m"):
        import_catalog(path)
    with pytest.raises(InputError, match=r"\(Dione\), found one of Haumea, as Target says"):
        import_catalog(path, DIONE)
    assert import_catalog(path, Body("haumea", 470e3, 1.0, (0.0, 0.0, 0.0)))[0].body.radius_m == 470e3


def test_a_data_set_with_the_craters_of_another_body(folder):  # noqa: F811
    path = folder.path / "craters.csv"
    mine = Dataset.open(folder.path).body
    path.write_text(f"{ROBBINS}\n{ROWS}")
    if abs(mine.radius_m - MOON.radius_m) < 0.01 * MOON.radius_m:
        described = folder.path / "dataset.toml"
        described.write_text(described.read_text().replace(f"{mine.radius_m}", "1560800.0"))
    with pytest.raises(InputError, match=r"craters\.csv: expected a catalogue on .* Robbins \(2018\), say"):
        Dataset.open(folder.path)


@pytest.mark.parametrize("name", ["robbins_2018_subset.csv", "moon_head_povilaitis_5km.csv"])
@pytest.mark.parametrize("body", [DIONE, Body("Mercury", 2439400.0, 1.0, (0.0, 0.0, 0.0))])
def test_the_real_moon_on_other_bodies(name, body):
    with pytest.raises(InputError, match=rf"\({body.name}\), found one of Moon on 1737400 m"):
        import_catalog(shared(name), body)


def test_the_real_dione():
    catalog, report = import_catalog(shared("dione_craters_km.csv"))
    assert (catalog.body.name, catalog.body.radius_m) == ("Dione", 561400.0)
    assert len(catalog) == report.rows == 73
    with pytest.raises(InputError, match=r"\(Moon\), found one of Dione on 561400 m, as its name says"):
        import_catalog(shared("dione_craters_km.csv"), MOON)


def of_radius(radius_m, name):
    return Body(name, radius_m, 1.0, (0.0, 0.0, 0.0))


def test_another_body_of_the_same_radius_is_refused(tmp_path):
    drawn = power_law_population(np.random.default_rng(1), of_radius(470e3, "Ceres"), 50, (400.0, 60e3))
    write_catalog(tmp_path / "a.csv", drawn)
    write_catalog(tmp_path / "a.parquet", drawn)
    for path in (tmp_path / "a.csv", tmp_path / "a.parquet"):
        with pytest.raises(InputError, match=r"470000 m \(Vesta\), found one of Ceres on 470000 m"):
            read_catalog(path, of_radius(470e3, "Vesta"))
        for same in ("ceres", "1 Ceres", ""):
            assert len(read_catalog(path, of_radius(470e3, same))) == len(drawn)


def test_a_body_that_identifiers_tell_may_have_a_name_of_another_language(tmp_path):
    path = written(tmp_path, f"{ROBBINS}\n{ROWS}")
    assert len(read_catalog(path, of_radius(1737400.0, "Mond"))) == 2
    with pytest.raises(InputError, match=r"\(Mars\), found one of Moon"):
        read_catalog(path, of_radius(1737400.0, "Mars"))
