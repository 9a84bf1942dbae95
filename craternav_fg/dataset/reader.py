"""Opening a data set: every file is checked before anything is estimated."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import read_catalog
from craternav_fg.catalogs.ground import ground_heights
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.description import read_description
from craternav_fg.dataset.images import ImageArray, check_image, read_image
from craternav_fg.dataset.measurements import read_measurements
from craternav_fg.dataset.sensor_files import read_camera, read_imu_noise
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.files import folder_of, read_sensor
from craternav_fg.sensors.point_features import FeatureTracks, read_features
from craternav_fg.sensors.protocol import Sensor, Surroundings
from craternav_fg.sensors.registry import sensors
from craternav_fg.tables import Table, read_table
from craternav_fg.trajectory import InitialState, Trajectory

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LARGEST_GAP_S = 0.1
# No lander turns or accelerates so fast: a wrong unit, or a broken row.
LARGEST_RATE_RAD_S = 50.0
LARGEST_FORCE_M_S2 = 1000.0


@dataclass(frozen=True)
class Dataset:
    """A descent as it was recorded or simulated.

    Attributes
    ----------
    path : Path
        Its folder.
    body : Body
    camera : Camera
    catalog : Catalog
    imu : ImuLog
    imu_noise : ImuNoise
    initial : InitialState or None
        At the first frame's stamp; None when nothing is known: the images must tell.
    sun : SunVectors
        `sun.at(stamp_ns)` is the unit vector towards the sun in g.
    stamps_ns : ndarray of int, shape (k,)
        Of the frames, strictly increasing.
    image_paths : tuple of Path, length k
        Of the frames' images; they need not exist when there are `measurements`.
    truth : Trajectory or None
        At the frames' stamps, interpolated where the file has others; for evaluation only.
    measurements : tuple of FrameMeasurement, length k, or None
        Measured rims and sun tilts; None when they are to be found in the images.
    sensors : tuple of Sensor
        Logs of the sensors beside camera and IMU.
    ignored : tuple of str
        Folders below `mav0` that no sensor known here reads.
    features : FeatureTracks or None
        Points tracked from frame to frame.
    """

    path: Path
    body: Body
    camera: Camera
    catalog: Catalog
    imu: ImuLog
    imu_noise: ImuNoise
    initial: InitialState | None
    sun: SunVectors
    stamps_ns: IntArray
    image_paths: tuple[Path, ...]
    truth: Trajectory | None
    measurements: tuple[FrameMeasurement, ...] | None
    sensors: tuple[Sensor, ...] = ()
    ignored: tuple[str, ...] = ()
    features: FeatureTracks | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @classmethod
    def open(cls, path: Path | str) -> "Dataset":
        """Read and check a data set; the images are checked, not read.

        Parameters
        ----------
        path : Path or str
            Folder with `dataset.toml`; its files are listed in `craternav_fg.dataset.layout`.

        Raises
        ------
        InputError
            For the first thing that is wrong: names file, line or column.
        """
        folder = Path(path)
        if not folder.is_dir():
            raise InputError(folder, "expected a data set's folder")
        body, initial = read_description(folder / layout.DESCRIPTION)
        camera = read_camera(folder / layout.CAMERA_SENSOR)
        imu_noise = read_imu_noise(folder / layout.IMU_SENSOR)
        catalog = read_catalog(_catalog_path(folder), body)
        stamps, names = _read_frames(folder / layout.CAMERA_DATA)
        if initial is not None and initial.stamp_ns != stamps[0]:
            raise InputError(
                folder / layout.DESCRIPTION,
                f"expected the first frame's stamp {stamps[0]}, found {initial.stamp_ns}",
                column="initial.stamp_ns",
            )
        sun = _read_sun(folder / layout.SUN, stamps)
        imu = _read_imu(folder / layout.IMU_DATA, stamps)
        truth = _read_truth(folder / layout.TRUTH, stamps)
        measurements = None
        image_paths = tuple(folder / layout.IMAGES / name for name in names)
        if (folder / layout.RIMS).exists():
            prior_gP = None if initial is None else initial.gTb[:3, 3]
            measurements = read_measurements(folder, stamps, catalog, sun, prior_gP)
        else:
            for image_path in image_paths:
                check_image(image_path, camera.width_px, camera.height_px, camera.bit_depth)
        return cls(
            folder,
            body,
            camera,
            catalog,
            imu,
            imu_noise,
            initial,
            sun,
            stamps,
            image_paths,
            truth,
            measurements,
            *_read_sensors(folder, catalog, int(stamps[0]), int(stamps[-1])),
            read_features(folder, camera, stamps),
        )

    def truth_at(self, stamps_ns: IntArray) -> Trajectory | None:
        """Read the truth at given stamps, interpolated where the file has others; None without a truth.

        Parameters
        ----------
        stamps_ns : ndarray of int, shape (n,)
            Within the descent, ns.

        Returns
        -------
        Trajectory or None

        Raises
        ------
        InputError
            When the file is wrong or does not reach so far.
        """
        return _read_truth(self.path / layout.TRUTH, stamps_ns)

    def image(self, frame: int) -> ImageArray:
        """Read a frame's image, shape (height, width): grey levels from 0 to `camera.full_scale`.

        Raises
        ------
        InputError
            When it is missing or damaged.
        """
        camera = self.camera
        return read_image(self.image_paths[frame], camera.width_px, camera.height_px, camera.bit_depth)


def _read_sensors(
    folder: Path, catalog: Catalog, begin_ns: int, end_ns: int
) -> tuple[tuple[Sensor, ...], tuple[str, ...]]:
    """Give the logs of the sensors that are there, and the folders that none of them reads."""
    kinds = {Path(folder_of(name)).name: kind for name, kind in sensors().items()}
    found: list[Sensor] = []
    ignored: list[str] = []
    surroundings = Surroundings(catalog.body, ground_heights(catalog))
    for here in sorted(path for path in (folder / layout.SENSORS).iterdir() if path.is_dir()):
        if here.name in kinds:
            found.append(read_sensor(folder, kinds[here.name], surroundings, begin_ns, end_ns))
        elif here.name not in layout.OWN_SENSORS:
            ignored.append(here.name)
    return tuple(found), tuple(ignored)


def _catalog_path(folder: Path) -> Path:
    small, large = folder / layout.CRATERS, folder / layout.LARGE_CRATERS
    if small.is_file() and large.is_file():
        raise InputError(large, f"expected either this catalogue or {layout.CRATERS}, found both")
    return large if large.is_file() else small


def _read_frames(path: Path) -> tuple[IntArray, list[str]]:
    table = read_table(path, layout.CAMERA_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one frame, found none")
    table.require_increasing(layout.STAMP)
    names: list[str] = table.columns["filename"]
    for row, name in enumerate(names):
        if Path(name).name != name:
            table.fail(row, "filename", f"expected a name without folders, found {name!r}")
    return table.columns[layout.STAMP], names


def _read_imu(path: Path, frames_ns: IntArray) -> ImuLog:
    table = read_table(path, layout.IMU_COLUMNS)
    if len(table) < 2:
        raise InputError(path, f"expected at least two rows, found {len(table)}")
    table.require_increasing(layout.STAMP)
    stamps: IntArray = table.columns[layout.STAMP]
    gap_s = np.diff(stamps) * 1e-9
    first = int(stamps[0] - (stamps[1] - stamps[0]))
    # Checked before the gaps: a first step that is too long would also shift the beginning.
    long = np.flatnonzero(gap_s > LARGEST_GAP_S)
    if len(long):
        row = int(long[0])
        table.fail(
            row + 1,
            layout.STAMP,
            f"expected steps of at most {LARGEST_GAP_S} s, found a gap of {gap_s[row]:.3f} s"
            f" from {stamps[row]} to {stamps[row + 1]}",
        )
    if first > frames_ns[0] or stamps[-1] < frames_ns[-1]:
        raise InputError(
            path,
            f"expected a log over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {first} to {stamps[-1]} ns",
        )
    for names, limit, unit in (
        (layout.GYRO, LARGEST_RATE_RAD_S, "rad/s"),
        (layout.ACCELEROMETER, LARGEST_FORCE_M_S2, "m/s^2"),
    ):
        for name in names:
            far = np.flatnonzero(np.abs(table.columns[name]) > limit)
            if len(far):
                row = int(far[0])
                found = table.columns[name][row]
                table.fail(row, name, f"expected at most {limit:g} {unit} in size, found {found:g}")
    return ImuLog(stamps, table.numbers(*layout.GYRO), table.numbers(*layout.ACCELEROMETER))


def _read_sun(path: Path, frames_ns: IntArray) -> SunVectors:
    table = read_table(path, layout.SUN_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one vector, found none")
    table.require_increasing(layout.STAMP)
    vectors = table.numbers(*layout.SUN_VECTOR)
    _require_unit(table, vectors, layout.SUN_VECTOR, "vector")
    stamps: IntArray = table.columns[layout.STAMP]
    if len(stamps) > 1 and (stamps[0] > frames_ns[0] or stamps[-1] < frames_ns[-1]):
        raise InputError(
            path,
            f"expected one row, or rows over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {stamps[0]} to {stamps[-1]} ns",
        )
    return SunVectors(stamps, vectors)


def _read_truth(path: Path, frames_ns: IntArray) -> Trajectory | None:
    if not path.exists():
        return None
    table = read_table(path, layout.TRUTH_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one row, found none")
    table.require_increasing(layout.STAMP)
    stamps: IntArray = table.columns[layout.STAMP]
    if stamps[0] > frames_ns[0] or stamps[-1] < frames_ns[-1]:
        raise InputError(
            path,
            f"expected states over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {stamps[0]} to {stamps[-1]} ns",
        )
    q = table.numbers(*layout.ATTITUDE)
    _require_unit(table, q, layout.ATTITUDE, "quaternion")
    rotation = Rotation.from_quat(q, scalar_first=True)
    P, V, bias = (table.numbers(*names) for names in (layout.POSITION, layout.VELOCITY, layout.BIAS))
    gTb = np.tile(np.eye(4), (len(frames_ns), 1, 1))
    if np.isin(frames_ns, stamps).all():
        rows = np.searchsorted(stamps, frames_ns)
        gTb[:, :3, :3], gTb[:, :3, 3] = rotation.as_matrix()[rows], P[rows]
        return Trajectory(frames_ns, gTb, V[rows], bias[rows])
    t, at = (stamps - stamps[0]) * 1e-9, (frames_ns - stamps[0]) * 1e-9
    position = CubicHermiteSpline(t, P, V)
    gTb[:, :3, :3], gTb[:, :3, 3] = Slerp(t, rotation)(at).as_matrix(), position(at)
    biases = np.stack([np.interp(at, t, column) for column in bias.T], axis=-1)
    return Trajectory(frames_ns, gTb, position(at, 1), biases)


def _require_unit(table: Table, vectors: FloatArray, names: tuple[str, ...], what: str) -> None:
    norms = np.linalg.norm(vectors, axis=1)
    bad = np.flatnonzero(np.abs(norms - 1.0) > 1e-6)
    if len(bad):
        row = int(bad[0])
        table.fail(row, ",".join(names), f"expected a unit {what}, its length is {norms[row]:.9g}")
