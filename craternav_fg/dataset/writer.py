"""Writing of a data set, whole or not at all."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from craternav_fg import frames
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.apriori import sigmas_yaml
from craternav_fg.dataset.description import description_toml
from craternav_fg.dataset.images import ImageArray, write_image
from craternav_fg.dataset.measurements import write_measurements
from craternav_fg.dataset.reader import Dataset
from craternav_fg.dataset.recording import Recording
from craternav_fg.dataset.sensor_files import camera_yaml, imu_yaml, intrinsics_problem
from craternav_fg.errors import InputError
from craternav_fg.files import replacing_folder
from craternav_fg.motion.gravity import gravity_text
from craternav_fg.sensors.files import write_sensor
from craternav_fg.sensors.point_features import write_features
from craternav_fg.tables import write_table
from craternav_fg.trajectory import Trajectory
from factors.arrays import IntArray

# Catalogues with more craters than this are written as Parquet: a CSV table of them takes seconds to read.
_MAX_CSV_CRATERS = 100_000


def write_dataset(
    folder: Path,
    recording: Recording,
    images: Iterable[ImageArray] | None = None,
    names: Sequence[str] | None = None,
    *,
    verified: bool = False,
) -> Path:
    """Write a data set that `Dataset.open` reads; numbers read back exactly.

    Parameters
    ----------
    folder : Path
        Replaced when it is empty or a data set.
    recording : Recording
        Its `measurements` take the place of images.
    images : iterable of ndarray of uint8 or, above 8 bits, uint16, shape (height, width), optional
        Images of the frames, read one at a time.
    names : sequence of str, optional
        Names of their files, which end in .png; the stamps by default.
    verified : bool
        Whether `Dataset.open` must accept what was written before it takes its name: for recordings whose
        values nobody has checked.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        When the folder holds something else, or cannot be written, or the intrinsics do not fit the images;
        as `Dataset.open`, if that is asked for.
    ValueError
        When there are neither images nor measurements, or both, or not one for each stamp.
    """
    if (images is None) == (recording.measurements is None):
        raise ValueError("give either images or measurements")
    camera, stamps = recording.camera, recording.stamps_ns
    intrinsics = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    if wrong := intrinsics_problem(camera.width_px, camera.height_px, intrinsics):
        raise InputError(folder / layout.CAMERA_SENSOR, wrong, column="intrinsics")
    with replacing_folder(folder, marker=layout.DESCRIPTION, ours=layout.CONTENTS) as temporary:
        for name in (layout.IMAGES, *([] if recording.imu is None else [layout.IMU_DATA])):
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
        if recording.measurements is not None:
            if len(recording.measurements) != len(stamps):
                raise ValueError(f"{len(recording.measurements)} measurements for {len(stamps)} stamps")
            write_measurements(temporary, recording.measurements, recording.catalog)
        names = [f"{stamp}.png" for stamp in stamps] if names is None else list(names)
        if images is not None:
            (temporary / layout.IMAGES).mkdir()
            for name, image in zip(names, images, strict=True):
                write_image(temporary / layout.IMAGES / name, image)
        write_table(temporary / layout.CAMERA_DATA, layout.CAMERA_COLUMNS, [stamps, names], comment=True)
        (temporary / layout.CAMERA_SENSOR).write_text(camera_yaml(camera, _rate_hz(stamps)))
        large = len(recording.catalog) > _MAX_CSV_CRATERS
        write_catalog(temporary / (layout.LARGE_CRATERS if large else layout.CRATERS), recording.catalog)
        _write_logs(temporary, recording)
        if recording.truth is not None:
            _write_states(temporary / layout.TRUTH, recording.truth)
        if recording.apriori is not None:
            _write_states(temporary / layout.APRIORI, recording.apriori.states)
            (temporary / layout.APRIORI_SENSOR).write_text(sigmas_yaml(recording.apriori))
        description = description_toml(recording.body, recording.initial, recording.motion)
        (temporary / layout.DESCRIPTION).write_text(description, encoding="utf-8")
        if verified:
            _verify(temporary, folder)
    return folder


def _verify(temporary: Path, folder: Path) -> None:
    """Open a data set; errors name its files as those of the folder that it is to become."""
    try:
        Dataset.open(temporary)
    except InputError as error:
        if not error.path.is_relative_to(temporary):
            raise
        path = folder / error.path.relative_to(temporary)
        raise InputError(path, error.problem, line=error.line, column=error.column) from error


def _write_logs(folder: Path, recording: Recording) -> None:
    """Write IMU, sun and further sensors."""
    imu, noise, sun, motion = recording.imu, recording.imu_noise, recording.sun, recording.motion
    if imu is not None and noise is not None:
        (folder / layout.IMU_SENSOR).write_text(imu_yaml(noise, _rate_hz(imu.stamps_ns)))
        rows = [imu.stamps_ns, *imu.gyro_rad_s.T, *imu.accelerometer_m_s2.T]
        write_table(folder / layout.IMU_DATA, layout.IMU_COLUMNS, rows, comment=True)
    if motion is not None and len(motion.gravity.C) > 1:
        text = gravity_text(motion.gravity, recording.body.mu_m3_s2)
        (folder / layout.GRAVITY).write_text(text, encoding="ascii")
    write_table(folder / layout.SUN, layout.SUN_COLUMNS, [sun.stamps_ns, *sun.vectors.T], comment=True)
    for sensor in recording.sensors:
        write_sensor(folder, sensor)
    if recording.features is not None:
        write_features(folder, recording.features)


def _write_states(path: Path, states: Trajectory) -> None:
    path.parent.mkdir()
    q = frames.to_quaternion_wxyz(states.gRb)
    rows = [states.stamps_ns, *states.gP.T, *q.T, *states.gV.T, *states.bias.T]
    write_table(path, layout.TRUTH_COLUMNS, rows, comment=True)


def _rate_hz(stamps_ns: IntArray) -> float:
    """Nominal rate, for the reader of the file: only the stamps are used."""
    return float(1e9 / np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 1.0
