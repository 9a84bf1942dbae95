"""Catalogues whose rims' planes are not level."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.files import import_catalog, read_catalog, write_catalog
from craternav_fg.catalogs.merge import merge
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.registry import estimator
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.mapping.apply_errors import apply_errors
from craternav_fg.matching.identify.triple_index import fingerprint
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.scenario_tables import CraterFile
from factors.kernels import conic
from tests.cli.calls import call
from tests.descents import problem, scenario

BODY = Body("Moon", 1737.4e3, 4.9e12, (0.0, 0.0, 2.66e-6))


def craters(n=40, seed=0, sigma_rad=0.2):
    rng = np.random.default_rng(seed)
    a = rng.uniform(1e3, 4e3, n)
    return Catalog(
        tuple(f"c{k}" for k in range(n)), rng.uniform(-0.3, 0.3, n), rng.uniform(0.0, 0.6, n), a,
        a * rng.uniform(0.6, 0.95, n), rng.uniform(0.0, np.pi, n), rng.uniform(-2e3, 2e3, n), BODY,
        plane_tilt_rad=sigma_rad * rng.standard_normal((n, 2)),
    )  # fmt: skip


@given(
    st.floats(-1.57, 1.57),
    st.floats(-3.2, 6.3),
    st.floats(0.0, 3.2),
    st.floats(-1.3, 1.3),
    st.floats(-1.3, 1.3),
)
def test_a_plane_rises_as_its_slopes_say(latitude, longitude, angle, east, north):
    level = Catalog(
        ("c",), *(np.array([v]) for v in (latitude, longitude, 3e3, 2e3, angle, 100.0)), BODY
    )  # fmt: skip
    one = replace(level, plane_tilt_rad=np.array([[east, north]]))
    enu = frames.east_north_up(one.latitude_rad, one.longitude_rad)[0]
    np.testing.assert_array_equal(one.centres, level.centres)
    for axis, length_m in zip(one.axes[0], (3e3, 2e3), strict=True):
        x, y, z = axis @ enu
        assert np.linalg.norm(axis) == pytest.approx(length_m, rel=1e-9)
        assert z == pytest.approx(np.tan(east) * x + np.tan(north) * y, abs=1e-5)
    l1, l2, normal = np.moveaxis(one.gRl[0], 1, 0)
    np.testing.assert_allclose(np.cross(l1, l2), normal, atol=1e-9)
    np.testing.assert_allclose(one.normals[0], normal, atol=1e-12)
    assert normal @ enu[:, 2] > 0.0
    # The rotation from the level rim turns about a horizontal axis: none of it is about the radius.
    turn = one.gRl[0] @ level.gRl[0].T
    np.testing.assert_allclose((turn - turn.T) @ np.cross(enu[:, 2], normal), 0.0, atol=1e-9)


def test_level_planes_are_those_without_tilts():
    tilted = craters()
    zero = replace(tilted, plane_tilt_rad=np.zeros((len(tilted), 2)))
    level = replace(tilted, plane_tilt_rad=None)
    for name in ("centres", "axes", "normals", "gRl", "up"):
        np.testing.assert_allclose(getattr(zero, name), getattr(level, name), rtol=1e-12, atol=1e-9)
    assert np.abs(tilted.normals - level.normals).max() > 0.1
    np.testing.assert_allclose(tilted.up, level.up, atol=1e-15)


def test_images_are_those_of_tilted_rims():
    case = load_scenario("lunar_descent")
    camera = replace(case.camera.camera(), bTc=np.eye(4))
    tilted = craters(400)
    gRe = frames.east_north_up(np.array(0.0), np.array(0.3))
    gTb = frames.pose(gRe @ np.diag([1.0, -1.0, -1.0]), (BODY.radius_m + 400e3) * gRe[:, 2])
    rows, charts = tilted.visible(camera, gTb, min_semi_minor_px=1.0)
    assert len(rows) > 10
    again, seen = conic.project_rims(gTb, camera.bTc, tilted.centres[rows], tilted.axes[rows])
    assert seen.all()
    np.testing.assert_allclose(charts, again, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["c.csv", "c.parquet"])
def test_files_keep_tilts(tmp_path, name):
    tilted = craters()
    write_catalog(tmp_path / name, tilted)
    for found in (read_catalog(tmp_path / name, BODY), import_catalog(tmp_path / name, BODY)[0]):
        order = [found.identifiers.index(one) for one in tilted.identifiers]
        np.testing.assert_allclose(found.plane_tilt_rad[order], tilted.plane_tilt_rad, rtol=0.0, atol=1e-12)
    write_catalog(tmp_path / f"level_{name}", replace(tilted, plane_tilt_rad=None))
    assert read_catalog(tmp_path / f"level_{name}", BODY).plane_tilt_rad is None


@pytest.mark.parametrize("value", ["95", "", "inf"])
def test_impossible_tilts_are_refused(tmp_path, value):
    path = tmp_path / "c.csv"
    write_catalog(path, craters(5))
    header, first, *rest = path.read_text().splitlines()
    at = header.split(",").index("PLANE_TILT_NORTH_DEG")
    cells = first.split(",")
    cells[at] = value
    path.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    for read in (read_catalog, import_catalog):
        with pytest.raises(InputError, match="PLANE_TILT_NORTH_DEG") as told:
            read(path, BODY)
        assert ".csv:2: " in str(told.value)


def test_one_tilt_alone_is_refused(tmp_path):
    path = tmp_path / "c.csv"
    write_catalog(path, craters(5))
    path.write_text(path.read_text().replace("PLANE_TILT_NORTH_DEG", "DIAM_CIRC_SD_IMG"))
    for read in (read_catalog, import_catalog):
        with pytest.raises(InputError, match="expected this column beside PLANE_TILT_EAST_DEG"):
            read(path, BODY)
    store = tmp_path / "c.parquet"
    write_catalog(store, craters(5))
    pq.write_table(pq.read_table(store).drop_columns("plane_tilt_east_rad"), store)
    with pytest.raises(InputError, match="tilt_east_rad: expected this column beside plane_tilt_north_rad"):
        read_catalog(store, BODY)


def test_parts_and_wholes_keep_tilts():
    tilted = craters()
    level = replace(craters(seed=1), identifiers=tuple(f"d{k}" for k in range(40)), plane_tilt_rad=None)
    joined = Catalog.joined([tilted, level])
    np.testing.assert_array_equal(joined.tilts_rad()[:40], tilted.plane_tilt_rad)
    assert not joined.tilts_rad()[40:].any()
    rows = np.array([45, 3, 7])
    np.testing.assert_array_equal(joined.take(rows).plane_tilt_rad, joined.plane_tilt_rad[rows])
    assert Catalog.joined([level, level.take(rows[1:])]).plane_tilt_rad is None
    assert fingerprint(tilted) != fingerprint(replace(tilted, plane_tilt_rad=2.0 * tilted.plane_tilt_rad))


def test_the_preferred_source_gives_the_planes():
    tilted = craters()
    circles = replace(tilted, semi_minor_m=tilted.semi_major_m, plane_tilt_rad=None)
    merged = merge([circles, tilted], ["circles", "ellipses"]).catalog
    assert len(merged) == len(tilted)
    np.testing.assert_allclose(merged.plane_tilt_rad, tilted.plane_tilt_rad)


def test_corrections_keep_the_plane():
    tilted = craters()
    corrected = apply_errors(tilted, {3: (np.zeros(6), np.full(6, 1e-3))}).catalog
    np.testing.assert_allclose(corrected.plane_tilt_rad, tilted.plane_tilt_rad, atol=1e-12)
    np.testing.assert_allclose(corrected.axes[3], tilted.axes[3], rtol=0.0, atol=1e-5)
    # Along the plane: its slope lifts the centre.
    error = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    moved = apply_errors(tilted, {3: (error, np.full(6, 1e-3))}).catalog
    radius_m = np.sqrt(tilted.semi_major_m[3] * tilted.semi_minor_m[3])
    step = (moved.centres[3] - tilted.centres[3]) / (0.05 * radius_m)
    np.testing.assert_allclose(step, tilted.gRl[3, :, 0], atol=1e-6)


def test_craters_are_listed_with_their_planes(tmp_path):
    tilted = craters()
    write_catalog(tmp_path / "c.parquet", tilted)
    place = np.degrees([tilted.latitude_rad[3], tilted.longitude_rad[3]])
    done = call("catalog", "near", tmp_path / "c.parquet", *place, "--distance-km", "1", "--json")
    assert done.code == 0, done.err
    (found,) = json.loads(done.out)["craters"]
    assert found["identifier"] == "c3"
    shown = [found[f"plane_tilt_{name}_deg"] for name in ("east", "north")]
    np.testing.assert_allclose(shown, np.degrees(tilted.plane_tilt_rad[3]))


def test_the_summary_tells_the_slopes(tmp_path):
    tilted = replace(craters(3), plane_tilt_rad=np.radians([[0.0, 0.0], [10.0, 0.0], [0.0, -20.0]]))
    write_catalog(tmp_path / "c.csv", tilted)
    assert "slopes of 10 deg in the median, at most 20 deg" in call("catalog", "info", tmp_path / "c.csv").out
    write_catalog(tmp_path / "level.csv", replace(tilted, plane_tilt_rad=None))
    assert (
        json.loads(call("catalog", "info", tmp_path / "level.csv", "--json").out)["plane_slope_deg"] is None
    )


@pytest.fixture(scope="module")
def descent(tmp_path_factory):
    """A descent over rims tilted by 0.1 rad, measured."""
    folder = tmp_path_factory.mktemp("tilted")
    level = problem(folder, scenario(duration_s=40.0), 0)[0].catalog
    tilts = 0.1 * np.random.default_rng(4).standard_normal((len(level), 2))
    write_catalog(folder / "c.csv", replace(level, plane_tilt_rad=tilts))
    of_file = CraterFile(source="file", path=str(folder / "c.csv"))
    case = scenario(duration_s=40.0).model_copy(update={"craters": of_file})
    return Dataset.open(simulate(case, folder / "data"))


@pytest.mark.parametrize("name", ["smoother", "online", "ekf", "ekf_eq19", "smoother_los"])
def test_estimators_know_the_planes(descent, name):
    given = make_problem(Descent.of(descent), descent.measurements)
    anees = metrics(estimator(name).estimate(given), descent.truth).anees
    assert anees < 15.0
    # The same rims, taken for level ones.
    wrong = replace(descent, catalog=replace(descent.catalog, plane_tilt_rad=None))
    given = make_problem(Descent.of(wrong), wrong.measurements)
    assert metrics(estimator(name).estimate(given), descent.truth).anees > 60.0


def test_rendered_rims_are_level(tmp_path):
    write_catalog(tmp_path / "c.csv", craters())
    case = load_scenario("lunar_descent")
    of_file = CraterFile(source="file", path=str(tmp_path / "c.csv"))
    with pytest.raises(CraternavError, match="rendered rims are level"):
        simulate(case.model_copy(update={"craters": of_file}), tmp_path / "data")
