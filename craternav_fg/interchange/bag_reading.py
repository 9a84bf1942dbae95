"""Reading of ROS bags: rosbag1, rosbag2 and MCAP through `rosbags`, every failure as one line."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from craternav_fg import frames, lens
from craternav_fg.camera import Camera
from craternav_fg.dataset.images import ImageArray
from craternav_fg.dataset.sensor_files import lens_of
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input, entries
from factors.arrays import FloatArray, IntArray

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMU, CAMERA_INFO = "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo"
POSE, ODOMETRY = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
VECTOR, TRANSFORMS = "geometry_msgs/msg/Vector3Stamped", "tf2_msgs/msg/TFMessage"
# Grey images whose pixels are kept, and how others are turned into grey.
_GREY = {"mono8": np.uint8, "8UC1": np.uint8, "mono16": np.uint16, "16UC1": np.uint16}
_COLOUR = {
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
}
# How a bag of ROS 1 begins.
_ROSBAG1 = b"#ROSBAG V2.0"
# Of the squared length of a quaternion; that of tf2, which ignores transforms beyond it.
_UNIT_TOLERANCE = 0.01


@dataclass(frozen=True)
class Bag:
    """An open bag.

    Attributes
    ----------
    path : Path
    reader : object
        `rosbags.highlevel.AnyReader`.
    """

    path: Path
    reader: Any

    def connected(self, *types: str) -> list[str]:
        """List the topics of some message types, by name."""
        return sorted({c.topic for c in self.reader.connections if c.msgtype in types})

    def topic(self, types: Sequence[str], wanted: str | None, what: str, option: str) -> str | None:
        """Find the topic of some message types.

        Parameters
        ----------
        types : sequence of str
        wanted : str or None
            Its name, if the user gave one.
        what : str
            What it carries, for messages.
        option : str
            That names it.

        Returns
        -------
        str or None
            None when no topic has these types.

        Raises
        ------
        InputError
            When the wanted one is not there, or several could be meant.
        """
        found = self.connected(*types)
        if wanted is not None:
            if wanted not in found:
                known = ", ".join(found) or "none"
                raise InputError(self.path, f"expected a topic of {what}, one of {known}, found {wanted}")
            return wanted
        if len(found) > 1:
            raise InputError(
                self.path, f"expected one topic of {what}, found {', '.join(found)}: choose by {option}"
            )
        return found[0] if found else None

    def messages(self, topic: str | None) -> Iterator[Any]:
        """Read the messages of a topic in the order of recording; none without a topic.

        Raises
        ------
        InputError
            When the bag is damaged.
        """
        connections = [c for c in self.reader.connections if c.topic == topic]
        if not connections:
            return
        read = self.reader.messages(connections=connections)
        while True:
            with _reading(self.path):
                found = next(read, None)
                if found is None:
                    return
                connection, _, raw = found
                message = self.reader.deserialize(raw, connection.msgtype)
            yield message


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    Parameters
    ----------
    path : Path
        A `.bag` or `.mcap` file, or the folder of a rosbag2.

    Yields
    ------
    Bag

    Raises
    ------
    CraternavError
        When the extra `ros` is not installed.
    InputError
        When it is no bag, or damaged.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise CraternavError("bags need rosbags: pip install 'craternav_fg[ros]'") from None
    if not path.exists():
        raise InputError(path, "bag is missing")
    # A pipe in place of one of its files would block.
    for one in entries(path) if path.is_dir() else [path]:
        # rosbags reads its description whole.
        check_input(one, SizeLimit.SETTINGS if one.suffix == ".yaml" else SizeLimit.BAG)
    # rosbags looks for the end of a first line, however far it is.
    if path.suffix == ".bag" and path.is_file():
        with path.open("rb") as stream:
            if stream.read(len(_ROSBAG1)) != _ROSBAG1:
                raise InputError(path, "expected a bag of ROS 1, found a file that does not begin as one")
    with _reading(path):
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    # What is done with the bag is outside of `_reading`: a defect there is no damage of the bag.
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Convert the errors that a damaged bag raises in `rosbags` to one line."""
    try:
        yield
    except CraternavError:
        raise
    # A damaged bag raises what its bytes happen to lead to: errors of struct, sqlite, lz4, numpy and others.
    except Exception as error:
        raise InputError(path, f"expected a bag that can be read: {type(error).__name__}: {error}") from error


def stamp_ns(message: Any) -> int:
    """Stamp of a message's header, ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def vector(message: Any) -> tuple[float, float, float]:
    """Components of a `Vector3` or `Point`."""
    return float(message.x), float(message.y), float(message.z)


def quaternion_wxyz(message: Any) -> tuple[float, float, float, float]:
    """Components of a `Quaternion`, scalar first."""
    return float(message.w), float(message.x), float(message.y), float(message.z)


def increasing_stamps(bag: Bag, topic: str | None, stamps: Sequence[int]) -> IntArray:
    """Check that the stamps of a topic's messages increase.

    Returns
    -------
    ndarray of int64, shape (n,)
        The stamps, ns.

    Raises
    ------
    InputError
        When one does not.
    """
    found = np.array(stamps, dtype=np.int64)
    back = np.flatnonzero(np.diff(found) <= 0)
    if len(back):
        k = int(back[0])
        raise InputError(
            bag.path, f"{topic}: expected stamps that increase, found {found[k + 1]} after {found[k]} ns"
        )
    return found


def pose_of(bag: Bag, where: str, position: Any, orientation: Any) -> FloatArray:
    """Make a pose of the vector and the quaternion of a message.

    Returns
    -------
    ndarray, shape (4, 4)
        Translation in the vector's unit.

    Raises
    ------
    InputError
        When a number is not finite, or the quaternion is not of unit length.
    """
    t, q = vector(position), quaternion_wxyz(orientation)
    if not np.all(np.isfinite([*t, *q])) or not any(q):
        raise InputError(
            bag.path, f"{where}: expected a position and a quaternion, found {list(t)}, {list(q)} (wxyz)"
        )
    if abs(np.dot(q, q) - 1.0) > _UNIT_TOLERANCE:
        raise InputError(bag.path, f"{where}: expected a unit quaternion, found {list(q)} (wxyz)")
    return frames.pose(frames.from_quaternion_wxyz(np.array(q)), np.array(t))


def image_of(path: Path, message: Any) -> ImageArray:
    """Decode the pixels of an `Image` or a `CompressedImage`.

    Parameters
    ----------
    path : Path
        Path of the bag, for messages.
    message : object

    Returns
    -------
    ndarray of uint8 or uint16, shape (height, width)
        Grey levels, bit by bit those of a grey image.

    Raises
    ------
    InputError
        When the encoding is unknown, or the pixels do not fit the size.
    """
    where = f"image of stamp {stamp_ns(message)}"
    if hasattr(message, "format"):
        coded = np.asarray(message.data, dtype=np.uint8)
        # OpenCV raises where there are no bytes, and reads pictures of other numbers than grey levels.
        image: Any = cv2.imdecode(coded, cv2.IMREAD_UNCHANGED) if len(coded) else None
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise InputError(path, f"{where}: expected a PNG or JPEG, found {message.format!r}")
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)
        return image
    encoding = message.encoding
    channels, turn = _COLOUR.get(encoding, (1, None))
    if turn is None and encoding not in _GREY:
        known = ", ".join([*_GREY, *_COLOUR])
        raise InputError(path, f"{where}: expected an encoding of {known}, found {encoding}")
    kind = np.dtype(_GREY.get(encoding, np.uint8)).newbyteorder(">" if message.is_bigendian else "<")
    width = int(message.width) * channels
    data = np.asarray(message.data, dtype=np.uint8)
    if not message.width or not message.height:
        raise InputError(path, f"{where}: expected pixels, found {message.width} x {message.height}")
    if len(data) != message.step * message.height or message.step < width * kind.itemsize:
        raise InputError(
            path, f"{where}: expected {message.height} rows of {message.step} bytes, found {len(data)} bytes"
        )
    rows = data.reshape(message.height, message.step)[:, : width * kind.itemsize]
    pixels = np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder("="))
    if turn is None:
        return np.asarray(pixels)
    colours = pixels.reshape(message.height, message.width, channels)
    return np.asarray(cv2.cvtColor(colours, turn), dtype=np.uint8)


def calibration_of(message: Any) -> bytes:
    """Return all numbers that a `CameraInfo` states, to tell whether two state the same."""
    numbers = [np.ravel(_field(message, name)) for name in ("width", "height", "k", "d", "r", "p")]
    return np.concatenate([*numbers, np.ravel(list(_windows(message)))]).tobytes()


def _field(message: Any, name: str) -> FloatArray:
    """Numbers of a field, whose upper-case name is that of ROS 1; none where it is missing."""
    return np.asarray(getattr(message, name, getattr(message, name.upper(), ())), dtype=np.float64)


def camera_of(
    path: Path, message: Any, bTc: FloatArray, bit_depth: int, *, rectified: bool = False
) -> Camera:
    """Make a camera of a `CameraInfo`.

    Parameters
    ----------
    path : Path
        Path of the bag, for messages.
    message : object
    bTc : ndarray, shape (4, 4)
        Mounting: pose of the camera in b, m.
    bit_depth : int
        Bits of its grey levels.
    rectified : bool
        Whether the images are: they have the intrinsics P, no distortion, and are turned by R.

    Returns
    -------
    Camera

    Raises
    ------
    InputError
        When the calibration is empty, or its lens is not known or does not fit the image.
    """
    K, D = _field(message, "k"), _field(message, "d")
    if rectified:
        P, R = _field(message, "p"), _field(message, "r")
        if len(P) != 12 or len(R) != 9 or abs(np.linalg.det(R.reshape(3, 3)) - 1.0) > _UNIT_TOLERANCE:
            raise InputError(path, "expected a CameraInfo with P and R, as the images are rectified")
        K, D = np.delete(P, [3, 7, 11]), np.empty(0)
        bTc = bTc @ frames.pose(R.reshape(3, 3).T, np.zeros(3))
    if len(K) != 9 or not K[0] > 0.0:
        raise InputError(path, "expected a calibrated CameraInfo, found no focal length")
    if not np.isfinite([*K, *D]).all():
        raise InputError(path, "expected a calibrated CameraInfo, found numbers that are not finite")
    stated = "" if rectified else message.distortion_model
    model = lens_of(stated) if stated else lens.RADIAL_TANGENTIAL
    if model is None:
        raise InputError(path, f"expected a lens that is known, found {stated!r}")
    coefficients = tuple(float(v) for v in D) or (0.0,) * 5
    if model == lens.RADIAL_TANGENTIAL and len(coefficients) == 4:
        coefficients = (*coefficients, 0.0)
    (width, fx, cx), (height, fy, cy) = (
        _of_image(int(size), float(focal), float(centre), *window)
        for size, focal, centre, window in zip(
            (message.width, message.height), (K[0], K[4]), (K[2], K[5]), _windows(message), strict=True
        )
    )
    try:
        return Camera(width, height, fx, fy, cx, cy, bTc, coefficients, bit_depth=bit_depth, lens_model=model)
    except ValueError as error:
        raise InputError(path, f"CameraInfo: {error}") from None


def _windows(message: Any) -> Iterator[tuple[int, int, int]]:
    """First pixel and number of pixels that are read out, 0 for all, and how many become one: x, then y."""
    region = getattr(message, "roi", None)
    for axis, size in (("x", "width"), ("y", "height")):
        first = int(getattr(region, f"{axis}_offset", 0))
        yield first, int(getattr(region, size, 0)), max(int(getattr(message, f"binning_{axis}", 0)), 1)


def _of_image(
    size: int, focal: float, centre: float, first: int, read: int, binning: int
) -> tuple[int, float, float]:
    """Size, focal length and principal point of the image along one axis, from those of the whole sensor.

    A binned pixel is the mean of its pixels, and its centre theirs.
    """
    return (read or size) // binning, focal / binning, (centre - first + 0.5) / binning - 0.5
