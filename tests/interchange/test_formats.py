"""Kalibr in and out; TUM, KITTI, GeoJSON, KML and COLMAP out."""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.dataset.sensor_files import read_camera, read_imu_noise, read_imu_rate_hz
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuNoise
from craternav_fg.interchange.colmap import write_colmap
from craternav_fg.interchange.kalibr import camchain_yaml, kalibr_imu_yaml, read_camchain, read_kalibr_imu
from craternav_fg.interchange.maps import footprint, ground_track, write_geojson, write_kml
from craternav_fg.interchange.trajectories import write_kitti
from craternav_fg.simulation.scenario import simulate
from craternav_fg.trajectory import Trajectory
from tests import descents
from tests.cli.calls import call

MOON = Body("Moon", 1737400.0, 4.902800118e12, (0.0, 0.0, 2.6616995e-6))
MOUNTED = frames.pose(frames.rotation_exp(np.array([0.1, -0.4, 1.2])), np.array([1.2, -0.3, 0.8]))
CAMERA = Camera(752, 480, 458.654, 457.296, 367.215, 248.375, MOUNTED, (-0.28, 0.07, 2e-4, 2e-5, 0.0))
FISHEYE = replace(CAMERA, distortion=(0.01, -0.002, 0.003, 0.0), lens_model="fisheye")
NOISE = ImuNoise(
    gyro_density_rad_s_sqrt_hz=2.04e-05,
    accelerometer_density_m_s2_sqrt_hz=3.43e-4,
    gyro_walk_rad_s2_sqrt_hz=8.1e-9,
    accelerometer_walk_m_s3_sqrt_hz=4.9e-6,
)

# As Kalibr writes it, with matrices in rows: TUM VI's cam0, cropped.
CAMCHAIN = """cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.1]
  - [1.0, 0.0, 0.0, -0.2]
  - [0.0, 0.0, 1.0, 0.05]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034823894022493434, 0.0007150348452162257, -0.00205323614187, 0.000202936735918]
  distortion_model: equidistant
  intrinsics: [190.97847715128717, 190.9733070521226, 188.93170605935475, 190.8974428996504]
  resolution: [380, 380]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.005
cam1:
  T_cn_cnm1: []
  camera_model: omni
"""


def level(latitude_deg: float, longitude_deg: float, altitude_m: float) -> np.ndarray:
    """Pose of a lander whose z points down and whose x points north."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    R = frames.east_north_up(latitude, longitude)
    up = frames.up(latitude, longitude)
    return frames.pose(np.column_stack([R[:, 1], R[:, 0], -R[:, 2]]), (MOON.radius_m + altitude_m) * up)


def track(*places: tuple[float, float, float]) -> Trajectory:
    gTb = np.array([level(*place) for place in places])
    stamps = 1_000_000_001 * np.arange(1, len(gTb) + 1)
    return Trajectory(stamps, gTb, np.zeros((len(gTb), 3)), np.zeros((len(gTb), 6)))


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["radtan", "equidistant"])
def test_kalibr_reads_back(tmp_path: Path, camera: Camera) -> None:
    (tmp_path / "camchain.yaml").write_text(camchain_yaml(camera, "/cam0/image_raw"))
    found, shift_s = read_camchain(tmp_path / "camchain.yaml")
    assert shift_s == 0.0
    # Kalibr's lenses have four coefficients.
    written = yaml.safe_load((tmp_path / "camchain.yaml").read_text())["cam0"]
    assert written["distortion_coeffs"] == list(camera.distortion[:4])
    np.testing.assert_array_equal(found.lens, camera.lens)
    np.testing.assert_allclose(found.bTc, camera.bTc, atol=1e-15)
    (tmp_path / "imu.yaml").write_text(kalibr_imu_yaml(NOISE, 200.0, "/imu0"))
    assert read_kalibr_imu(tmp_path / "imu.yaml") == NOISE


def test_the_noise_that_the_page_of_bags_writes_down_is_read(tmp_path):
    page = Path(__file__).resolve().parents[2] / "docs/howto/bags.md"
    (text,) = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    (tmp_path / "imu.yaml").write_text(text)
    noise = read_kalibr_imu(tmp_path / "imu.yaml")
    assert (noise.gyro_density_rad_s_sqrt_hz, noise.accelerometer_density_m_s2_sqrt_hz) == (1e-5, 1e-4)
    assert (noise.gyro_walk_rad_s2_sqrt_hz, noise.accelerometer_walk_m_s3_sqrt_hz) == (1e-7, 1e-5)


def test_a_chain_as_kalibr_writes_it(tmp_path: Path) -> None:
    (tmp_path / "camchain.yaml").write_text(CAMCHAIN)
    camera, shift_s = read_camchain(tmp_path / "camchain.yaml")
    assert shift_s == -0.005
    assert camera.lens_model == "fisheye"
    # A point on the camera's axis, in b: T_cam_imu maps it back.
    point_b = camera.bTc @ [0.0, 0.0, 2.0, 1.0]
    chain = np.array([[0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.05], [0, 0, 0, 1]])
    np.testing.assert_allclose(chain @ point_b, [0.0, 0.0, 2.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("nested", [True, False])
def test_the_rate_of_an_imu_is_kept(tmp_path: Path, nested: bool) -> None:
    text = kalibr_imu_yaml(NOISE, 400.0, "/imu0")
    if nested:
        lines = "".join(f"  {line}\n" for line in text.splitlines())
        text = f"imu0:\n  model: calibrated\n{lines}"
    (tmp_path / "imu.yaml").write_text(text)
    done = call("import", "kalibr", tmp_path / "imu.yaml", "-o", tmp_path / "sensor.yaml")
    assert done.code == 0, done.err
    assert read_imu_rate_hz(tmp_path / "sensor.yaml") == 400.0
    # An IMU is of no camera.
    done = call("import", "kalibr", tmp_path / "imu.yaml", "-o", tmp_path / "s.yaml", "--camera-name", "cam0")
    assert (done.code, "--camera-name: does nothing" in done.err) == (2, True)
    assert read_imu_noise(tmp_path / "sensor.yaml") == NOISE


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("equidistant", "omni", "distortion_model"),
        ("[380, 380]", "[380]", "resolution"),
        ("[0.0, 0.0, 1.0, 0.05]", "[0.0, 0.0, 2.0, 0.05]", "cam0.T_cam_imu: expected a rotation"),
        (
            ", 188.93170605935475",
            ", 3200.0",
            "cam0.intrinsics: expected the principal point inside the 380 x 380",
        ),
        ("[190.97847715128717", "[3.9e5", "cam0.intrinsics: expected focal lengths in px that fit"),
        ("camera_model: pinhole", "camera_model: ds", "pinhole"),
        ("[380, 380]", "[512, 512]", "90 deg from its axis"),
        ("cam0:", "cam7:", "expected a camera cam0"),
    ],
)
def test_a_wrong_chain_is_refused_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    (tmp_path / "camchain.yaml").write_text(CAMCHAIN.replace(old, new, 1))
    with pytest.raises(InputError, match=says) as caught:
        read_camchain(tmp_path / "camchain.yaml")
    assert "\n" not in str(caught.value)


def test_a_lens_that_kalibr_has_not_is_refused() -> None:
    with pytest.raises(ValueError, match="Kalibr has no other"):
        camchain_yaml(replace(CAMERA, distortion=(-0.28, 0.07, 0.0, 0.0, 0.01)), "/cam0")


def test_kitti_begins_at_the_first_camera(tmp_path: Path) -> None:
    trajectory = track((0.0, 10.0, 5e4), (0.1, 10.0, 4e4), (0.2, 10.1, 3e4))
    write_kitti(tmp_path / "poses.txt", trajectory, CAMERA)
    found = np.loadtxt(tmp_path / "poses.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(found[0], np.eye(4)[:3], atol=1e-9)
    # A point fixed in g, as two cameras see it, is one point of the first camera.
    point_g = np.append(frames.up(0.001, np.radians(10.0)) * MOON.radius_m, 1.0)
    gTc = CAMERA.gTc(trajectory.gTb)
    seen = [np.linalg.solve(T, point_g) for T in gTc]
    np.testing.assert_allclose(found[2] @ seen[2], seen[0][:3], atol=1e-6)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "poses_times.txt"), [0.0, 1.000000001, 2.000000002])


def test_the_ground_track_runs_on_across_the_date_line() -> None:
    found = ground_track(track((5.0, 179.0, 1e4), (5.0, -179.0, 2e4)), MOON)
    np.testing.assert_allclose(found, [[179.0, 5.0, 1e4], [181.0, 5.0, 2e4]], atol=1e-6)


def test_a_footprint_is_as_large_as_the_field_of_view_on_the_ground() -> None:
    """From low above the equator, looking down with x to the north: half-widths on the plane below."""
    camera = Camera(1000, 500, 1000.0, 1000.0, 499.5, 249.5)
    outline = footprint(level(0.0, 30.0, 1000.0), camera, MOON)
    assert outline is not None
    half_m = np.radians(np.ptp(outline, axis=0) / 2.0) * MOON.radius_m
    np.testing.assert_allclose(half_m, [249.5, 499.5], rtol=1e-3)
    np.testing.assert_allclose(outline[:-1].mean(axis=0), [30.0, 0.0], atol=1e-3)
    np.testing.assert_array_equal(outline[0], outline[-1])


def enclosed_deg2(ring: np.ndarray) -> float:
    """Area of a closed ring on a map, positive counter-clockwise."""
    (x, y), (u, v) = ring[:-1].T, ring[1:].T
    return float(0.5 * np.sum(x * v - u * y))


@pytest.mark.parametrize("longitude_deg", [30.0, 180.0])
def test_footprints_are_counter_clockwise(longitude_deg: float) -> None:
    outline = footprint(
        level(10.0, longitude_deg, 1000.0), Camera(1000, 500, 1000.0, 1000.0, 499.5, 249.5), MOON
    )
    assert outline is not None
    assert enclosed_deg2(outline) > 0.0
    assert np.abs(np.diff(outline, axis=0)).max() < 0.1


@pytest.mark.parametrize("pole", [90.0, -90.0])
def test_a_footprint_around_a_pole_is_closed_along_it(pole: float) -> None:
    """From 10 km above a place 3 km from the pole, with a view of 10 x 5 km."""
    camera = Camera(1000, 500, 1000.0, 1000.0, 499.5, 249.5)
    outline = footprint(level(pole - np.copysign(0.03, pole), 50.0, 1e4), camera, MOON)
    assert outline is not None
    np.testing.assert_array_equal(outline[0], outline[-1])
    along = outline[:-3, 0]
    assert np.ptp(along) == pytest.approx(360.0)
    assert np.abs(np.diff(along)).max() < 90.0
    assert outline[-3:-1].tolist() == [[along[-1], pole], [along[0], pole]]
    # Of the strip between pole and outline: what the image shows, on a map.
    strip_deg2 = 360.0 * np.mean(np.abs(pole - outline[:-3, 1]))
    assert 0.5 * strip_deg2 < enclosed_deg2(outline) < 1.5 * strip_deg2


def test_there_is_no_footprint_with_the_horizon_in_the_image() -> None:
    tilted = level(0.0, 30.0, 1000.0)
    tilted[:3, :3] = tilted[:3, :3] @ frames.rotation_exp(np.array([0.0, 1.4, 0.0]))
    camera = Camera(1000, 500, 1000.0, 1000.0, 499.5, 249.5)
    assert footprint(tilted, camera, MOON) is None
    up = level(0.0, 30.0, 1000.0)
    up[:3, 1:3] *= -1.0
    assert footprint(up, camera, MOON) is None


def test_maps_hold_track_and_footprints(tmp_path: Path) -> None:
    named = replace(MOON, name='Moon & "co"')
    trajectory = track((0.0, 10.0, 5e4), (0.1, 10.0, 4e4), (0.2, 10.1, 3e4))
    write_geojson(tmp_path / "m.geojson", trajectory, CAMERA.pinhole, named, every=2)
    features = json.loads((tmp_path / "m.geojson").read_text())["features"]
    assert [feature["geometry"]["type"] for feature in features] == ["LineString", *["Polygon"] * 2]
    np.testing.assert_allclose(features[0]["geometry"]["coordinates"][2], [10.1, 0.2, 3e4], rtol=1e-9)
    assert features[2]["properties"] == {"name": "frame 2", "frame": 2, "stamp_ns": 3_000_000_003}
    write_kml(tmp_path / "m.kml", trajectory, CAMERA.pinhole, named, every=2)
    root = ElementTree.parse(tmp_path / "m.kml").getroot()
    assert root.get("hint") == 'target=moon & "co"'
    lines = [element.text or "" for element in root.iter("{http://www.opengis.net/kml/2.2}coordinates")]
    assert len(lines) == 3
    assert lines[0].split()[2] == "10.100000000,0.200000000,30000.000"


@pytest.mark.parametrize(
    ("camera", "model", "count"),
    [
        (CAMERA, "OPENCV", 8),
        (CAMERA.pinhole, "PINHOLE", 4),
        (FISHEYE, "OPENCV_FISHEYE", 8),
        (replace(CAMERA, distortion=(-0.28, 0.07, 0.0, 0.0, 0.01)), "FULL_OPENCV", 12),
        (
            replace(CAMERA, distortion=(-0.28, 0.07, *3 * [0.0], 0.01, 0.0, 0.0), lens_model="rational"),
            "FULL_OPENCV",
            12,
        ),
    ],
)
def test_colmap(tmp_path: Path, camera: Camera, model: str, count: int) -> None:
    trajectory = track((0.0, 10.0, 5e4), (0.1, 10.0, 4e4))
    write_colmap(tmp_path / "model", trajectory, camera, ("a.png", "b.png"))
    words = (tmp_path / "model/cameras.txt").read_text().splitlines()[1].split()
    assert words[1:4] == [model, "752", "480"]
    assert len(words[4:]) == count
    # COLMAP counts pixels from the corner of the first one.
    assert float(words[6]) == camera.cx_px + 0.5
    lines = (tmp_path / "model/images.txt").read_text().splitlines()
    words = lines[3].split()
    assert (words[0], words[8:], lines[4]) == ("2", ["1", "b.png"], "")
    R = frames.from_quaternion_wxyz(np.array(words[1:5], dtype=float))
    point_g = frames.up(0.001, np.radians(10.0)) * MOON.radius_m
    in_camera = frames.inverse(camera.gTc(trajectory.gTb[1])) @ np.append(point_g, 1.0)
    np.testing.assert_allclose(R @ point_g + np.array(words[5:8], dtype=float), in_camera[:3], atol=1e-6)


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    simulate(descents.scenario(duration_s=40.0), tmp_path / "data")
    assert call("reconstruct", "data", "-o", "run", "-e", "smoother").code == 0
    for arguments in (
        ["tum", "run", "-o", "s.tum", "-e", "smoother"],
        ["kitti", "run", "-o", "s.txt"],
        ["map", "run", "-o", "s.kml", "--every", "5"],
        ["map", "run", "-o", "s.geojson", "-e", "truth"],
        ["colmap", "run", "-o", "model"],
        ["kalibr", "data", "-o", "calibration"],
        ["bag", "run", "-o", "flight"],
    ):
        done = call("export", *arguments)
        assert done.code == 0, done.err
    np.testing.assert_allclose(np.loadtxt("s.tum"), np.loadtxt("run/smoother.tum"), rtol=1e-14, atol=1e-14)
    for name in ("camchain", "imu"):
        done = call("import", "kalibr", f"calibration/{name}.yaml", "-o", f"{name}_sensor.yaml")
        assert done.code == 0, done.err
    original = read_camera(Path("data/mav0/cam0/sensor.yaml"))
    np.testing.assert_allclose(read_camera(Path("camchain_sensor.yaml")).bTc, original.bTc, atol=1e-15)
    assert read_imu_noise(Path("imu_sensor.yaml")) == read_imu_noise(Path("data/mav0/imu0/sensor.yaml"))
    done = call("export", "tum", "run", "-o", "x.tum", "-e", "ekf")
    assert (done.code, done.err.strip()) == (2, "craternav: run: expected one of smoother, truth, found ekf")
    assert call("export", "map", "run", "-o", "x.shp").code == 2
