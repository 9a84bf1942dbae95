"""`craternav pose`: from files to a pose, and what it says of bad ones."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli import main
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.ellipse import matrix_of_chart, pixel_chart
from craternav_fg.errors import InputError
from craternav_fg.resection.files import read_rims
from craternav_fg.resection.problem import MatchedRims
from factors.kernels.conic import project_rims
from factors.kernels.sun import sun_tilt

MOON = Body("Moon", 1737400.0, 4.9e12, (0.0, 0.0, 0.0))
# Unequal focal lengths and a mounting: mistakes in either show.
CAMERA = Camera(
    1024, 768, 1267.0, 1100.0, 500.0, 400.0,
    frames.pose(frames.rotation_exp(np.array([0.4, -0.3, 1.2])), np.array([1.2, -0.3, 0.8])),
)  # fmt: skip
HEADER = (
    "ellipseCenterX(px),ellipseCenterY(px),ellipseSemimajor(px),ellipseSemiminor(px),"
    "ellipseRotation(deg),CRATER_ID"
)


@dataclass(frozen=True)
class Files:
    """A camera, a catalogue and the rims of one image, on disk; and the true pose."""

    folder: Path
    gTb: np.ndarray
    rows: list[str]
    catalog: Catalog

    def rims(self, *rows: str, header: str = HEADER) -> Path:
        path = self.folder / "rims.csv"
        path.write_text("\n".join([header, *(rows or self.rows)]) + "\n")
        return path

    def arguments(self, rims: Path | None = None) -> list[str]:
        paths = (rims or self.rims(), "--camera", self.folder / "sensor.yaml")
        return ["pose", *map(str, paths), "--catalog", str(self.folder / "craters.csv")]

    def read(self, rims: Path) -> tuple[MatchedRims, Catalog]:
        path = self.folder / "craters.csv"
        return read_rims(rims, CAMERA, path, MOON, sigma_px=1.0, edge_points=60)[:2]


@dataclass(frozen=True)
class Done:
    """What a command line returned and printed."""

    code: int
    out: str
    err: str


Run = Callable[..., Done]


@pytest.fixture
def run(files: Files, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process: a new one takes seconds to import everything."""

    def call(*options: str, rims: Path | None = None) -> Done:
        monkeypatch.setattr(sys, "argv", ["craternav", *files.arguments(rims), *options])
        with pytest.raises(SystemExit) as stop:
            main()
        printed = capsys.readouterr()
        return Done(int(stop.value.code or 0), printed.out, printed.err)

    return call


@pytest.fixture
def files(tmp_path: Path) -> Files:
    catalog = Catalog(
        identifiers=("01-a", "01-b", "01-c", "01-d"),
        latitude_rad=np.radians([0.0, 0.2, -0.25, 0.1]),
        longitude_rad=np.radians([23.0, 23.3, 23.2, 22.7]),
        semi_major_m=np.array([3000.0, 2500.0, 2200.0, 2600.0]),
        semi_minor_m=np.array([2500.0, 2400.0, 1500.0, 2000.0]),
        angle_rad=np.radians([20.0, 80.0, 130.0, -30.0]),
        height_m=np.array([100.0, -50.0, 0.0, 300.0]),
        body=MOON,
    )
    down = frames.east_north_up(np.radians(0.1), np.radians(23.0))
    gTc = frames.pose(
        down @ np.diag([1.0, -1.0, -1.0]) @ frames.rotation_exp(np.array([0.25, -0.2, 0.7])), np.zeros(3)
    )
    gTc[:3, 3] = catalog.centres.mean(axis=0) - 50e3 * gTc[:3, 2]
    gTb = np.ascontiguousarray(gTc @ frames.inverse(CAMERA.bTc))
    charts, seen = project_rims(gTb, CAMERA.bTc, catalog.centres, catalog.axes)
    assert seen.all()
    rows = []
    charts_px = pixel_chart(charts, CAMERA)
    for name, (x, y), S in zip(
        catalog.identifiers, charts_px[:, :2], matrix_of_chart(charts_px), strict=True
    ):
        values, vectors = np.linalg.eigh(S)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        numbers = (x, y, np.sqrt(values[1]), np.sqrt(values[0]), angle)
        rows.append(",".join([*(repr(float(v)) for v in numbers), name]))
    (tmp_path / "sensor.yaml").write_text(camera_yaml(CAMERA, 1.0))
    write_catalog(tmp_path / "craters.csv", catalog)
    return Files(tmp_path, gTb, rows, catalog)


def check_pose(pose: dict[str, object], gTb: np.ndarray, within_m: float = 1.0) -> None:
    np.testing.assert_allclose(pose["position_m"], gTb[:3, 3], atol=within_m)
    turned = frames.from_quaternion_wxyz(np.array(pose["attitude_wxyz"])).T @ gTb[:3, :3]
    assert np.linalg.norm(frames.rotation_log(turned)) < within_m / 10e3


def test_a_pose_from_files(files: Files, run: Run) -> None:
    done = run("--json")
    assert done.code == 0, done.err
    values = json.loads(done.out)
    assert values["status"] == "solved"
    (pose,) = values["poses"]
    check_pose(pose, files.gTb)
    latitude, longitude = np.degrees(frames.latitude_longitude(files.gTb[:3, 3]))
    assert (pose["latitude_deg"], pose["longitude_deg"]) == pytest.approx((latitude, longitude), abs=1e-4)
    assert pose["altitude_m"] == pytest.approx(np.linalg.norm(files.gTb[:3, 3]) - MOON.radius_m, abs=1.0)
    assert np.array(pose["covariance"]).shape == (6, 6)
    assert set(pose["residuals"]) == set(files.catalog.identifiers)
    assert values["warnings"] == []
    assert done.err == ""
    shown = run()
    assert shown.code == 0
    assert f"latitude {pose['latitude_deg']:.5f}" in shown.out
    assert f"position in g {pose['position_m'][0]:.2f}" in shown.out


def test_a_lens_that_distorts_is_refused(files: Files, run: Run) -> None:
    sensor = files.folder / "sensor.yaml"
    sensor.write_text(camera_yaml(replace(CAMERA, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0)), 1.0))
    done = run()
    assert done.code == 2
    assert "sensor.yaml: expected a lens without distortion" in done.err


def test_as_a_process(files: Files) -> None:
    command = [sys.executable, "-m", "craternav_fg", *files.arguments(), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["status"] == "solved"


def test_what_is_taken_for_granted_of_a_catalogue_is_said(files: Files, run: Run) -> None:
    path = files.folder / "anonymous.csv"
    rows = [
        f"{name},{lat:.9f},{lon:.9f},{2e-3 * a:.9f}"
        for name, lat, lon, a in zip(
            files.catalog.identifiers, np.degrees(files.catalog.latitude_rad),
            np.degrees(files.catalog.longitude_rad), files.catalog.semi_major_m, strict=True,
        )
    ]  # fmt: skip
    path.write_text("\n".join(["id,lat,lon,diam_km", *rows, "none,95,0,1", ""]))
    told = run("--catalog", str(path)).err
    assert f"warning: {path}: 1 row left out: lat: expected -90 to 90 deg, line" in told
    assert (
        f"warning: {path}: nothing tells of which body it is: taken for the Moon's (--body-radius-m)" in told
    )
    assert "taken for the Moon" not in run("--catalog", str(path), "--body-radius-m", "1737400").err
    done = run("--catalog", str(path), "--body-radius-m", "1737.4")
    assert done.code == 2
    assert "of the body's radius, 1737.4 m" in done.err


def test_one_rim_with_an_attitude(files: Files, run: Run) -> None:
    quaternion = ",".join(map(str, frames.to_quaternion_wxyz(files.gTb[:3, :3])))
    done = run("--attitude", quaternion, "--json", rims=files.rims(files.rows[0]))
    assert done.code == 0, done.err
    values = json.loads(done.out)
    check_pose(values["poses"][0], files.gTb)
    (warning,) = values["warnings"]
    assert warning.startswith("1 rim checks its match hardly")
    assert done.err == f"craternav: warning: {warning}\n"


def test_one_rim_with_the_sun(files: Files, run: Run) -> None:
    sun = np.array([0.2, 0.9, 0.3])
    up = files.catalog.normals[0]
    chart, _ = project_rims(files.gTb, CAMERA.bTc, files.catalog.centres[:1], files.catalog.axes[:1])
    tilt, _ = sun_tilt(
        files.gTb, CAMERA.bTc, sun - (sun @ up) * up, chart[0, 0], chart[0, 1], np.empty((1, 6))
    )
    option = f"{np.degrees(tilt)},0.5," + ",".join(map(str, sun))
    done = run("--sun", option, "--json", rims=files.rims(files.rows[0]))
    assert done.code == 0, done.err
    values = json.loads(done.out)
    assert values["status"] == "ambiguous"
    off = [np.linalg.norm(np.array(pose["position_m"]) - files.gTb[:3, 3]) for pose in values["poses"]]
    assert min(off) < 20.0


def test_one_rim_alone_is_refused_but_shown_as_json(files: Files, run: Run) -> None:
    done = run("--json", rims=files.rims(files.rows[0]))
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert done.err.startswith("craternav: the image leaves a direction of the pose free: rank 5")
    values = json.loads(done.out)
    assert values["status"] == "undetermined"
    assert values["poses"] == []


def test_a_wrong_match_is_named(files: Files, run: Run) -> None:
    rows = [*files.rows[:3], files.rows[3].replace("01-d", "01-e")]
    text = (files.folder / "craters.csv").read_text()
    line = next(line for line in text.splitlines() if line.startswith("01-a"))
    cells = line.split(",")
    other = ",".join(["01-e", str(float(cells[1]) + 0.3), *cells[2:]])
    (files.folder / "craters.csv").write_text(text + other + "\n")
    refused = run(rims=files.rims(*rows))
    assert refused.code == 2
    assert refused.err.startswith("craternav: no pose explains the rims: the best pose leaves")
    done = run("--robust", "--json", rims=files.rims(*rows))
    assert done.code == 0, done.err
    values = json.loads(done.out)
    assert values["wrong"] == ["01-e"]
    check_pose(values["poses"][0], files.gTb)


def test_one_of_two_matches_is_wrong_beside_a_vague_attitude(files: Files, run: Run) -> None:
    quaternion = ",".join(map(str, frames.to_quaternion_wxyz(files.gTb[:3, :3])))
    rims = files.rims(files.rows[0], files.rows[1].replace("01-b", "01-d"))
    done = run("--robust", "--attitude", quaternion, "--attitude-sigma-deg", "40", "--json", rims=rims)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert json.loads(done.out)["poses"] == []


def test_sigma_scales_the_covariance(files: Files) -> None:
    with_sigma = files.rims(*(f"{row},0.2" for row in files.rows), header=f"{HEADER},sigma_px")
    rims, *_ = read_rims(with_sigma, CAMERA, files.folder / "craters.csv", MOON, sigma_px=0.1, edge_points=60)
    plain, *_ = read_rims(
        files.rims(), CAMERA, files.folder / "craters.csv", MOON, sigma_px=0.1, edge_points=60
    )
    np.testing.assert_allclose(rims.covariance, 4.0 * plain.covariance, rtol=1e-3, atol=1e-15)


def cell(row: str, column: int, value: str) -> str:
    cells = row.split(",")
    cells[column] = value
    return ",".join(cells)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda r: [r[0], cell(r[1], 5, "01-a")], r"rims\.csv:3: CRATER_ID: .*'01-a' again, first in line 2"),
        (
            lambda r: [cell(r[0], 5, "99-z")],
            r"rims\.csv:2: CRATER_ID: expected a crater of .*s\.csv, found",
        ),
        (lambda r: [r[0], cell(r[1], 0, "5000")], r"rims\.csv:3: ellipseCenterX\(px\): .*1024 x 768 image"),
        (lambda r: [cell(r[0], 1, "-400")], r"rims\.csv:2: ellipseCenterY\(px\): .*found its centre at -400"),
        (lambda r: [cell(r[0], 3, "0")], r"rims\.csv:2: ellipseSemiminor\(px\): expected 0\.1 to 10240 px"),
        (lambda r: [cell(r[0], 3, "1e-200")], r"rims\.csv:2: ellipseSemiminor\(px\): .* found 1e-200"),
        (lambda r: [r[1], cell(r[0], 2, "1e200")], r"rims\.csv:3: ellipseSemimajor\(px\): .* found 1e\+200"),
        (lambda r: [cell(r[0], 0, "1e200")], r"rims\.csv:2: ellipseCenterX\(px\): .*1024 x 768 image"),
        (
            lambda r: [cell(r[0], 3, "900")],
            r"rims\.csv:2: ellipseSemiminor\(px\): expected at most the",
        ),
        (lambda r: [cell(r[0], 4, "nan")], r"rims\.csv:2: ellipseRotation\(deg\): expected a finite number"),
        (lambda r: [cell(r[0], 2, "big")], r"rims\.csv:2: ellipseSemimajor\(px\): expected a number"),
    ],
)
def test_a_bad_cell_is_named(files: Files, spoil: Callable[[list[str]], list[str]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        files.read(files.rims(*spoil(files.rows)))


@pytest.mark.parametrize("sigma", ["0", "1e-200", "1e200", "-1"])
def test_a_standard_deviation_out_of_range_is_named(files: Files, sigma: str) -> None:
    rims = files.rims(f"{files.rows[0]},1.0", f"{files.rows[1]},{sigma}", header=f"{HEADER},sigma_px")
    with pytest.raises(InputError, match=r"rims\.csv:3: sigma_px: expected 1e-06 to 1000 px, found"):
        files.read(rims)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(",", ", "),
        lambda text: "\n  \n" + text,
        lambda text: text.replace("\n", "\n   \n\n"),
        lambda text: "".join(f"{line},{'note' if k == 0 else 'x'}\n" for k, line in enumerate(text.split())),
        lambda text: text.replace("\n", ",\n"),
    ],
    ids=["spaces", "blank first", "blank between", "another column", "closing comma"],
)
def test_how_a_table_is_laid_out_does_not_matter(files: Files, change: Callable[[str], str]) -> None:
    path = files.rims()
    plain, _ = files.read(path)
    text = path.read_text()
    path.write_text(change(text))
    rims, _ = files.read(path)
    assert rims.identifiers == plain.identifiers
    np.testing.assert_array_equal(rims.chart, plain.chart)
    path.write_text(change(text.replace("01-d", "99-z")))
    line = next(k for k, row in enumerate(path.read_text().split("\n"), 1) if "99-z" in row)
    with pytest.raises(InputError, match=rf"rims\.csv:{line}: CRATER_ID: .*found '99-z'"):
        files.read(path)


@pytest.mark.parametrize(("sign", "name"), [(";", "semicolons"), ("\t", "tabs")])
def test_another_separator_is_named(files: Files, sign: str, name: str) -> None:
    path = files.rims()
    path.write_text(path.read_text().replace(",", sign))
    with pytest.raises(InputError, match=rf"rims\.csv:1: expected columns separated by commas, found {name}"):
        files.read(path)


def test_a_column_almost_of_the_standard_deviation_is_not_passed_over(files: Files) -> None:
    rims = files.rims(*(f"{row},1.0" for row in files.rows), header=f"{HEADER},sigma")
    with pytest.raises(InputError, match=r"rims\.csv:1: sigma: expected only the columns"):
        files.read(rims)


def test_a_file_without_rims(files: Files) -> None:
    path = files.folder / "rims.csv"
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match=r"rims\.csv: expected at least one rim, found none"):
        files.read(path)
    path.write_text("ellipseCenterX(px)\n")
    with pytest.raises(InputError, match=r"rims\.csv:1: ellipseCenterY\(px\): .* missing"):
        files.read(path)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            ("--attitude", "1,0,0"),
            "craternav: --attitude: expected 4 numbers, separated by commas, found",
        ),
        (("--sun", "1,2,x,0,0"), "craternav: --sun: expected 5 numbers"),
        (
            ("--sun", "1,0,1,0,0"),
            "craternav: sun: expected a standard deviation of 1e-06 to 360 deg, found 0",
        ),
        (("--sun", "1,1,0,0,0"), "craternav: sun: expected a direction, found zero"),
        (("--attitude", "0,0,0,0"), "craternav: attitude: expected a quaternion, found zero"),
        (
            ("--body-radius-m", "561400"),
            "FOLDER/craters.csv: BODY_RADIUS_M: expected a catalogue on a sphere",
        ),
    ],
)
def test_a_bad_option_is_one_line(files: Files, run: Run, options: tuple[str, str], says: str) -> None:
    done = run(*options)
    assert done.code == 2
    assert done.err.startswith(says.replace("FOLDER", f"craternav: {files.folder}"))
    assert done.err.count("\n") == 1
    assert done.out == ""
