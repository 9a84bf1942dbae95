"""A data set from a ROS bag."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import SunVectors, layout, write_dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.dataset.recording import Recording
from craternav_fg.errors import InputError
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.interchange.bag_reading import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    IMU,
    ODOMETRY,
    POSE,
    VECTOR,
    Bag,
    calibration_of,
    camera_of,
    image_of,
    increasing_stamps,
    open_bag,
    stamp_ns,
    vector,
)
from craternav_fg.interchange.bag_transforms import StaticTransforms
from craternav_fg.interchange.bag_truth import read_truth
from craternav_fg.trajectory import InitialState
from factors.arrays import FloatArray, IntArray

# In place of the name of the truth's topic: names begin with a slash.
_NO_TOPIC = "none"
# What a topic carries becomes a file of the data set.
_SOURCES = {
    layout.IMU_DATA: "imu",
    layout.TRUTH: "truth",
    layout.SUN: "sun",
    layout.CAMERA_SENSOR: "camera",
}


@dataclass(frozen=True)
class BagOptions:
    """What a bag does not say, and which of its topics to take.

    Attributes
    ----------
    body : Body
    catalog : Catalog
        Catalogue of the craters on the body.
    imu_noise : ImuNoise
    initial : InitialState or None
        At the stamp of the first image that is kept.
    camera : Camera or None
        Intrinsics and mounting. Without it they are taken from `CameraInfo` and from the static transform
        between the frames of the camera and of the IMU. Its bit depth gives way to that of the images where
        they cannot have it.
    time_shift_s : float
        Added to the images' stamps.
    sun : ndarray, shape (3,), or None
        Direction towards the sun at the first image, in g; without it, a topic of `Vector3Stamped` gives it.
    image, imu, truth, sun_topic : str or None
        Topics, needed where several carry messages of a type. `truth` is "none" to take no poses.
    """

    body: Body
    catalog: Catalog
    imu_noise: ImuNoise
    initial: InitialState | None = None
    camera: Camera | None = None
    time_shift_s: float = 0.0
    sun: FloatArray | None = None
    image: str | None = None
    imu: str | None = None
    truth: str | None = None
    sun_topic: str | None = None


@dataclass(frozen=True)
class BagReport:
    """What was taken from a bag.

    Attributes
    ----------
    topics : dict of str to str or None
        By what they carry: images, imu, truth, sun, camera. None where there is none, or the options give it.
    frames : int
        Images written.
    skipped : int
        Images left out, because the IMU's log does not cover them.
    samples : int
        Number of samples of the IMU.
    truth : bool
        Whether there is a trajectory for comparison.
    uncovered_truth : str or None
        Topic of poses that were left out, because they do not cover the images.
    """

    topics: dict[str, str | None]
    frames: int
    skipped: int
    samples: int
    truth: bool
    uncovered_truth: str | None


def import_bag(path: Path, folder: Path, options: BagOptions) -> BagReport:
    """Write a data set of a bag's images, IMU log and, if there is one, trajectory.

    Parameters
    ----------
    path : Path
        A `.bag` or `.mcap` file, or the folder of a rosbag2.
    folder : Path
        Folder of the data set; replaced when it is empty or a data set.
    options : BagOptions

    Returns
    -------
    BagReport

    Raises
    ------
    InputError
        When the bag is damaged, or lacks something that a data set needs, or `Dataset.open` would refuse the
        data set, which is not kept then.
    CraternavError
        When the extra `ros` is not installed.
    """
    with open_bag(path) as bag:
        topics = {
            "images": bag.topic((IMAGE, COMPRESSED), options.image, "images", "--image-topic"),
            "imu": bag.topic((IMU,), options.imu, "an IMU", "--imu-topic"),
            "truth": _truth_topic(bag, options.truth),
            "sun": None if options.sun is not None else _sun_topic(bag, options.sun_topic),
        }
        for what in ("images", "imu"):
            if topics[what] is None:
                raise InputError(path, f"expected a topic of {what}, found none")
        imu, imu_frame = _imu(bag, topics["imu"])
        stamps, covered, depth, camera_frame = _frames(bag, topics["images"], imu, options.time_shift_s)
        if options.initial is not None and options.initial.stamp_ns != stamps[0]:
            raise InputError(
                path,
                f"expected an initial state at the first image's stamp, {stamps[0]},"
                f" found {options.initial.stamp_ns}",
            )
        topics["camera"], camera = None, options.camera
        if camera is None:
            camera, topics["camera"] = _camera(bag, topics["images"], camera_frame, imu_frame, depth)
        # Kalibr does not say how many bits a pixel has.
        if (camera.bit_depth == 8) != (depth == 8):
            camera = replace(camera, bit_depth=depth)
        truth = read_truth(bag, topics["truth"], stamps, imu_frame)
        recording = Recording(
            body=options.body,
            camera=camera,
            catalog=options.catalog,
            imu=imu,
            imu_noise=options.imu_noise,
            initial=options.initial,
            sun=_sun(bag, topics["sun"], options, stamps),
            stamps_ns=stamps,
            truth=truth,
        )
        try:
            images = _images(bag, topics["images"], covered, camera)
            write_dataset(folder, recording, images, verified=True)
        except InputError as error:
            raise _with_topic(error, folder, topics) from error
    dropped = None
    if truth is None:
        dropped, topics["truth"] = topics["truth"], None
    return BagReport(
        topics=topics,
        frames=len(stamps),
        skipped=int((~covered).sum()),
        samples=len(imu.stamps_ns),
        truth=truth is not None,
        uncovered_truth=dropped,
    )


def _with_topic(error: InputError, folder: Path, topics: dict[str, str | None]) -> InputError:
    """Let an error of a file in the data set name the topic that the file comes from."""
    what = {folder / name: what for name, what in _SOURCES.items()}.get(error.path, "")
    topic = topics.get(what)
    if topic is None:
        return error
    remedy = f": --truth-topic {_NO_TOPIC} takes none" if what == "truth" else ""
    problem = f"{error.problem} (from {topic}{remedy})"
    return InputError(error.path, problem, line=error.line, column=error.column)


def _truth_topic(bag: Bag, wanted: str | None) -> str | None:
    return None if wanted == _NO_TOPIC else bag.topic((ODOMETRY, POSE), wanted, "poses", "--truth-topic")


def _sun_topic(bag: Bag, wanted: str | None) -> str | None:
    topic = bag.topic((VECTOR,), wanted, "the sun's direction", "--sun-topic")
    if topic is None:
        raise InputError(bag.path, "expected the direction towards the sun: give --sun x,y,z in g")
    return topic


def _imu(bag: Bag, topic: str | None) -> tuple[ImuLog, str]:
    """Log of the IMU, and the name of its frame."""
    stamps, rows, names = [], [], set()
    for message in bag.messages(topic):
        stamps.append(stamp_ns(message))
        rows.append([*vector(message.angular_velocity), *vector(message.linear_acceleration)])
        names.add(message.header.frame_id)
        for what in ("angular_velocity", "linear_acceleration"):
            # As sensor_msgs/Imu has it.
            if len(stamps) == 1 and getattr(message, f"{what}_covariance")[0] == -1.0:
                found = f"found a first covariance of -1, which says that there is no {what}"
                raise InputError(bag.path, f"{topic}: expected gyro and accelerometer, {found}")
    if len(stamps) < 2:
        raise InputError(bag.path, f"expected at least two messages of {topic}, found {len(stamps)}")
    values = np.array(rows)
    stamps_ns = increasing_stamps(bag, topic, stamps)
    if not np.all(np.isfinite(values)):
        raise InputError(bag.path, f"{topic}: expected finite numbers")
    return ImuLog(stamps_ns, values[:, :3], values[:, 3:]), _one_frame(bag, topic, names)


def _one_frame(bag: Bag, topic: str | None, names: set[str]) -> str:
    """Name of the frame that all headers of a topic have."""
    if len(names) > 1:
        found = ", ".join(name or "one without a name" for name in sorted(names))
        raise InputError(bag.path, f"{topic}: expected headers of one frame, found {found}")
    return names.pop()


def _frames(
    bag: Bag, topic: str | None, imu: ImuLog, shift_s: float
) -> tuple[IntArray, npt.NDArray[np.bool_], int, str]:
    """Stamps of the images that the IMU covers, which of all they are, bits of a pixel, name of the frame."""
    stamps, depth, names = [], 8, set()
    for message in bag.messages(topic):
        stamps.append(stamp_ns(message) + round(1e9 * shift_s))
        names.add(message.header.frame_id)
        if len(stamps) == 1:
            depth = 8 * image_of(bag.path, message).itemsize
    all_ns = increasing_stamps(bag, topic, stamps)
    begin = imu.stamps_ns[0] - (imu.stamps_ns[1] - imu.stamps_ns[0])
    covered = (all_ns >= begin) & (all_ns <= imu.stamps_ns[-1])
    if not covered.any():
        raise InputError(
            bag.path,
            f"expected images within the IMU's log, {begin} to {imu.stamps_ns[-1]} ns,"
            f" found {len(all_ns)} outside of it",
        )
    return all_ns[covered], covered, depth, _one_frame(bag, topic, names)


def _images(
    bag: Bag, topic: str | None, covered: npt.NDArray[np.bool_], camera: Camera
) -> Iterator[ImageArray]:
    """Decode the images that are kept, one at a time."""
    size = (camera.height_px, camera.width_px)
    for keep, message in zip(covered.tolist(), bag.messages(topic), strict=True):
        if not keep:
            continue
        image = image_of(bag.path, message)
        if image.shape != size:
            found = f"{image.shape[1]} x {image.shape[0]}"
            raise InputError(
                bag.path,
                f"image of stamp {stamp_ns(message)}: expected {size[1]} x {size[0]} px, found {found}",
            )
        yield image


def _camera(bag: Bag, images: str | None, frame: str, imu_frame: str, depth: int) -> tuple[Camera, str]:
    """Camera of static transforms and of the `CameraInfo` beside the images or the only one; its topic."""
    infos = bag.connected(CAMERA_INFO)
    folder = (images or "").removesuffix("/compressed").rpartition("/")[0]
    beside = [name for name in infos if name.rpartition("/")[0] == folder]
    candidates = beside or infos
    if len(candidates) > 1:
        known = ", ".join(candidates)
        raise InputError(bag.path, f"expected one CameraInfo beside {images}, found {known}: give --camera")
    topic = candidates[0] if candidates else None
    message = None if topic is None else _one_calibration(bag, topic)
    if topic is None or message is None:
        raise InputError(bag.path, "expected a topic of CameraInfo, found none: give --camera")
    found = message.header.frame_id
    if not beside and found and frame and found != frame:
        problem = f"expected a CameraInfo of the images' frame, {frame}, found that of {found}"
        raise InputError(bag.path, f"{topic}: {problem}: give --camera")
    if not frame or not imu_frame:
        unnamed = images if not frame else "the IMU"
        raise InputError(
            bag.path, f"expected headers that name a frame, found none of {unnamed}: give --camera"
        )
    transforms = StaticTransforms(bag)
    bTc = transforms.pose(imu_frame, frame)
    if bTc is None:
        related = f"{imu_frame} is related to {transforms.related(imu_frame)}"
        related += f", and {frame} to {transforms.related(frame)}"
        raise InputError(
            bag.path,
            f"expected static transforms from {imu_frame} to {frame}, found none: {related}: give --camera",
        )
    return camera_of(bag.path, message, bTc, depth, rectified=_is_rectified(images)), topic


def _one_calibration(bag: Bag, topic: str) -> Any:
    """Return the first `CameraInfo` of a topic, if all others state the same; None without any."""
    first: tuple[Any, bytes] | None = None
    for message in bag.messages(topic):
        stated = calibration_of(message)
        first = first or (message, stated)
        if stated != first[1]:
            problem = f"expected one calibration, found another at stamp {stamp_ns(message)}"
            raise InputError(bag.path, f"{topic}: {problem}: give --camera")
    return first and first[0]


def _is_rectified(topic: str | None) -> bool:
    """Whether the images are rectified, by the names that image_proc gives them."""
    name = (topic or "").removesuffix("/compressed").rpartition("/")[2]
    return any(part in ("rect", "rectified") for part in name.split("_"))


def _sun(bag: Bag, topic: str | None, options: BagOptions, stamps: IntArray) -> SunVectors:
    if options.sun is not None:
        return SunVectors.among_stars(options.sun, int(stamps[0]), stamps, options.body.spin_rad_s)
    found, rows = [], []
    for message in bag.messages(topic):
        found.append(stamp_ns(message))
        rows.append(vector(message.vector))
    if not found:
        raise InputError(bag.path, f"{topic}: expected directions towards the sun, found none")
    stamps_ns, vectors = increasing_stamps(bag, topic, found), np.array(rows)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    is_direction = np.isfinite(length[:, 0]) & (length[:, 0] > 0.0)
    if not is_direction.all():
        raise InputError(
            bag.path, f"{topic}: expected directions, found {vectors[~is_direction][0].tolist()}"
        )
    # A unit vector keeps its bits.
    return SunVectors(stamps_ns, np.where(np.abs(length - 1.0) < 1e-9, vectors, vectors / length))
