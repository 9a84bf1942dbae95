"""Writing a data set, whole or not at all."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.description import description_toml
from craternav_fg.dataset.images import ImageArray, write_image
from craternav_fg.dataset.measurements import write_measurements
from craternav_fg.dataset.sensor_files import camera_yaml, imu_yaml
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.files import replacing_folder
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.files import write_sensor
from craternav_fg.sensors.point_features import FeatureTracks, write_features
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.tables import write_table
from craternav_fg.trajectory import InitialState, Trajectory

IntArray = npt.NDArray[np.int64]

# Catalogues with more craters are written as Parquet: a table of them takes seconds to read.
_LARGE = 100_000


def write_dataset(
    folder: Path,
    *,
    body: Body,
    camera: Camera,
    catalog: Catalog,
    imu: ImuLog,
    imu_noise: ImuNoise,
    initial: InitialState | None,
    sun: SunVectors,
    stamps_ns: IntArray,
    images: Iterable[ImageArray] | None = None,
    measurements: Sequence[FrameMeasurement] | None = None,
    sensors: Sequence[Sensor] = (),
    features: FeatureTracks | None = None,
    truth: Trajectory | None = None,
) -> Path:
    """Write a data set that `Dataset.open` reads; numbers read back exactly.

    Parameters
    ----------
    folder : Path
        Replaced when it is empty or a data set.
    body, camera, catalog, imu, imu_noise, initial, sun
        As in `Dataset`.
    stamps_ns : ndarray of int, shape (k,)
        Of the frames.
    images : iterable of ndarray of uint8 or, above 8 bits, uint16, shape (height, width), optional
        One per frame, taken one at a time.
    measurements : sequence of FrameMeasurement, length k, optional
        Given in place of images.
    sensors : sequence of Sensor
        Logs of further sensors.
    features : FeatureTracks, optional
    truth : Trajectory, optional

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        When the folder holds something else.
    ValueError
        When neither or both of images and measurements are given, or their number is not that of the stamps.
    """
    if (images is None) == (measurements is None):
        raise ValueError("give either images or measurements")
    with replacing_folder(folder, marker=layout.DESCRIPTION, ours=layout.CONTENTS) as temporary:
        for name in (layout.IMAGES, layout.IMU_DATA):
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
        names = [f"{stamp}.png" for stamp in stamps_ns]
        if measurements is not None:
            if len(measurements) != len(stamps_ns):
                raise ValueError(f"{len(measurements)} measurements for {len(stamps_ns)} stamps")
            write_measurements(temporary, measurements, catalog)
        if images is not None:
            (temporary / layout.IMAGES).mkdir()
            for name, image in zip(names, images, strict=True):
                write_image(temporary / layout.IMAGES / name, image)
        large = len(catalog) > _LARGE
        write_catalog(temporary / (layout.LARGE_CRATERS if large else layout.CRATERS), catalog)
        write_table(temporary / layout.SUN, layout.SUN_COLUMNS, [sun.stamps_ns, *sun.vectors.T], comment=True)
        (temporary / layout.CAMERA_SENSOR).write_text(camera_yaml(camera, _rate_hz(stamps_ns)))
        (temporary / layout.IMU_SENSOR).write_text(imu_yaml(imu_noise, _rate_hz(imu.stamps_ns)))
        write_table(temporary / layout.CAMERA_DATA, layout.CAMERA_COLUMNS, [stamps_ns, names], comment=True)
        write_table(
            temporary / layout.IMU_DATA,
            layout.IMU_COLUMNS,
            [imu.stamps_ns, *imu.gyro.T, *imu.accelerometer.T],
            comment=True,
        )
        for sensor in sensors:
            write_sensor(temporary, sensor)
        if features is not None:
            write_features(temporary, features)
        if truth is not None:
            (temporary / layout.TRUTH).parent.mkdir()
            q = frames.to_quaternion_wxyz(truth.gRb)
            write_table(
                temporary / layout.TRUTH,
                layout.TRUTH_COLUMNS,
                [truth.stamps_ns, *truth.gP.T, *q.T, *truth.gV.T, *truth.bias.T],
                comment=True,
            )
        (temporary / layout.DESCRIPTION).write_text(description_toml(body, initial), encoding="utf-8")
    return folder


def _rate_hz(stamps_ns: IntArray) -> float:
    """Nominal rate, for people: the stamps count."""
    return float(1e9 / np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 1.0
