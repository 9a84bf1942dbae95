"""Frames and calibrations of bags: transforms, rectified images, and what contradicts itself."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.errors import InputError
from tests.interchange.test_bag_truth import add_transform, changing, imported, put
from tests.interchange.test_bags import dataset

pytest.importorskip("rosbags")
from craternav_fg.interchange.bag_export import (
    IMAGE_TOPIC,
    IMU_TOPIC,
    INFO_TOPIC,
    STATIC_TOPIC,
    BagFormat,
    export_bag,
)
from craternav_fg.interchange.bag_reading import Bag


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag")
    export_bag(dataset(folder / "data"), folder / "flight", BagFormat.MCAP)
    return folder / "flight"


def second_way(_: int, message: Any) -> None:
    add_transform(message, "imu0", "plate", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    add_transform(message, "plate", "cam0", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def misspelt(_: int, message: Any) -> None:
    add_transform(message, "bracket", "cam0", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    add_transform(message, "imu_plate", "imu0", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    del message.transforms[0]


def euler_angles(_: int, message: Any) -> None:
    put(message.transforms[0].transform.rotation, [0.3, 0.0, 0.2])
    message.transforms[0].transform.rotation.w = 1.0


def no_frame(_: int, message: Any) -> None:
    message.header.frame_id = ""


def other_frame(k: int, message: Any) -> None:
    message.header.frame_id = "imu1" if k % 2 else "imu0"


def no_accelerometer(_: int, message: Any) -> None:
    message.linear_acceleration_covariance = np.array([-1.0, *[0.0] * 8])


def zoom(k: int, message: Any) -> None:
    message.k = (1.0 + k) * message.k


@pytest.mark.parametrize(
    ("topic", "change", "problem"),
    [
        (STATIC_TOPIC, second_way, r"/tf_static: expected one pose of \w+ in imu0, found another by way of"),
        (
            STATIC_TOPIC,
            misspelt,
            "imu0 is related to imu_plate, and cam0 to bracket: give --camera",
        ),
        (
            STATIC_TOPIC,
            euler_angles,
            r"imu0 to cam0: expected a unit quaternion, found \[1.0, 0.3, 0.0, 0.2\]",
        ),
        (IMAGE_TOPIC, no_frame, "expected headers that name a frame, found none of /cam0/image_raw"),
        (IMU_TOPIC, other_frame, "/imu0: expected headers of one frame, found imu0, imu1"),
        (IMU_TOPIC, no_accelerometer, "/imu0: expected gyro and accelerometer, .* no linear_acceleration"),
        (INFO_TOPIC, zoom, "/cam0/camera_info: expected one calibration, found another at stamp"),
    ],
)
def test_frames_and_calibrations_that_contradict_each_other_are_refused(
    recorded: Path,
    monkeypatch: pytest.MonkeyPatch,
    topic: str,
    change: Callable[[int, Any], None],
    problem: str,
) -> None:
    changing(monkeypatch, topic, change)
    with pytest.raises(InputError, match=problem):
        imported(recorded, initial=None)


@pytest.mark.parametrize("name", ["image_rect", "image_rect_color", "image_rectified"])
def test_rectified_images_have_the_intrinsics_of_p_no_distortion_and_are_turned_by_r(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    turn = frames.rotation_exp(np.array([0.01, -0.02, 0.03]))

    def rectify(_: int, message: Any) -> None:
        message.d = np.array([-0.1, 0.05, 0.0, 0.0, 0.0])
        message.r = turn.ravel()
        message.p = np.array([70.0, 0.0, 30.0, -9.0, 0.0, 71.0, 20.0, 0.0, 0.0, 0.0, 1.0, 0.0])

    before = imported(recorded, initial=None).camera
    changing(monkeypatch, INFO_TOPIC, rectify)
    renamed(monkeypatch, f"/cam0/{name}")
    camera = imported(recorded, initial=None).camera
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (70.0, 71.0, 30.0, 20.0)
    assert not any(camera.distortion)
    np.testing.assert_allclose(camera.bTc[:3, :3] @ turn, before.bTc[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(camera.bTc[:3, 3], before.bTc[:3, 3])


def test_rectified_images_need_p(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(_: int, message: Any) -> None:
        message.p = np.zeros(12)

    changing(monkeypatch, INFO_TOPIC, without)
    renamed(monkeypatch, "/cam0/image_rect")
    with pytest.raises(InputError, match="expected a calibrated CameraInfo, found no focal length"):
        imported(recorded, initial=None)


def renamed(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let the images have another topic."""
    connected, messages = Bag.connected, Bag.messages
    monkeypatch.setattr(
        Bag,
        "connected",
        lambda bag, *types: [name if t == IMAGE_TOPIC else t for t in connected(bag, *types)],
    )
    monkeypatch.setattr(
        Bag, "messages", lambda bag, topic: messages(bag, IMAGE_TOPIC if topic == name else topic)
    )
