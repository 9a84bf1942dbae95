"""A world as a data set on disk, written from the description of the format."""

from pathlib import Path

import cv2
import numpy as np

from factors.arrays import FloatArray
from tests.foreign import motion as m
from tests.foreign.ground import MOON_RADIUS_M
from tests.foreign.worlds import World

_ATTITUDE_SIGMA_RAD, _POSITION_SIGMA_M, _VELOCITY_SIGMA_M_S = 0.01, 60.0, 1.0
_RATE_HZ = 50.0


def write(world: World, folder: Path, seed: int, psf_px: float | None = None, heights: bool = True) -> Path:
    """Write the data set; `psf_px` is what the file says of the point-spread function, the truth if None."""
    rng = np.random.default_rng([seed, 99])
    camera, imu = folder / "mav0" / "cam0", folder / "mav0" / "imu0"
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    for one in (camera / "data", imu, truth):
        one.mkdir(parents=True)
    stamps = np.rint(1e9 * world.times_s).astype(np.int64)
    for stamp, image in zip(stamps, world.images, strict=True):
        cv2.imwrite(str(camera / "data" / f"{stamp}.png"), image)
    _table(camera / "data.csv", "#timestamp [ns],filename", [[s, f"{s}.png"] for s in stamps])
    o = world.optics
    middle = 0.5 * (o.side_px - 1)
    bTc = np.eye(4)
    bTc[:3, :3] = m.BODY_CAMERA
    (camera / "sensor.yaml").write_text(
        f"sensor_type: camera\n{_mounting(bTc)}rate_hz: 0.25\nresolution: [{o.side_px}, {o.side_px}]\n"
        f"camera_model: pinhole\nintrinsics: [{o.focal_px}, {o.focal_px}, {middle}, {middle}]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        f"psf_sigma_px: {o.psf_px if psf_px is None else psf_px}\n"
    )
    ends, samples, biases = m.imu_log(rng, world.motion, _RATE_HZ)
    _table(
        imu / "data.csv",
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
        [[round(1e9 * t), *row] for t, row in zip(ends, samples, strict=True)],
    )
    (imu / "sensor.yaml").write_text(
        f"sensor_type: imu\n{_mounting(np.eye(4))}rate_hz: {_RATE_HZ}\n"
        f"gyroscope_noise_density: {m.GYRO_NOISE}\ngyroscope_random_walk: {m.GYRO_WALK}\n"
        f"accelerometer_noise_density: {m.ACCEL_NOISE}\naccelerometer_random_walk: {m.ACCEL_WALK}\n"
    )
    states = []
    for stamp, t in zip(stamps, world.times_s, strict=True):
        gTb = world.motion.gTb(t)
        gV = world.motion.site.turn @ world.motion.velocity(t)
        bias = biases[min(round(t * _RATE_HZ), len(biases) - 1)]
        states.append([stamp, *gTb[:3, 3], *_quaternion(gTb[:3, :3]), *gV, *bias])
    _table(
        truth / "data.csv",
        "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
        "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],"
        "b_w_RS_S_z [rad s^-1],b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]",
        states,
    )
    sun_g = world.motion.site.turn @ world.sun
    _table(folder / "sun.csv", "timestamp [ns],s_x,s_y,s_z", [[0, *sun_g]])
    _catalog(world, folder / "craters.csv", heights)
    _description(world, folder / "dataset.toml", rng)
    return folder


def _catalog(world: World, path: Path, heights: bool) -> None:
    craters, site = world.ground.craters, world.motion.site
    rows = []
    for k, crest in enumerate(craters.crests):
        g = site.origin + crest @ site.turn.T
        height = float(np.mean(np.linalg.norm(g, axis=-1))) - MOON_RADIUS_M
        x, y = craters.centres[k]
        up = site.origin + site.turn @ np.array([x, y, 0.0])
        up /= np.linalg.norm(up)
        angle = craters.angles[k]
        along = site.turn @ np.array([np.cos(angle), np.sin(angle), 0.0])
        east = np.cross([0.0, 0.0, 1.0], up)
        east /= np.linalg.norm(east)
        turned = np.arctan2(along @ np.cross(up, east), along @ east)
        a, b = craters.semi_axes[k]
        rows.append(
            [f"F{k:04d}", np.degrees(np.arcsin(up[2])), np.degrees(np.arctan2(up[1], up[0])) % 360.0,
             2e-3 * a, 2e-3 * b, np.degrees(turned) % 180.0, *([height] if heights else [])]
        )  # fmt: skip
    head = "CRATER_ID,LAT_ELLI_IMG,LON_ELLI_IMG,DIAM_ELLI_MAJOR_IMG,DIAM_ELLI_MINOR_IMG,DIAM_ELLI_ANGLE_IMG"
    _table(path, head + (",RIM_HEIGHT_M" if heights else ""), rows)


def _description(world: World, path: Path, rng: np.random.Generator) -> None:
    gTb = world.motion.gTb(0.0)
    off = rng.standard_normal(9)
    turn = _rotation(_ATTITUDE_SIGMA_RAD * off[:3])
    position = gTb[:3, 3] + _POSITION_SIGMA_M * off[3:6]
    gV = world.motion.site.turn @ world.motion.velocity(0.0) + _VELOCITY_SIGMA_M_S * off[6:]
    path.write_text(
        "format_version = 1\n\n[body]\n"
        f'name = "Moon"\nradius_m = {MOON_RADIUS_M}\nmu_m3_s2 = {m.MU_M3_S2}\n'
        f"spin_rad_s = {m.SPIN_RAD_S.tolist()}\n\n[initial]\nstamp_ns = 0\n"
        f"position_m = {position.tolist()}\nattitude_wxyz = {_quaternion(gTb[:3, :3] @ turn)}\n"
        f"velocity_m_s = {gV.tolist()}\nattitude_sigma_rad = {_ATTITUDE_SIGMA_RAD}\n"
        f"position_sigma_m = {_POSITION_SIGMA_M}\nvelocity_sigma_m_s = {_VELOCITY_SIGMA_M_S}\n"
        f"angular_velocity_sigma_rad_s = 0.01\ngyro_bias_sigma_rad_s = {m.GYRO_BIAS_SIGMA}\n"
        f"accelerometer_bias_sigma_m_s2 = {m.ACCEL_BIAS_SIGMA}\n"
    )


def _table(path: Path, head: str, rows: list[list[object]]) -> None:
    lines = [",".join(repr(float(v)) if isinstance(v, float) else str(v) for v in row) for row in rows]
    path.write_text("\n".join([head, *lines]) + "\n")


def _mounting(T: FloatArray) -> str:
    return f"T_BS:\n  rows: 4\n  cols: 4\n  data: {[float(v) for v in T.ravel()]}\n"


def _quaternion(R: FloatArray) -> list[float]:
    """Quaternion w, x, y, z of a rotation, from the eigenvector of its symmetric matrix."""
    K = np.array([
        [R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] - R[1, 2]],
        [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
        [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
    ])  # fmt: skip
    x, y, z, w = np.linalg.eigh(K / 3.0)[1][:, -1]
    return [float(v) for v in (w, x, y, z)]


def _rotation(vector: FloatArray) -> FloatArray:
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)
