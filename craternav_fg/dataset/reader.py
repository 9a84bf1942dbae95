"""Reading of a data set: every file is checked before anything is estimated."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs.duplicates import repeated_craters
from craternav_fg.catalogs.files import read_catalog
from craternav_fg.catalogs.ground import ground_heights
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.apriori import AprioriStates, read_sigmas
from craternav_fg.dataset.description import read_description, read_motion
from craternav_fg.dataset.images import ImageArray, check_image, read_image
from craternav_fg.dataset.measurements import read_measurements
from craternav_fg.dataset.recording import Recording
from craternav_fg.dataset.sensor_files import read_camera, read_imu_noise, read_imu_rate_hz
from craternav_fg.dataset.states import read_states, require_unit
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import InputError
from craternav_fg.files import entries, exists
from craternav_fg.imu import ImuLog
from craternav_fg.motion.prior import with_motion_prior
from craternav_fg.sensors.files import folder_of, read_sensor
from craternav_fg.sensors.point_features import read_features
from craternav_fg.sensors.protocol import Sensor, Surroundings
from craternav_fg.sensors.registry import sensors
from craternav_fg.tables import read_table
from craternav_fg.trajectory import Trajectory
from factors.arrays import IntArray

# Longest step of an IMU log: attitude and velocity are integrated with constant rates over a step.
MAX_IMU_STEP_S = 0.1
# No lander turns or accelerates so fast; such values have a wrong unit or come from a broken row.
MAX_RATE_RAD_S = 50.0
MAX_SPECIFIC_FORCE_M_S2 = 1000.0
# Largest ratio of an IMU's rate to the nominal one.
_MAX_RATE_RATIO = 30.0


@dataclass(frozen=True, kw_only=True)
class Dataset(Recording):
    """A recording on disk. Its `truth` is given at the frames' stamps, interpolated if necessary.

    Attributes
    ----------
    path : Path
        Its folder.
    image_paths : tuple of Path, length k
        Paths of the frames' images; they need not exist when there are `measurements`.
    ignored : tuple of str
        Folders below `mav0` that belong to no known sensor.
    in_colour : int
        Number of colour images; their luma is used.
    repeated_craters : tuple of str
        Names of craters that the catalogue has already under another one. They are left out where rims are
        to be measured in images.
    """

    path: Path
    image_paths: tuple[Path, ...]
    ignored: tuple[str, ...] = ()
    in_colour: int = 0
    repeated_craters: tuple[str, ...] = ()

    @classmethod
    def open(cls, path: Path | str) -> "Dataset":
        """Read and check a data set. Images are checked by their first and last bytes, but not decoded.

        Parameters
        ----------
        path : Path or str
            Folder with `dataset.toml`; `craternav_fg.dataset.layout` describes its files.

        Returns
        -------
        Dataset

        Raises
        ------
        InputError
            For the first fault: names file, line or column.
        """
        folder = Path(path)
        if not folder.is_dir():
            raise InputError(
                folder, "expected a data set's folder" if folder.exists() else "folder is missing"
            )
        body, initial = read_description(folder / layout.DESCRIPTION)
        camera = read_camera(folder / layout.CAMERA_SENSOR)
        motion = read_motion(folder / layout.DESCRIPTION)
        has_imu = _has_imu(folder, motion is not None)
        imu_noise = read_imu_noise(folder / layout.IMU_SENSOR) if has_imu else None
        catalog = read_catalog(_catalog_path(folder), body)
        are_measured = exists(folder / layout.RIMS)
        stamps, names = _read_frames(folder / layout.CAMERA_DATA, are_images=not are_measured)
        if initial is not None and initial.stamp_ns != stamps[0]:
            raise InputError(
                folder / layout.DESCRIPTION,
                f"expected the first frame's stamp {stamps[0]}, found {initial.stamp_ns}",
                column="initial.stamp_ns",
            )
        if initial is not None and motion is not None:
            initial = with_motion_prior(initial, motion, has_gyro=has_imu)
        sun = _read_sun(folder / layout.SUN, stamps)
        imu = None
        if has_imu:
            imu = _read_imu(folder / layout.IMU_DATA, stamps, read_imu_rate_hz(folder / layout.IMU_SENSOR))
        truth = read_states(folder / layout.TRUTH, stamps, body, one_motion=True)
        measurements, in_colour, names_twice = None, 0, ()
        image_paths = tuple(folder / layout.IMAGES / name for name in names)
        if are_measured:
            prior_gP = None if initial is None else initial.gTb[:3, 3]
            measurements = read_measurements(folder, stamps, catalog, camera, sun, prior_gP)
        else:
            repeated = repeated_craters(catalog)
            if len(repeated):
                names_twice = tuple(catalog.identifiers[row] for row in repeated.tolist())
                catalog = catalog.take(np.delete(np.arange(len(catalog)), repeated))
            for image_path in image_paths:
                grey = check_image(image_path, camera.width_px, camera.height_px, camera.bit_depth)
                in_colour += not grey
        logs, ignored = _read_sensors(folder, catalog, int(stamps[0]), int(stamps[-1]))
        return cls(
            path=folder,
            body=body,
            camera=camera,
            catalog=catalog,
            imu=imu,
            imu_noise=imu_noise,
            initial=initial,
            sun=sun,
            stamps_ns=stamps,
            image_paths=image_paths,
            truth=truth,
            measurements=measurements,
            sensors=logs,
            ignored=ignored,
            in_colour=in_colour,
            repeated_craters=names_twice,
            features=read_features(folder, camera, stamps),
            motion=motion,
            apriori=_read_apriori(folder, stamps, body),
        )

    @property
    def sun_departure_rad(self) -> float:
        """See `SunVectors.departure_rad`; 0 where no shade is looked at, in measured rims without tilts."""
        if self.measurements is not None and not any(frame.sun for frame in self.measurements):
            return 0.0
        return self.sun.departure_rad(int(self.stamps_ns[0]), int(self.stamps_ns[-1]), self.body.spin_rad_s)

    def truth_at(self, stamps_ns: IntArray) -> Trajectory | None:
        """Read the truth at given stamps, interpolated where the file has others; None without truth.

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
        return read_states(self.path / layout.TRUTH, stamps_ns, self.body, one_motion=True)

    def image(self, frame: int) -> ImageArray:
        """Read the image of a frame.

        Parameters
        ----------
        frame : int
            Index of the frame.

        Returns
        -------
        ndarray of uint8 or uint16, shape (height, width)
            Grey levels from 0 to `camera.full_scale`.

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
    """Read the logs of the sensors beside camera and IMU; also the folders that none of them reads."""
    kinds = {Path(folder_of(name)).name: kind for name, kind in sensors().items()}
    found: list[Sensor] = []
    ignored: list[str] = []
    surroundings = Surroundings(catalog.body, ground_heights(catalog))
    for here in sorted(path for path in entries(folder / layout.SENSORS) if path.is_dir()):
        if here.name in kinds:
            found.append(read_sensor(folder, kinds[here.name], surroundings, begin_ns, end_ns))
        elif here.name not in layout.OWN_SENSORS:
            ignored.append(here.name)
    return tuple(found), tuple(ignored)


def _has_imu(folder: Path, has_motion: bool) -> bool:
    """Whether a data set has an IMU; without one, a motion model must stand in for it."""
    if (folder / layout.IMU_SENSOR).parent.is_dir():
        return True
    if not has_motion:
        raise InputError(
            folder / layout.DESCRIPTION,
            f"expected a table [motion], as there is no {Path(layout.IMU_SENSOR).parent}, found none",
            column="motion",
        )
    return False


def _catalog_path(folder: Path) -> Path:
    small, large = folder / layout.CRATERS, folder / layout.LARGE_CRATERS
    if exists(small) and exists(large):
        raise InputError(large, f"expected either this catalogue or {layout.CRATERS}, found both")
    return large if exists(large) else small


def _read_frames(path: Path, *, are_images: bool) -> tuple[IntArray, list[str]]:
    table = read_table(path, layout.CAMERA_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one frame, found none")
    table.require_increasing(layout.STAMP)
    names: list[str] = table.columns["filename"]
    seen: dict[str, int] = {}
    for row, name in enumerate(names):
        if Path(name).name != name:
            table.fail(row, "filename", f"expected a name without folders, found {name!r}")
        # Of rims that are measured already, no image is read.
        if are_images and seen.setdefault(name, row) != row:
            problem = f"expected each image once, found {name!r} of line {table.line(seen[name])} again"
            table.fail(row, "filename", problem)
    return table.columns[layout.STAMP], names


def _read_imu(path: Path, frames_ns: IntArray, rate_hz: float) -> ImuLog:
    table = read_table(path, layout.IMU_COLUMNS)
    if len(table) < 2:
        raise InputError(path, f"expected at least two rows, found {len(table)}")
    table.require_increasing(layout.STAMP)
    stamps: IntArray = table.columns[layout.STAMP]
    gap_s = np.diff(stamps) * 1e-9
    _require_nanoseconds(path, float(np.median(gap_s)), rate_hz)
    first = int(stamps[0] - (stamps[1] - stamps[0]))
    # Checked before the coverage: a first step that is too long would also shift the beginning.
    long = np.flatnonzero(gap_s > MAX_IMU_STEP_S)
    if len(long):
        row = int(long[0])
        table.fail(
            row + 1,
            layout.STAMP,
            f"expected steps of at most {MAX_IMU_STEP_S} s, found a gap of {gap_s[row]:.3f} s"
            f" from {stamps[row]} to {stamps[row + 1]}",
        )
    if first > frames_ns[0] or stamps[-1] < frames_ns[-1]:
        raise InputError(
            path,
            f"expected a log over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {first} to {stamps[-1]} ns",
        )
    for names, limit, unit in (
        (layout.GYRO, MAX_RATE_RAD_S, "rad/s"),
        (layout.ACCELEROMETER, MAX_SPECIFIC_FORCE_M_S2, "m/s^2"),
    ):
        for name in names:
            far = np.flatnonzero(np.abs(table.columns[name]) > limit)
            if len(far):
                row = int(far[0])
                found = table.columns[name][row]
                table.fail(row, name, f"expected at most {limit:g} {unit} in size, found {found:g}")
    return ImuLog(stamps, table.numbers(*layout.GYRO), table.numbers(*layout.ACCELEROMETER))


def _require_nanoseconds(path: Path, step_s: float, rate_hz: float) -> None:
    """Refuse stamps whose steps fit the nominal rate in a larger unit only."""
    for unit, seconds in (("microseconds", 1e-6), ("milliseconds", 1e-3), ("seconds", 1.0)):
        if 1.0 / _MAX_RATE_RATIO < step_s * (seconds / 1e-9) * rate_hz < _MAX_RATE_RATIO:
            raise InputError(
                path,
                f"expected nanoseconds, found steps of {step_s:.3g} s and a rate of {rate_hz:g} Hz in"
                f" sensor.yaml: {unit}?",
                column=layout.STAMP,
            )


def _read_sun(path: Path, frames_ns: IntArray) -> SunVectors:
    table = read_table(path, layout.SUN_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one vector, found none")
    table.require_increasing(layout.STAMP)
    vectors = table.numbers(*layout.SUN_VECTOR)
    require_unit(table, vectors, layout.SUN_VECTOR, "vector")
    stamps: IntArray = table.columns[layout.STAMP]
    if len(stamps) > 1 and (stamps[0] > frames_ns[0] or stamps[-1] < frames_ns[-1]):
        raise InputError(
            path,
            f"expected one row, or rows over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {stamps[0]} to {stamps[-1]} ns",
        )
    return SunVectors(stamps, vectors)


def _read_apriori(folder: Path, frames_ns: IntArray, body: Body) -> AprioriStates | None:
    # Not of one motion: they may come from several solutions.
    states = read_states(folder / layout.APRIORI, frames_ns, body, one_motion=False)
    return None if states is None else AprioriStates(states, *read_sigmas(folder / layout.APRIORI_SENSOR))
