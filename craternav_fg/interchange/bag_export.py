"""A data set, and the trajectories of a run, as a ROS bag."""

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from craternav_fg import frames, lens
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError
from craternav_fg.files import replacing, replacing_folder
from craternav_fg.imu import ImuLog
from craternav_fg.interchange.bag_reading import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    IMU,
    ODOMETRY,
    TRANSFORMS,
    VECTOR,
)
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# Names of frames and topics.
MAP, BODY, CAMERA = "body_fixed", "imu0", "cam0"
IMAGE_TOPIC, INFO_TOPIC, IMU_TOPIC = "/cam0/image_raw", "/cam0/camera_info", "/imu0"
SUN_TOPIC, TRUTH_TOPIC, STATIC_TOPIC = "/sun", "/ground_truth/odometry", "/tf_static"
_LENS_NAMES = {
    lens.RADIAL_TANGENTIAL: "plumb_bob",
    lens.RATIONAL: "rational_polynomial",
    lens.FISHEYE: "equidistant",
}


class BagFormat(StrEnum):
    """Formats of bags."""

    ROSBAG1 = "rosbag1"
    ROSBAG2 = "rosbag2"
    MCAP = "mcap"


def export_bag(
    data: Dataset,
    path: Path,
    kind: BagFormat,
    *,
    compressed: bool = False,
    estimates: Mapping[str, Trajectory] | None = None,
) -> None:
    """Write a data set as a bag: images, camera, IMU, sun and, if they are known, trajectories.

    Parameters
    ----------
    data : Dataset
    path : Path
        A file for rosbag1, else a folder.
    kind : BagFormat
    compressed : bool
        Whether to write the images as PNG (`CompressedImage`).
    estimates : mapping of str to Trajectory, optional
        Written as `/NAME/odometry`, with their pose covariances.

    Raises
    ------
    InputError
        When an image cannot be read, or the bag cannot be written.
    CraternavError
        When the extra `ros` is not installed.
    """
    with _writer(path, kind) as bag:
        events = sorted(_events(bag, data, compressed, estimates or {}), key=lambda event: event[0])
        for stamp, write in events:
            write(stamp)


Event = tuple[int, Callable[[int], None]]


@dataclass
class _Bag:
    """A bag that is written: messages by type and fields."""

    store: Any
    writer: Any
    ros1: bool
    connections: dict[str, Any] = field(default_factory=dict)
    count: int = 0

    def make(self, kind: str, **fields: Any) -> Any:
        """Make a message."""
        return self.store.types[kind](**fields)

    def header(self, stamp: int, frame: str) -> Any:
        """Make a header; that of ROS 1 counts the messages."""
        seconds, rest = divmod(int(stamp), 1_000_000_000)
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        self.count += 1
        more = {"seq": self.count} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **more)

    def vector(self, values: FloatArray, kind: str = "Vector3") -> Any:
        """Make a vector or a point."""
        x, y, z = (float(v) for v in values)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, R: FloatArray) -> Any:
        """Make a quaternion of a rotation matrix."""
        w, x, y, z = (float(v) for v in frames.to_quaternion_wxyz(R))
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def write(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        """Write a message at its stamp."""
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialise = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], int(stamp), serialise(message, kind))


@contextmanager
def _writer(path: Path, kind: BagFormat) -> Iterator[_Bag]:
    """Open a bag to write, whole or not at all."""
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise CraternavError("bags need rosbags: pip install 'craternav_fg[ros]'") from None
    if kind == BagFormat.ROSBAG1:
        with replacing(path) as temporary:
            # The writer wants to make its file itself.
            temporary.unlink()
            with rosbag1.Writer(temporary) as writer:
                store = get_typestore(Stores.ROS1_NOETIC)
                # Not among the types that rosbags knows of ROS 1.
                store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
                yield _Bag(store, writer, ros1=True)
        return
    plugin = rosbag2.StoragePlugin.MCAP if kind == BagFormat.MCAP else rosbag2.StoragePlugin.SQLITE3
    with replacing_folder(path, marker="metadata.yaml", ours=("metadata.yaml", "*.db3", "*.mcap")) as folder:
        inner = folder / path.resolve().name
        with rosbag2.Writer(inner, version=8, storage_plugin=plugin) as writer:
            yield _Bag(get_typestore(Stores.ROS2_HUMBLE), writer, ros1=False)
        for file in inner.iterdir():
            shutil.move(file, folder / file.name)
        inner.rmdir()


def _events(
    bag: _Bag, data: Dataset, compressed: bool, estimates: Mapping[str, Trajectory]
) -> Iterator[Event]:
    """Stamp and writer of every message; a bag is written in the order of time."""
    yield int(data.stamps_ns[0]), partial(_static, bag, data)
    for k, stamp in enumerate(data.stamps_ns.tolist()):
        yield stamp, partial(_info, bag, data)
        if data.measurements is None:
            yield stamp, partial(_image, bag, data, k, compressed)
    if data.imu is not None:
        for k, stamp in enumerate(data.imu.stamps_ns.tolist()):
            yield stamp, partial(_imu, bag, data.imu, k)
    for k, stamp in enumerate(data.sun.stamps_ns.tolist()):
        yield stamp, partial(_sun, bag, data, k)
    tracks = {f"/{name}/odometry": trajectory for name, trajectory in estimates.items()}
    if data.truth is not None:
        tracks[TRUTH_TOPIC] = data.truth
    for topic, track in tracks.items():
        for k, stamp in enumerate(track.stamps_ns.tolist()):
            yield stamp, partial(_odometry, bag, topic, track, k)


def _static(bag: _Bag, data: Dataset, stamp: int) -> None:
    bTc = data.camera.bTc
    transform = bag.make(
        "geometry_msgs/msg/Transform",
        translation=bag.vector(bTc[:3, 3]),
        rotation=bag.quaternion(bTc[:3, :3]),
    )
    stamped = bag.make(
        "geometry_msgs/msg/TransformStamped",
        header=bag.header(stamp, BODY), child_frame_id=CAMERA, transform=transform,
    )  # fmt: skip
    bag.write(STATIC_TOPIC, TRANSFORMS, stamp, bag.make(TRANSFORMS, transforms=[stamped]))


def _info(bag: _Bag, data: Dataset, stamp: int) -> None:
    camera = data.camera
    region = bag.make(
        "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    matrices = {
        "d": np.array(camera.distortion),
        "k": camera.matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.column_stack([camera.matrix, np.zeros(3)]).ravel(),
    }
    named = {name.upper() if bag.ros1 else name: value for name, value in matrices.items()}
    message = bag.make(
        CAMERA_INFO,
        header=bag.header(stamp, CAMERA), height=camera.height_px, width=camera.width_px,
        distortion_model=_LENS_NAMES[camera.lens_model], binning_x=0, binning_y=0, roi=region, **named,
    )  # fmt: skip
    bag.write(INFO_TOPIC, CAMERA_INFO, stamp, message)


def _image(bag: _Bag, data: Dataset, k: int, compressed: bool, stamp: int) -> None:
    image, header = data.image(k), bag.header(stamp, CAMERA)
    if compressed:
        _, coded = cv2.imencode(".png", image)
        message = bag.make(COMPRESSED, header=header, format="png", data=coded.ravel())
        bag.write(f"{IMAGE_TOPIC}/compressed", COMPRESSED, stamp, message)
        return
    height, width = image.shape
    pixels = np.ascontiguousarray(image).astype(image.dtype.newbyteorder("<")).view(np.uint8)
    message = bag.make(
        IMAGE,
        header=header, height=height, width=width, encoding="mono8" if image.itemsize == 1 else "mono16",
        is_bigendian=0, step=width * image.itemsize, data=pixels.ravel(),
    )  # fmt: skip
    bag.write(IMAGE_TOPIC, IMAGE, stamp, message)


def _imu(bag: _Bag, log: ImuLog, k: int, stamp: int) -> None:
    # -1 in the first element: the message holds no orientation.
    none = np.array([-1.0, *[0.0] * 8])
    message = bag.make(
        IMU,
        header=bag.header(stamp, BODY), orientation=bag.quaternion(np.eye(3)), orientation_covariance=none,
        angular_velocity=bag.vector(log.gyro_rad_s[k]), angular_velocity_covariance=np.zeros(9),
        linear_acceleration=bag.vector(log.accelerometer_m_s2[k]), linear_acceleration_covariance=np.zeros(9),
    )  # fmt: skip
    bag.write(IMU_TOPIC, IMU, stamp, message)


def _sun(bag: _Bag, data: Dataset, k: int, stamp: int) -> None:
    message = bag.make(VECTOR, header=bag.header(stamp, MAP), vector=bag.vector(data.sun.vectors[k]))
    bag.write(SUN_TOPIC, VECTOR, stamp, message)


def _odometry(bag: _Bag, topic: str, track: Trajectory, k: int, stamp: int) -> None:
    """Write a state: the pose in g; the velocity, relative to g, in b as REP 105 has it."""
    pose = bag.make(
        "geometry_msgs/msg/Pose",
        position=bag.vector(track.gP[k], "Point"), orientation=bag.quaternion(track.gRb[k]),
    )  # fmt: skip
    twist = bag.make(
        "geometry_msgs/msg/Twist",
        linear=bag.vector(track.gRb[k].T @ track.gV[k]), angular=bag.vector(np.zeros(3)),
    )  # fmt: skip
    covariance = np.zeros(36)
    if track.pose_covariance is not None:
        covariance = _ros_covariance(track.pose_covariance[k], track.gRb[k])
    message = bag.make(
        ODOMETRY,
        header=bag.header(stamp, MAP), child_frame_id=BODY,
        pose=bag.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
        twist=bag.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )  # fmt: skip
    bag.write(topic, ODOMETRY, stamp, message)


def _ros_covariance(covariance: FloatArray, gRb: FloatArray) -> FloatArray:
    """Covariance of (position, rotation about the axes of g), as ROS has it, row by row.

    Ours is of (rotation vector in b, position): R exp(phi) = exp(R phi) R turns the rotation into g.
    """
    J = np.zeros((6, 6))
    J[:3, 3:], J[3:, :3] = np.eye(3), gRb
    return np.asarray((J @ covariance @ J.T).ravel())
