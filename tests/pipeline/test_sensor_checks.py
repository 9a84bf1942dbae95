"""Data that are wrong without being impossible are refused or told; sound data are not."""

import copy
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.estimators.intrinsics import RADIAL, intrinsic_slopes
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.imu_mistakes import axes
from craternav_fg.pipeline.intrinsics_check import contradicted_intrinsics, contradicted_lens
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from factors.kernels.rim_errors import ground_slopes
from tests.descents import scenario as descent_of

ESTIMATORS = ("smoother", "ekf")
MODEL = {
    "altimeter": {},
    "velocimeter": {"noise_m_s": 0.02, "bias_sigma_m_s": 0.02},
    "star_tracker": {},
    "ranging": {},
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate("measured_descent", tmp_path_factory.mktemp("m") / "data"))


def with_sensors(duration_s: float) -> Scenario:
    """The end of the demo's descent, with every sensor."""
    case = load_scenario("measured_descent")
    trajectory = case.trajectory.model_copy(
        update={
            "duration_s": duration_s,
            "start": case.trajectory.start.model_copy(
                update={"altitude_m": 12e3, "downrange_m": -16e3, "ground_speed_m_s": 370.0}
            ),
        }
    )
    return case.model_copy(update={"trajectory": trajectory, "sensors": MODEL})


@pytest.fixture(scope="module")
def sensors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(with_sensors(80.0), tmp_path_factory.mktemp("s") / "data")


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, Dataset]:
    """Eleven frames of descents without and with other sensors."""
    folder = tmp_path_factory.mktemp("few")
    cases = descent_of(duration_s=20.0), with_sensors(40.0)
    one, other = (Dataset.open(simulate(case, folder / f"{k}")) for k, case in enumerate(cases))
    return one, other


def moved_rims(frame: FrameMeasurement, shift: float) -> FrameMeasurement:
    chart = frame.rims.chart + shift * np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    return replace(frame, rims=replace(frame.rims, chart=chart))


def in_degrees(frame: FrameMeasurement) -> FrameMeasurement:
    if frame.sun is None:
        return frame
    tilt, sigma = np.degrees([frame.sun.tilt_rad, frame.sun.sigma_rad]).tolist()
    return replace(frame, sun=replace(frame.sun, tilt_rad=tilt, sigma_rad=sigma))


def with_frames(data: Dataset, change: Callable[[FrameMeasurement], FrameMeasurement]) -> Dataset:
    assert data.measurements is not None
    return replace(data, measurements=tuple(change(frame) for frame in data.measurements))


def accelerometer_scale(data: Dataset) -> Dataset:
    return replace(data, imu=replace(data.imu, accelerometer_m_s2=1.01 * data.imu.accelerometer_m_s2))


def image_points(data: Dataset) -> Dataset:
    return with_frames(data, lambda frame: moved_rims(frame, 3.0 / data.camera.fx_px))


def longitudes(data: Dataset) -> Dataset:
    turned = data.catalog.longitude_rad + np.radians(0.5)
    return replace(data, catalog=replace(data.catalog, longitude_rad=turned))


def gyro_density_rad_s_sqrt_hz(data: Dataset) -> Dataset:
    density = 60.0 * float(np.degrees(data.imu_noise.gyro_density_rad_s_sqrt_hz))
    return replace(data, imu_noise=replace(data.imu_noise, gyro_density_rad_s_sqrt_hz=density))


def sun_tilts(data: Dataset) -> Dataset:
    return with_frames(data, in_degrees)


def initial_quaternion(data: Dataset) -> Dataset:
    assert data.initial is not None
    gTb = data.initial.gTb.copy()
    wxyz = frames.to_quaternion_wxyz(gTb[:3, :3])
    gTb[:3, :3] = frames.from_quaternion_wxyz(np.roll(wxyz, -1))
    return replace(data, initial=replace(data.initial, gTb=gTb))


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (accelerometer_scale, "sigma from the prior of the accelerometer bias"),
        (image_points, "imu: contradicts"),
        (longitudes, " deg of longitude to the east"),
        (
            gyro_density_rad_s_sqrt_hz,
            "imu: agrees with what ekf predicts better than the stated noise allows",
        ),
        (sun_tilts, "sun: agrees with what ekf predicts better than the stated noise allows"),
        (initial_quaternion, "read as x, y, z, w it agrees"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_mistake_that_fits_is_told(
    measured: Dataset, mistake: Callable[[Dataset], Dataset], said: str
) -> None:
    result = reconstruct(mistake(measured), ESTIMATORS)
    assert any(said in warning for warning in result.warnings), result.warnings


def test_a_lever_arm_in_centimetres_is_told(few: tuple[Dataset, Dataset]) -> None:
    camera = few[0].camera
    bTc = camera.bTc.copy()
    bTc[:3, 3] = 40.0
    result = reconstruct(replace(few[0], camera=replace(camera, bTc=bTc)), ["ekf"])
    assert any("camera: its lever arm in T_BS is" in warning for warning in result.warnings), result.warnings


def test_rims_name_the_intrinsics(measured: Dataset) -> None:
    """By themselves: an IMU of another scale contradicts the rims, but not the intrinsics."""
    data = with_frames(measured, lambda frame: moved_rims(frame, 12.0 / measured.camera.fx_px))
    said = "contradict the camera's intrinsics: check focal lengths, principal point"
    assert any(said in text for text in reconstruct(data, ["ekf"]).warnings)
    assert not any(said in text for text in reconstruct(accelerometer_scale(measured), ["ekf"]).warnings)
    assert data.truth is not None
    for frames_of, contradicted in ((data, True), (measured, False)):
        assert frames_of.measurements is not None
        found = contradicted_intrinsics(frames_of.measurements, data.truth.gTb, data.camera, data.catalog)
        assert found == contradicted


@pytest.mark.parametrize("k1", [-0.05, 0.05])
def test_rims_name_the_lens(measured: Dataset, k1: float) -> None:
    """Of a camera that distorts, which the data set does not say."""

    def distorted(frame: FrameMeasurement) -> FrameMeasurement:
        slopes = intrinsic_slopes(frame.rims.chart, measured.camera)[..., RADIAL]
        return replace(frame, rims=replace(frame.rims, chart=frame.rims.chart + k1 * slopes))

    data, said = with_frames(measured, distorted), "contradict the camera's lens"
    assert any(said in text for text in reconstruct(data, ["ekf"]).warnings)
    assert data.truth is not None
    assert measured.measurements is not None
    for frames_of, contradicted in ((data.measurements, True), (measured.measurements, False)):
        assert frames_of is not None
        found = contradicted_lens(frames_of, data.truth.gTb, data.camera, data.catalog)
        assert found == contradicted
        # Too few frames tell nothing.
        assert not contradicted_lens(frames_of[:3], data.truth.gTb[:3], data.camera, data.catalog)


def test_errors_of_the_map_and_of_the_imu_are_no_lens(measured: Dataset) -> None:
    assert measured.truth is not None
    said = "contradict the camera's lens"
    assert not any(said in text for text in reconstruct(accelerometer_scale(measured), ["ekf"]).warnings)
    for seed in range(6):
        stated = with_errors_of_the_map(measured, 0.03, seed)
        assert not contradicted_lens(stated, measured.truth.gTb, measured.camera, measured.catalog)


def with_errors_of_the_map(data: Dataset, share: float, seed: int) -> list[FrameMeasurement]:
    """Rims of a map whose errors they state: the same ones in every frame, a share of the radius."""
    assert data.truth is not None
    assert data.measurements is not None
    errors = share * np.random.default_rng(seed).normal(size=(len(data.catalog), 6))
    out = []
    for frame, gTb in zip(data.measurements, data.truth.gTb, strict=True):
        rims, rows = frame.rims, frame.rims.craters
        slopes = ground_slopes(
            np.ascontiguousarray(gTb), data.camera.bTc, data.catalog.centres[rows], data.catalog.axes[rows]
        )
        root = share * slopes
        stated = replace(
            rims,
            chart=rims.chart + np.einsum("nij,nj->ni", slopes, errors[rows]),
            covariance=rims.covariance + root @ np.swapaxes(root, 1, 2),
            correlated=root,
        )
        out.append(replace(frame, rims=stated))
    return out


def test_stated_errors_of_the_map_are_no_errors_of_the_intrinsics(measured: Dataset) -> None:
    """They are the same in all frames, as of a lander that hovers, whose mean does not average them out."""
    assert measured.truth is not None
    row, count = 12, 60
    gTb = np.tile(measured.truth.gTb[row], (count, 1, 1))
    for seed in range(6):
        hovering = [with_errors_of_the_map(measured, 0.03, seed)[row]] * count
        assert not contradicted_intrinsics(hovering, gTb, measured.camera, measured.catalog)


def test_rims_out_of_sight_tell_nothing_of_the_intrinsics(measured: Dataset) -> None:
    """One is matched with a crater on the far side; poses that diverged see none of them."""
    assert measured.measurements is not None
    assert measured.truth is not None
    catalog, row = measured.catalog, int(measured.measurements[0].rims.craters[0])
    longitude_rad = catalog.longitude_rad.copy()
    longitude_rad[row] += np.pi
    far = replace(catalog, longitude_rad=longitude_rad)
    gTb = measured.truth.gTb
    assert not contradicted_intrinsics(measured.measurements, gTb, measured.camera, far)
    for factor in (-1.0, 0.5, 1e6):
        diverged = gTb.copy()
        diverged[:, :3, 3] *= factor
        assert not contradicted_intrinsics(measured.measurements, diverged, measured.camera, catalog)


def test_poses_that_do_not_see_the_rims_tell_nothing_of_the_intrinsics(measured: Dataset) -> None:
    """Those of a filter that has diverged: the system of normal equations was singular."""
    assert measured.truth is not None
    assert measured.measurements is not None
    antipodes = measured.truth.gTb.copy()
    antipodes[:, :3, 3] *= -1.0
    camera, catalog = measured.camera, measured.catalog
    assert not contradicted_intrinsics(measured.measurements, antipodes, camera, catalog)


def test_nothing_is_told_of_sound_data(few: tuple[Dataset, Dataset]) -> None:
    for data in few:
        assert reconstruct(data, ESTIMATORS).warnings == ()


@pytest.mark.slow
def test_nothing_is_told_of_long_sound_data(measured: Dataset, sensors: Path) -> None:
    for data in (measured, Dataset.open(sensors)):
        assert reconstruct(data, ESTIMATORS).warnings == ()


def test_rims_and_sun_are_left_out_like_any_sensor(few: tuple[Dataset, Dataset]) -> None:
    data = few[1]
    every = reconstruct(data, ["ekf"])
    less = reconstruct(data, ["ekf"], without=["rims", "sun"])
    assert not any(len(frame.rims) or frame.sun for frame in less.frames)
    assert every.innovations is not None
    assert less.innovations is not None
    assert {"rims", "sun"}.isdisjoint(less.innovations.sensor)
    assert "altimeter" in less.innovations.sensor
    covariances = [one.trajectories["ekf"].pose_covariance for one in (every, less)]
    assert covariances[0] is not None
    assert covariances[1] is not None
    assert np.trace(covariances[1][-1, 3:, 3:]) > 4.0 * np.trace(covariances[0][-1, 3:, 3:])
    with pytest.raises(EstimationError, match="without: the data set has no sensor 'moon'; it has altimeter"):
        reconstruct(data, ["ekf"], without=["moon"])
    with pytest.raises(EstimationError, match=r"without: .* the IMU; .*\[motion\]"):
        reconstruct(data, ["ekf"], without=["imu"])
    fewer = reconstruct(data, ["ekf"], without=["altimeter"])
    assert fewer.innovations is not None
    assert set(every.innovations.sensor) - set(fewer.innovations.sensor) == {"altimeter"}


@pytest.mark.parametrize("estimator", [pytest.param("online", marks=pytest.mark.slow), "ekf"])
def test_a_station_alone_is_not_to_be_trusted(sensors: Path, estimator: str) -> None:
    data = Dataset.open(sensors)
    others = ["rims", "sun", "altimeter", "velocimeter", "star_tracker"]
    result = reconstruct(data, [estimator], without=others)
    # Wrong by far more than it says: the range alone fits several trajectories.
    error = metrics(result.trajectories[estimator], data.truth)
    assert error.anees > 60.0
    assert result.warnings[0].startswith("no trajectory can be trusted, whatever its covariance: no rim was")
    assert "does not predict ranging (NIS per dimension" in result.warnings[0]
    assert any("there the trajectory rests on the IMU and ranging" in text for text in result.warnings)


def test_an_altimeter_that_is_mounted_upside_down_is_told(sensors: Path) -> None:
    """Its beam meets no ground: no sample contradicts the others, and none confirms them."""
    data = Dataset.open(sensors)
    turned = copy.copy(next(one for one in data.sensors if one.name == "altimeter"))
    turned.bTs = turned.bTs @ np.diag([1.0, -1.0, -1.0, 1.0])
    others = tuple(one for one in data.sensors if one.name != "altimeter")
    result = reconstruct(replace(data, sensors=(turned, *others)), ["ekf"])
    said = (
        "altimeter: 100 % of its samples cannot be from where ekf predicts the lander; check its units, T_BS"
    )
    assert any(text.startswith(said) for text in result.warnings), result.warnings
    assert result.innovations is not None
    assert np.isnan(result.innovations.of("altimeter").mean)


def test_sensors_from_a_good_start_need_no_rims(sensors: Path) -> None:
    data = Dataset.open(sensors)
    assert data.initial is not None
    assert data.truth is not None
    good = replace(
        data.initial, gTb=data.truth.gTb[0], position_sigma_m=50.0, attitude_sigma_rad=1e-3
    )  # fmt: skip
    result = reconstruct(replace(data, initial=good), ["ekf"], without=["rims", "sun"])
    assert metrics(result.trajectories["ekf"], data.truth).anees < 20.0
    assert not any("trust" in text for text in result.warnings), result.warnings


def rewritten(folder: Path, to: Path, name: str, change: Callable[[list[str]], list[str]]) -> Path:
    """Copy a data set, with the numbers of each row of a sensor's log changed."""
    shutil.copytree(folder, to)
    path = to / "mav0" / f"{name}0" / "data.csv"
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    changed = [",".join(change(row.split(","))) for row in rows]
    path.write_text("\n".join([head, *changed]) + "\n", encoding="utf-8")
    return path


def scaled(columns: slice) -> Callable[[list[str]], list[str]]:
    def change(row: list[str]) -> list[str]:
        row = list(row)
        row[columns] = [repr(1e-3 * float(value)) for value in row[columns]]
        return row

    return change


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("altimeter", scaled(slice(1, 2)), "range: expected m, found km"),
        ("velocimeter", scaled(slice(1, 5)), "speed_0: expected m/s, found km/s"),
        ("ranging", scaled(slice(1, 9)), "range: expected m and m/s, found km and km/s"),
        (
            "star_tracker",
            lambda row: [row[0], *row[2:], row[1]],
            "q_IS_w: expected the order w, x, y, z, found x, y, z, w (",
        ),
        (
            "star_tracker",
            lambda row: [*row[:2], *(repr(-float(value)) for value in row[2:])],
            "q_IS_w: expected the attitude of the sensor in the inertial frame, found the inverse (",
        ),
        (
            "star_tracker",
            lambda row: [row[0], *(repr(-float(value)) for value in row[2:]), row[1]],
            "found x, y, z, w, and the inverse of the attitude of the sensor in the inertial frame (",
        ),
    ],
    ids=["altimeter", "velocimeter", "ranging", "scalar last", "inverse", "inverse, scalar last"],
)
def test_a_log_in_a_wrong_unit_or_order_is_refused(
    sensors: Path, tmp_path: Path, name: str, change: Callable[[list[str]], list[str]], said: str
) -> None:
    path = rewritten(sensors, tmp_path / "data", name, change)
    data = Dataset.open(tmp_path / "data")
    with pytest.raises(InputError) as caught:
        reconstruct(data, ["dead_reckoning"])
    text = str(caught.value)
    assert str(path) in text
    assert said in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("gyro", "accelerometer", "said"),
    [
        (np.degrees(1.0), 1.0, "w_RS_S_x: expected rad/s, found deg/s"),
        (1.0, 1.0 / 9.80665, "a_RS_S_x: expected m/s^2, found g"),
        (np.degrees(1.0), 1.0 / 9.80665, "w_RS_S_x: expected rad/s and m/s^2, found deg/s and g"),
    ],
)
def test_an_imu_in_another_unit_is_refused(
    measured: Dataset, sensors: Path, gyro: float, accelerometer: float, said: str
) -> None:
    for data in (measured, Dataset.open(sensors)):
        assert data.imu is not None
        imu = replace(
            data.imu,
            gyro_rad_s=gyro * data.imu.gyro_rad_s,
            accelerometer_m_s2=accelerometer * data.imu.accelerometer_m_s2,
        )
        with pytest.raises(InputError) as caught:
            reconstruct(replace(data, imu=imu), ["dead_reckoning"])
        assert f"mav0/imu0/data.csv: {said} (the other sensors confirm it)" in str(caught.value)


@pytest.mark.parametrize(
    ("gyro", "accelerometer", "said"),
    [
        (
            np.diag([1, -1, -1]),
            np.diag([1, -1, -1]),
            "w_RS_S_x: {} x, -y, -z of the log, or the camera's T_BS",
        ),
        (np.eye(3)[[1, 2, 0]], np.eye(3), "w_RS_S_x: {} z, x, y of the gyro"),
        (np.eye(3), -np.eye(3), "a_RS_S_x: {} -x, -y, -z of the accelerometer"),
    ],
)
def test_an_imu_along_other_axes_is_refused(
    few: tuple[Dataset, Dataset], gyro: np.ndarray, accelerometer: np.ndarray, said: str
) -> None:
    """The smoother was 8 km off and warned of units, axes, matches, attitude, longitudes and the lens."""
    # Only the longer descent shows its forces.
    data = few["accelerometer" in said]
    assert data.imu is not None
    imu = replace(
        data.imu,
        gyro_rad_s=data.imu.gyro_rad_s @ gyro.T,
        accelerometer_m_s2=data.imu.accelerometer_m_s2 @ accelerometer.T,
    )
    text = said.format("expected the axes x, y, z of b, found them as")
    with pytest.raises(InputError, match=f"imu0/data.csv: {text}.* \\(the other sensors confirm it\\)"):
        reconstruct(replace(data, imu=imu), ["dead_reckoning"])


def test_accelerations_without_gravity_are_refused(few: tuple[Dataset, Dataset]) -> None:
    data = few[1]
    assert data.imu is not None
    assert data.truth is not None
    inside = data.imu.stamps_ns.clip(data.truth.stamps_ns[0], data.truth.stamps_ns[-1])
    gTb = data.truth_at(inside).gTb
    gravity = np.einsum("nji,nj->ni", gTb[:, :3, :3], data.body.gravity(gTb[:, :3, 3]))
    imu = replace(data.imu, accelerometer_m_s2=data.imu.accelerometer_m_s2 + gravity)
    with pytest.raises(InputError, match="a_RS_S_x: expected specific force, found acceleration, from which"):
        reconstruct(replace(data, imu=imu), ["dead_reckoning"])


@pytest.mark.parametrize("said", ["found its inverse", "turned by 180 deg", "found those of the camera"])
def test_a_mounting_that_is_wrong_turns_the_log_back(said: str) -> None:
    stated = frames.rotation_exp(np.array([0.3, -1.2, 0.4]))
    true = {
        "found its inverse": stated.T,
        "turned by 180 deg": stated @ np.diag([-1.0, -1.0, 1.0]),
        "found those of the camera": stated,
    }[said]
    log = np.array([0.1, -0.2, 0.3])
    # In b as the stated mounting turns it against the camera, which is what the images show.
    shown = stated @ true.T @ log
    if true is stated:
        log, shown = stated.T @ log, log
    agree = [one for one in axes(stated) if np.allclose(one.gyro @ log, shown)]
    assert any(said in one.problem for one in agree)
    assert all((one.gyro == one.accelerometer).all() for one in agree)


def accelerometer_offset(data: Dataset) -> Dataset:
    assert data.imu is not None
    return replace(data, imu=replace(data.imu, accelerometer_m_s2=data.imu.accelerometer_m_s2 + 500.0))


def far_side(data: Dataset) -> Dataset:
    assert data.initial is not None
    gTb = data.initial.gTb.copy()
    gTb[:3, 3] *= -1.0
    return replace(data, initial=replace(data.initial, gTb=gTb))


def far_off_rims(data: Dataset) -> Dataset:
    return with_frames(data, lambda frame: moved_rims(frame, 0.3))


@pytest.mark.parametrize("of", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("mistake", [accelerometer_offset, far_side, far_off_rims])
def test_another_mistake_is_no_unit_of_the_imu(
    mistake: Callable[[Dataset], Dataset], few: tuple[Dataset, Dataset], of: int
) -> None:
    """In another unit, predictions fly away; where they see no rim, the sun's tilt alone agrees with them."""
    assert reconstruct(mistake(few[of]), ["ekf"]).warnings


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("altimeter", lambda row: [*row, "1"], "expected 2 columns"),
        ("altimeter", lambda row: [row[0], "-3"], "range: expected 0 to"),
        ("altimeter", lambda row: [str(int(row[0]) + 10**12), row[1]], "expected a stamp within the descent"),
        ("star_tracker", lambda row: [row[0], "0.5", *row[2:]], "expected a unit quaternion"),
        ("velocimeter", lambda row: [row[0], "2e4", *row[2:]], "speed_0: expected at most 10000 m/s"),
        ("velocimeter", lambda row: [row[0], "fast", *row[2:]], "speed_0"),
    ],
)
def test_a_log_that_cannot_be_is_refused_with_its_line(
    sensors: Path, tmp_path: Path, name: str, change: Callable[[list[str]], list[str]], said: str
) -> None:
    path = rewritten(sensors, tmp_path / "data", name, change)
    with pytest.raises(InputError) as caught:
        Dataset.open(tmp_path / "data")
    assert str(caught.value).startswith(f"{path}:2")
    assert said in str(caught.value)
