"""`craternav identify`: what it prints, and what it says of bad input."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.errors import EstimationError
from craternav_fg.matching.identify import from_image
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON
from tests.cli.calls import call
from tests.cli.test_lazy import command_line, imported_by

COLUMNS = [
    "ellipseCenterX(px)", "ellipseCenterY(px)", "ellipseSemimajor(px)", "ellipseSemiminor(px)",
    "ellipseRotation(deg)", "inputImage", "crater_classification",
]  # fmt: skip


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A folder with catalogue, camera and rims of one view, and the view."""
    folder = tmp_path_factory.mktemp("identify")
    rng = np.random.default_rng(3)
    catalog = synthetic_catalog(MOON, rng, count=6000)
    # Zeros alone would count as unknown heights.
    catalog = replace(catalog, height_m=catalog.height_m + 1e-3)
    write_catalog(folder / "craters.csv", catalog)
    options = ViewOptions(sigma_px=0.5, altitudes_m=(300e3, 600e3))
    scene = random_view(catalog, options, rng, true_rims=(9, 40))
    (folder / "sensor.yaml").write_text(camera_yaml(scene.camera, 1.0))
    write_rims(folder / "rims.csv", scene.ellipses_px)
    write_rims(folder / "mirrored.csv", scene.mirrored())
    return folder, catalog, scene


def write_rims(path, ellipses):
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for x, y, a, b, angle in ellipses:
            a, b, turn = (a, b, angle) if a >= b else (b, a, angle + 0.5 * np.pi)
            writer.writerow([x, y, a, b, np.degrees(turn), "frame.png", -1])


@pytest.fixture
def identify(case):
    """Run the command on a table of rims: exit code, standard output, standard error."""
    folder = case[0]

    def run(rims, *arguments):
        files = ("--camera", folder / "sensor.yaml", "--catalog", folder / "craters.csv")
        done = call("identify", rims, *files, *arguments)
        return done.code, done.out, done.err

    return run


def test_craters_and_pose(case, identify) -> None:
    folder, catalog, scene = case
    code, output, errors = identify(folder / "rims.csv", "--json")
    assert code == 0
    assert "is built, once for this catalogue" in errors
    found = json.loads(output)
    assert found["status"] == "identified"
    truth = [catalog.identifiers[row] if row >= 0 else None for row in scene.craters]
    named = [(rim["crater"], true) for rim, true in zip(found["rims"], truth, strict=True) if rim["crater"]]
    assert len(named) >= 7
    assert all(name == true for name, true in named)
    gP = np.array(found["pose"]["position_m"])
    sigma = np.array(found["pose"]["position_sigma_m"])
    assert (np.abs(gP - scene.gTb[:3, 3]) < 6.0 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(found["pose"]["covariance"])[3:]), sigma)
    assert found["log_chance"] < -18.0
    assert found["seconds"] > 0.0
    # The index is loaded, and the attitude makes an answer more certain.
    w, x, y, z = 2.0 * frames.to_quaternion_wxyz(scene.gTb[:3, :3])
    exact = ("--focal-sigma-percent", "0", "--principal-sigma-px", "0")
    for sigma_deg in (1.5, 0):
        attitude = ("--attitude", f"{w},{x},{y},{z}", "--attitude-sigma-deg", sigma_deg)
        code, output, errors = identify(folder / "rims.csv", *attitude, "--json", *exact)
        assert (code, errors) == (0, "")
        known = json.loads(output)
        assert known["index"].endswith("loaded")
        assert known["log_chance"] < found["log_chance"] - 3.0
    code, output, _ = identify(folder / "rims.csv")
    assert code == 0
    assert "standard deviation of the rims' centres" in output
    assert "; focal length by the rims" in output
    assert f"of {len(found['rims'])} rims identified" in output
    assert all(name in output for name, _ in named)


def test_an_attitude_that_the_rims_contradict(case, identify) -> None:
    folder, _, scene = case
    turned = scene.gTb[:3, :3] @ frames.rotation_exp(np.radians([6.0, -6.0, 0.0]))
    attitude = "--attitude", ",".join(map(str, frames.to_quaternion_wxyz(turned))), "--attitude-sigma-deg"
    code, _, errors = identify(folder / "rims.csv", *attitude, 1.0)
    assert code == 0
    assert "the rims contradict the attitude: the pose is turned by 8." in errors
    assert "with a standard deviation of 1 deg; check --attitude" in errors
    assert "contradict the attitude" not in identify(folder / "rims.csv", *attitude, 5.0)[2]


def test_a_common_shift_of_the_map_is_in_the_covariance(case, identify) -> None:
    folder, catalog, _ = case
    shifted = replace(catalog, common_shift=CommonShift.of_source(len(catalog), 3000.0, 2000.0))
    write_catalog(folder / "shifted.csv", shifted)
    alone, told = (
        json.loads(identify(folder / "rims.csv", "--catalog", folder / name, "--json")[1])["pose"]
        for name in ("craters.csv", "shifted.csv")
    )
    range_radii = np.linalg.norm(alone["position_m"]) / MOON.radius_m
    added = np.sum(np.square(told["position_sigma_m"]) - np.square(alone["position_sigma_m"]))
    assert added == pytest.approx(2.0 * (3000.0 * range_radii) ** 2 + 2000.0**2, rel=1e-6)


def test_an_error_of_the_lever_arm_is_in_the_covariance(case, identify) -> None:
    folder, _, scene = case
    (folder / "stated.yaml").write_text(camera_yaml(replace(scene.camera, lever_arm_sigma_m=40.0), 1.0))
    alone, stated = (
        np.array(json.loads(identify(folder / "rims.csv", "--json", *camera)[1])["pose"]["covariance"])
        for camera in ((), ("--camera", folder / "stated.yaml"))
    )
    expected = np.diag([0.0, 0.0, 0.0, 1600.0, 1600.0, 1600.0])
    np.testing.assert_allclose(stated - alone, expected, atol=1e-6 * alone.max())


def test_an_error_of_the_mounting_is_in_the_covariance_of_the_attitude(case, identify) -> None:
    folder, _, scene = case
    (folder / "turned.yaml").write_text(camera_yaml(replace(scene.camera, mounting_sigma_deg=0.5), 1.0))
    alone, stated = (
        np.array(json.loads(identify(folder / "rims.csv", "--json", *camera)[1])["pose"]["covariance"])
        for camera in ((), ("--camera", folder / "turned.yaml"))
    )
    added = stated - alone
    np.testing.assert_allclose(added[:3, :3], np.radians(0.5) ** 2 * np.eye(3), atol=1e-12)
    # The place follows the camera's, and moves by what the turn moves the end of the lever arm.
    arm_m = np.linalg.norm(scene.camera.bTc[:3, 3])
    largest = np.linalg.eigvalsh(added[3:, 3:])[-1]
    np.testing.assert_allclose(largest, (np.radians(0.5) * arm_m) ** 2, atol=1e-6 * alone.max())


def test_an_unknown_height_of_the_ground_is_in_the_covariance_and_said(case, identify) -> None:
    folder, catalog, _ = case
    write_catalog(folder / "level.csv", replace(catalog, has_heights=False))
    before, after = (
        json.loads(identify(folder / "rims.csv", "--catalog", folder / name, "--json")[1])
        for name in ("craters.csv", "level.csv")
    )
    added = np.sum(
        np.square(after["pose"]["position_sigma_m"]) - np.square(before["pose"]["position_sigma_m"])
    )
    assert added > (1e-3 * MOON.radius_m) ** 2
    assert not any("RIM_HEIGHT_M" in line for line in before["warnings"])
    assert any("RIM_HEIGHT_M" in line for line in after["warnings"])


def test_identified_rims_are_what_pose_reads(case, identify, tmp_path) -> None:
    folder, _, scene = case
    code, output, _ = identify(folder / "rims.csv", "-o", tmp_path / "matched.csv", "--json")
    assert code == 0
    assert len((tmp_path / "matched.csv").read_text().splitlines()) == 1 + sum(
        rim["crater"] is not None for rim in json.loads(output)["rims"]
    )
    files = ("--camera", folder / "sensor.yaml", "--catalog", folder / "craters.csv")
    done = call("pose", tmp_path / "matched.csv", "--json", *files)
    assert done.code == 0
    found = json.loads(done.out)
    error = np.array(found["poses"][0]["position_m"]) - scene.gTb[:3, 3]
    assert found["status"] == "solved"
    assert (np.abs(error) < 6.0 * np.array(found["poses"][0]["position_sigma_m"])).all()


def test_pixels_of_the_declared_value_are_holes(case, identify, tmp_path, monkeypatch) -> None:
    camera = case[2].camera
    image, tags = np.full((camera.height_px, camera.width_px), 90, np.uint8), ImageFileDirectory_v2()
    image[:100], tags[42113] = 7, "7"
    Image.fromarray(image).save(tmp_path / "frame.tif", tiffinfo=tags)
    searched = []

    def spied(pixels, *_):
        searched.append(pixels)
        raise EstimationError("not searched")

    monkeypatch.setattr(from_image, "identify_image", spied)
    assert identify(tmp_path / "frame.tif")[2].endswith("not searched\n")
    np.testing.assert_array_equal(searched[0][..., 1] == 0, image == 7)


def test_one_image_needs_neither_pandas_nor_gtsam(case, identify, tmp_path) -> None:
    folder = case[0]
    matched = tmp_path / "matched.csv"
    assert identify(folder / "rims.csv", "-o", matched)[0] == 0
    files = ("--camera", str(folder / "sensor.yaml"), "--catalog", str(folder / "craters.csv"))
    for command, rims in (("identify", folder / "rims.csv"), ("pose", matched)):
        program = command_line(command, str(rims), *files)
        assert not {"pandas", "gtsam", "matplotlib"} & set(imported_by(program)), command
    program = command_line("identify", str(folder / "rims.csv"), *files)
    parts = ("spatial", "special", "ndimage", "optimize")
    assert imported_by(program, [f"scipy.{part}" for part in parts]) == []


def test_results_never_overwrite_what_they_are_from(case, identify) -> None:
    folder, _, _ = case
    before = (folder / "rims.csv").read_bytes()
    code, _, errors = identify(folder / "rims.csv", "-o", folder / "rims.csv")
    assert code == 2
    assert "choose another --output" in errors
    assert (folder / "rims.csv").read_bytes() == before


def test_no_answer(case, identify) -> None:
    code, output, errors = identify(case[0] / "mirrored.csv", "--json")
    assert code == 2
    found = json.loads(output)
    assert (found["status"], found["pose"]) == ("no_answer", None)
    assert all(rim["crater"] is None for rim in found["rims"])
    assert "no pose explains the rims better than chance" in errors


def test_bad_input(case, identify, tmp_path) -> None:
    folder = case[0]
    few = tmp_path / "few.csv"
    write_rims(few, case[2].ellipses_px[:2])
    outside, thin = case[2].ellipses_px[:4].copy(), case[2].ellipses_px[:4].copy()
    outside[1, 0] = 4000.0
    thin[2, 2:4] = [20.0, 0.01]
    write_rims(tmp_path / "outside.csv", outside)
    write_rims(tmp_path / "thin.csv", thin)
    half, turned = case[2].ellipses_px.copy(), case[2].ellipses_px.copy()
    half[:, :4] *= 0.5
    write_rims(tmp_path / "half.csv", half)
    # Degrees of a hundredth of a turn, as if in radians.
    turned[:, 2:4] = [20.0, 17.0]
    turned[:, 4] = np.radians(np.linspace(-1.5, 1.5, len(turned)))
    write_rims(tmp_path / "radians.csv", turned)
    (tmp_path / "image.png").write_bytes(b"no image")
    for arguments, said in (
        ((few,), "too few rims: found 2 rims, expected 3 or more"),
        ((tmp_path / "outside.csv",), "outside.csv:3: ellipseCenterX(px): expected a rim that reaches into"),
        ((tmp_path / "thin.csv",), "thin.csv:4: ellipseSemiminor(px): expected 0.1 to"),
        ((tmp_path / "half.csv",), "in its first quarter: are they of an image of half the size?"),
        ((tmp_path / "radians.csv",), "radians.csv: ellipseRotation(deg): expected rotations in degrees"),
        ((tmp_path / "none.csv",), "none.csv: file is missing"),
        ((tmp_path / "image.png",), "image.png"),
        ((folder / "rims.csv", "--attitude", "1,2,3"), "--attitude: expected 4 numbers"),
        (
            (folder / "rims.csv", "--attitude", "0,0,0,0", "--attitude-sigma-deg", 1),
            "--attitude: expected a quaternion, found zero",
        ),
        ((folder / "rims.csv", "--altitude-km", "50,10"), "--altitude-km: expected 0 < MIN < MAX"),
        (
            (folder / "rims.csv", "--body-radius-m", "561400"),
            "found one of Moon on 1737400 m, as BODY_RADIUS",
        ),
        ((folder / "rims.csv", "--index", few), "few.csv: expected a name that ends in .npz"),
    ):
        code, output, errors = identify(*arguments)
        assert code == 2
        assert output == ""
        assert said in errors
        assert "Traceback" not in errors
    # An index never takes the place of another file.
    assert few.read_text().startswith(COLUMNS[0])
