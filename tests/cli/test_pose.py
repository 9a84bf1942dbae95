"""`craternav pose`: from files to a pose, and what it says of bad ones."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.ellipse import axes_of_chart, chart_of_axes, normalised_chart, points_on
from factors.kernels.conic import project_rims
from factors.kernels.sun import sun_tilt
from tests.cli.calls import Done, call, craternav
from tests.resection.matched_files import CAMERA, MOON, Files, make_files

Run = Callable[..., Done]
EXACT = ("--focal-sigma-percent", "0", "--principal-sigma-px", "0")


@pytest.fixture
def run(files: Files) -> Run:
    """Run the command on the files."""

    def call_pose(*options: str, rims: Path | None = None) -> Done:
        return call(*files.arguments(rims), *options)

    return call_pose


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return make_files(tmp_path)


def check_pose(pose: dict[str, object], gTb: np.ndarray, within_m: float = 1.0) -> None:
    np.testing.assert_allclose(pose["position_m"], gTb[:3, 3], atol=within_m)
    turned = frames.from_quaternion_wxyz(np.array(pose["attitude_wxyz"])).T @ gTb[:3, :3]
    assert np.linalg.norm(frames.rotation_log(turned)) < within_m / 10e3


def test_a_pose_from_files(files: Files, run: Run) -> None:
    done = run("--json", *EXACT)
    assert done.code == 0, done.err
    values = json.loads(done.out)
    assert values["status"] == "solved"
    assert (values["sigma_scale"], values["focal_scale"]) == (1.0, None)
    (pose,) = values["poses"]
    check_pose(pose, files.gTb)
    latitude, longitude = np.degrees(frames.latitude_longitude(files.gTb[:3, 3]))
    assert (pose["latitude_deg"], pose["longitude_deg"]) == pytest.approx((latitude, longitude), abs=1e-4)
    assert pose["altitude_m"] == pytest.approx(np.linalg.norm(files.gTb[:3, 3]) - MOON.radius_m, abs=1.0)
    covariance = np.array(pose["covariance"])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[3:]), pose["position_sigma_m"])
    # A turn about the image's x axis and a step along its y axis look alike: in g along that axis.
    gRb = files.gTb[:3, :3]
    turns = covariance[:3, 3:] @ gRb
    assert abs(turns[0, 1]) > 0.8 * np.sqrt(covariance[0, 0] * (gRb.T @ covariance[3:, 3:] @ gRb)[1, 1])
    assert set(pose["residuals"]) == set(files.catalog.identifiers)
    assert values["warnings"] == []
    assert done.err == ""
    shown = run()
    assert shown.code == 0
    assert f"latitude {pose['latitude_deg']:.5f}" in shown.out
    assert f"position in g {pose['position_m'][0]:.2f}" in shown.out


def test_an_error_of_the_lever_arm_is_in_the_covariance(files: Files, run: Run) -> None:
    (alone,) = json.loads(run("--json", *EXACT).out)["poses"]
    stated = camera_yaml(replace(CAMERA, lever_arm_sigma_m=30.0), 1.0)
    (files.folder / "sensor.yaml").write_text(stated)
    (pose,) = json.loads(run("--json", *EXACT).out)["poses"]
    added = np.array(pose["covariance"]) - np.array(alone["covariance"])
    np.testing.assert_allclose(added, np.diag([0.0, 0.0, 0.0, 900.0, 900.0, 900.0]), atol=1e-6)


def test_an_error_of_the_mounting_is_in_the_covariance(files: Files, run: Run) -> None:
    (alone,) = json.loads(run("--json", *EXACT).out)["poses"]
    stated = camera_yaml(replace(CAMERA, mounting_sigma_deg=0.2), 1.0)
    (files.folder / "sensor.yaml").write_text(stated)
    (pose,) = json.loads(run("--json", *EXACT).out)["poses"]
    added = np.array(pose["covariance"]) - np.array(alone["covariance"])
    np.testing.assert_allclose(added[:3, :3], np.radians(0.2) ** 2 * np.eye(3), atol=1e-12)
    # A turn about the direction of the lever arm does not move its end; others do by its length.
    arm = files.gTb[:3, :3] @ CAMERA.bTc[:3, 3]
    moved = np.radians(0.2) ** 2 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(added[3:, 3:], moved, atol=1e-6)


def test_a_known_attitude_is_that_of_the_lander_not_of_the_camera(files: Files, run: Run) -> None:
    """The image of a camera that is turned on the lander beside a good star tracker."""
    sigma_deg, rng, squares = 0.1, np.random.default_rng(3), []
    (files.folder / "sensor.yaml").write_text(camera_yaml(replace(CAMERA, mounting_sigma_deg=sigma_deg), 1.0))
    for _ in range(25):
        # The image stays, and so does the camera in g: the lander is elsewhere.
        turn = np.eye(4)
        turn[:3, :3] = frames.rotation_exp(np.radians(sigma_deg) * rng.standard_normal(3))
        gTb = files.gTb @ CAMERA.bTc @ frames.inverse(turn @ CAMERA.bTc)
        attitude = "--attitude", ",".join(map(str, frames.to_quaternion_wxyz(gTb[:3, :3])))
        done = run(*attitude, "--attitude-sigma-deg", "0.001", "--json", *EXACT)
        (pose,) = json.loads(done.out)["poses"]
        assert "contradict" not in done.err
        off = np.array(pose["position_m"]) - gTb[:3, 3]
        squares.append(off @ np.linalg.solve(np.array(pose["covariance"])[3:, 3:], off))
    assert np.mean(squares) < chi2.ppf(0.999, 3 * 25) / 25


def test_a_common_shift_of_the_map_is_in_the_covariance(files: Files, run: Run) -> None:
    (alone,) = json.loads(run("--json", *EXACT).out)["poses"]
    shift = CommonShift.of_source(len(files.catalog), 300.0, 200.0)
    write_catalog(files.folder / "craters.csv", replace(files.catalog, common_shift=shift))
    (pose,) = json.loads(run("--json", *EXACT).out)["poses"]
    added = np.array(pose["position_sigma_m"]) ** 2 - np.array(alone["position_sigma_m"]) ** 2
    range_radii = np.linalg.norm(files.gTb[:3, 3]) / MOON.radius_m
    assert added.sum() == pytest.approx(2.0 * (300.0 * range_radii) ** 2 + 200.0**2, rel=1e-6)
    of_map = np.array(pose["covariance"])[3:, 3:] - np.array(alone["covariance"])[3:, 3:]
    up = files.gTb[:3, 3] / np.linalg.norm(files.gTb[:3, 3])
    assert up @ of_map @ up == pytest.approx(200.0**2, rel=1e-4)


def test_a_rejected_rim_brings_no_common_shift_of_its_source(files: Files, run: Run) -> None:
    rows = files.rows[:]
    x, rest = rows[0].split(",", 1)
    rows[0] = f"{float(x) + 60.0},{rest}"
    places = np.array([3000.0, 0.0, 0.0, 0.0])
    sigma_m = []
    for place_m in (places, 0.0 * places):
        stated = replace(files.catalog, common_shift=CommonShift(place_m, 0.0 * places, np.arange(4)))
        write_catalog(files.folder / "craters.csv", stated)
        values = json.loads(run("--json", "--robust", *EXACT, rims=files.rims(*rows)).out)
        assert values["wrong"] == ["01-a"]
        sigma_m.append(values["poses"][0]["position_sigma_m"])
    np.testing.assert_allclose(*sigma_m, rtol=1e-12)


def test_an_unknown_height_of_the_ground_is_in_the_covariance_and_said(files: Files, run: Run) -> None:
    level = replace(files.catalog, height_m=np.zeros(4))
    found = []
    for known in (True, False):
        write_catalog(files.folder / "craters.csv", replace(level, has_heights=known))
        done = run("--json", "--sigma-px", "10", *EXACT)
        found.append((json.loads(done.out), done.err))
    (before, silent), (after, said) = found
    added = np.sum(
        np.square(after["poses"][0]["position_sigma_m"]) - np.square(before["poses"][0]["position_sigma_m"])
    )
    # The slope of the ground turns the pose, too.
    assert added > (1e-3 * MOON.radius_m) ** 2
    turn_deg = [np.linalg.norm(one["poses"][0]["attitude_sigma_deg"]) for one in (before, after)]
    assert 0.1 < np.sqrt(turn_deg[1] ** 2 - turn_deg[0] ** 2) < 8.2
    assert "RIM_HEIGHT_M" not in silent
    assert not any("RIM_HEIGHT_M" in line for line in before["warnings"])
    assert "1737 m of it" in said
    assert any("1737 m of it" in line for line in after["warnings"])


def test_a_focal_length_that_few_rims_cannot_check_widens_the_pose(files: Files, run: Run) -> None:
    exact = json.loads(run("--json", *EXACT).out)["poses"][0]
    done = run("--json")
    values = json.loads(done.out)
    (warning,) = values["warnings"]
    assert "these rims cannot check the camera's focal length" in warning
    assert warning in done.err
    (pose,) = values["poses"]
    check_pose(pose, files.gTb, 5.0)
    # 0.3 % of 50 km, where the rims do not tell.
    added2 = np.sum(np.square(pose["position_sigma_m"])) - np.sum(np.square(exact["position_sigma_m"]))
    assert 100.0 < np.sqrt(added2) < 160.0
    assert abs(values["focal_scale"] - 1.0) < 0.1 * values["focal_scale_sigma"]
    assert "focal length by the rims" in run().out


def test_the_cameras_file_says_how_well_its_intrinsics_are_known(files: Files, run: Run) -> None:
    sensor = files.folder / "sensor.yaml"
    sensor.write_text(f"{sensor.read_text()}focal_sigma_percent: 0\nprincipal_sigma_px: 0\n")
    from_file, exact = (json.loads(run("--json", *options).out) for options in ((), EXACT))
    assert from_file == exact
    stated = json.loads(run("--json", "--focal-sigma-percent", "0.3").out)
    assert stated["focal_scale"] is not None
    # Whoever states the sigma knows what it means for the distance.
    assert stated["warnings"] == []
    # A poor pose is not wrong by much.
    poor = json.loads(run("--json", "--sigma-ellipse-px", "20").out)
    assert not any("focal length" in text for text in poor["warnings"])


def test_the_error_of_ellipses_instead_of_that_of_edge_points(files: Files, run: Run) -> None:
    """Half a pixel of centre and axes is more than edge points of one pixel give."""
    loose = json.loads(run("--json", "--sigma-ellipse-px", "0.5").out)["poses"][0]
    tight = json.loads(run("--json", "--sigma-ellipse-px", "0.05", *EXACT).out)["poses"][0]
    exact = json.loads(run("--json", "--sigma-ellipse-px", "0.5", *EXACT).out)["poses"][0]
    tenfold = 10.0 * np.array(tight["position_sigma_m"])
    np.testing.assert_allclose(exact["position_sigma_m"], tenfold, rtol=1e-3)
    check_pose(loose, files.gTb)


BENT = replace(CAMERA, distortion=(-0.3, 0.08, 0.01, -0.005, 0.0))


def seen_through(camera: Camera, row: str) -> str:
    """What a distorting camera shows of a rim that a row gives without distortion."""
    *numbers, name = row.split(",")
    ellipse = np.array([float(word) for word in numbers])
    chart = normalised_chart(chart_of_axes([*ellipse[:4], np.radians(ellipse[4])]), camera)[0]
    outline = camera.pixels(points_on(chart, 100))
    (x, y), (d1, d2), angle_deg = cv2.fitEllipseAMS(outline.astype(np.float32))
    x, y, a, b, angle = axes_of_chart(chart_of_axes([x, y, 0.5 * d1, 0.5 * d2, np.radians(angle_deg)]))
    return f"{x},{y},{a},{b},{np.degrees(angle)},{name}"


@pytest.mark.parametrize("options", [(), ("--sigma-ellipse-px", "0.5")], ids=["edge points", "ellipses"])
def test_rims_are_given_as_a_lens_shows_them(files: Files, run: Run, options: tuple[str, ...]) -> None:
    (straight,) = json.loads(run("--json", *EXACT, *options).out)["poses"]
    bent = [seen_through(BENT, row) for row in files.rows]
    (files.folder / "sensor.yaml").write_text(camera_yaml(BENT, 1.0))
    done = run("--json", *EXACT, *options, rims=files.rims(*bent))
    assert done.code == 0, done.err
    (pose,) = json.loads(done.out)["poses"]
    # What a lens shows of an ellipse is none: this strong one costs a third of a standard deviation.
    check_pose(pose, files.gTb, 50.0)
    np.testing.assert_allclose(pose["position_sigma_m"], straight["position_sigma_m"], rtol=0.1)


def test_as_a_process(files: Files) -> None:
    assert json.loads(craternav(*files.arguments(), "--json").stdout)["status"] == "solved"


def test_what_was_skipped_and_assumed_of_a_catalogue_is_said(files: Files, run: Run) -> None:
    path = files.folder / "anonymous.csv"
    rows = [
        f"{name},{lat:.9f},{lon:.9f},{2e-3 * a:.9f}"
        for name, lat, lon, a in zip(
            files.catalog.identifiers, np.degrees(files.catalog.latitude_rad),
            np.degrees(files.catalog.longitude_rad), files.catalog.semi_major_m, strict=True,
        )
    ]  # fmt: skip
    path.write_text("\n".join(["id,lat,lon,diam_km", *rows, "none,95,0,1", ""]))
    warnings = run("--catalog", str(path)).err
    assert f"warning: {path}: 1 row skipped: lat: expected -90 to 90 deg, line" in warnings
    assert (
        f"warning: {path}: does not name its body, the Moon is assumed (craternav catalog import --body "
        "gives another)" in warnings
    )
    assert "the Moon is assumed" not in run("--catalog", str(path), "--body-radius-m", "1737400").err
    done = run("--catalog", str(path), "--body-radius-m", "1737.4")
    assert done.code == 2
    assert "of the body's radius, 1737.4 m" in done.err


def test_one_rim_with_an_attitude(files: Files, run: Run) -> None:
    quaternion = ",".join(map(str, frames.to_quaternion_wxyz(files.gTb[:3, :3])))
    options = ("--attitude", quaternion, "--attitude-sigma-deg", "0", "--json", *EXACT)
    done = run(*options, rims=files.rims(files.rows[0]))
    assert done.code == 0, done.err
    values = json.loads(done.out)
    check_pose(values["poses"][0], files.gTb)
    (warning,) = values["warnings"]
    assert warning.startswith("1 rim cannot reveal a wrong match")
    assert done.err == f"craternav: warning: {warning}\n"


def test_one_rim_with_the_sun(files: Files, run: Run) -> None:
    sun = np.array([0.2, 0.9, 0.3])
    up = files.catalog.normals[0]
    chart, _ = project_rims(files.gTb, CAMERA.bTc, files.catalog.centres[:1], files.catalog.axes[:1])
    tilt, _ = sun_tilt(
        files.gTb, CAMERA.bTc, sun - (sun @ up) * up, chart[0, 0], chart[0, 1], np.empty((1, 6))
    )
    # Of pixels that are not square.
    tilt_px = np.arctan2(CAMERA.fy_px * np.sin(tilt), CAMERA.fx_px * np.cos(tilt))
    light = ("--sun-tilt-deg", f"{np.degrees(tilt_px)},0.5", "--sun", ",".join(map(str, sun)))
    done = run(*light, "--json", rims=files.rims(files.rows[0]))
    assert done.code == 0, done.err
    values = json.loads(done.out)
    assert values["status"] == "ambiguous"
    off = [np.linalg.norm(np.array(pose["position_m"]) - files.gTb[:3, 3]) for pose in values["poses"]]
    assert min(off) < 20.0


def test_one_rim_alone_is_refused_but_shown_as_json(files: Files, run: Run) -> None:
    done = run("--json", rims=files.rims(files.rows[0]))
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert done.err.startswith("craternav: the image does not determine the whole pose: rank 5")
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


def test_an_attitude_that_the_rims_contradict(files: Files, run: Run) -> None:
    turned = files.gTb[:3, :3] @ frames.rotation_exp(np.radians([6.0, -6.0, 0.0]))
    attitude = "--attitude", ",".join(map(str, frames.to_quaternion_wxyz(turned)))
    # Seven standard deviations: not too much beside the residuals of the rims.
    done = run("--robust", *attitude, "--attitude-sigma-deg", "1.2", *EXACT)
    assert done.code == 0, done.err
    assert "the rims contradict the attitude: the pose is turned by 8.4 deg from it" in done.err
    assert "contradict" not in run("--robust", *attitude, "--attitude-sigma-deg", "5", *EXACT).err


def test_a_mounting_in_millimetres(files: Files, run: Run) -> None:
    bTc = frames.pose(np.eye(3), np.array([1200.0, 0.0, 300.0]))
    (files.folder / "sensor.yaml").write_text(camera_yaml(replace(CAMERA, bTc=bTc), 1.0))
    assert "camera: its lever arm in T_BS is 1237 m; expected metres" in run(*EXACT).err


def test_a_lever_arm_that_is_left_out_is_told_where_it_matters(files: Files, run: Run) -> None:
    """Of a camera that is turned against the body: where both have the same axes, b is the camera."""
    R = CAMERA.bTc[:3, :3]
    for rotation, sigma_px, sigma_m, told in (
        (R, "0.001", None, True),
        (R, "0.001", 0.0, False),
        (R, "1", None, False),
        (np.eye(3), "0.001", None, False),
    ):
        camera = replace(CAMERA, bTc=frames.pose(rotation, np.zeros(3)), lever_arm_sigma_m=sigma_m)
        (files.folder / "sensor.yaml").write_text(camera_yaml(camera, 1.0))
        done = run("--sigma-px", sigma_px, *EXACT)
        assert done.code == 0
        assert ("its lever arm in T_BS is zero" in done.err) == told


def test_one_of_two_matches_is_wrong_beside_a_vague_attitude(files: Files, run: Run) -> None:
    quaternion = ",".join(map(str, frames.to_quaternion_wxyz(files.gTb[:3, :3])))
    rims = files.rims(files.rows[0], files.rows[1].replace("01-b", "01-d"))
    done = run("--robust", "--attitude", quaternion, "--attitude-sigma-deg", "40", "--json", rims=rims)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert json.loads(done.out)["poses"] == []


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            ("--attitude", "1,0,0"),
            "craternav: --attitude: expected 4 numbers, separated by commas, found",
        ),
        (("--sun", "1,2,x"), "craternav: --sun: expected 3 numbers"),
        (("--sun", "1,2,3"), "craternav: --sun-tilt-deg, --sun: expected both, found one"),
        (("--attitude", "1,0,0,0"), "craternav: --attitude, --attitude-sigma-deg: expected both, found one"),
        (
            ("--sun-tilt-deg", "1,0", "--sun", "1,0,0"),
            "craternav: sun: expected a standard deviation of 1e-06 to 360 deg, found 0",
        ),
        (("--sun-tilt-deg", "1,1", "--sun", "0,0,0"), "craternav: sun: expected a direction, found zero"),
        (
            ("--attitude", "0,0,0,0", "--attitude-sigma-deg", "1"),
            "craternav: --attitude: expected a quaternion, found zero",
        ),
        (
            ("--body-radius-m", "561400"),
            "FOLDER/craters.csv: BODY_RADIUS_M: expected a catalogue on a sphere",
        ),
    ],
)
def test_a_bad_option_is_one_line(files: Files, run: Run, options: tuple[str, ...], says: str) -> None:
    done = run(*options)
    assert done.code == 2
    assert done.err.startswith(says.replace("FOLDER", f"craternav: {files.folder}"))
    assert done.err.count("\n") == 1
    assert done.out == ""
