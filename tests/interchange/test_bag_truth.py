"""True trajectories of bags: of which frame, with which velocity, and what is refused."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.interchange.bag_import import import_bag
from tests.dataset.samples import FRAMES_NS
from tests.interchange.test_bags import dataset, options

pytest.importorskip("rosbags")
from craternav_fg.interchange.bag_export import STATIC_TOPIC, TRUTH_TOPIC, BagFormat, export_bag
from craternav_fg.interchange.bag_reading import Bag

SPIN_RAD_S = 0.7
Change = Callable[[int, Any], None]


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    export_bag(dataset(tmp_path / "data"), tmp_path / "flight", BagFormat.MCAP)
    return tmp_path / "flight"


def changing(monkeypatch: pytest.MonkeyPatch, topic: str, change: Change) -> None:
    """Let a bag's messages of a topic be others: each is changed in place."""
    read = Bag.messages

    def messages(bag: Bag, name: str | None) -> Iterator[Any]:
        for k, message in enumerate(read(bag, name)):
            if name == topic:
                change(k, message)
            yield message

    monkeypatch.setattr(Bag, "messages", messages)


def imported(flight: Path, **changes: Any) -> Dataset:
    data = Dataset.open(flight.parent / "data")
    import_bag(flight, flight.parent / "again", options(data, **changes))
    return Dataset.open(flight.parent / "again")


def put(vector: Any, values: Any) -> None:
    vector.x, vector.y, vector.z = (float(value) for value in values)


def of_base(k: int, message: Any) -> None:
    """Make it the state of a frame that spins about z and flies along x at 10 m/s."""
    seconds = 1e-9 * (FRAMES_NS[k] - FRAMES_NS[0])
    gRf = frames.rotation_exp(np.array([0.0, 0.0, SPIN_RAD_S * seconds]))
    message.child_frame_id = "base_link"
    put(message.pose.pose.position, [10.0 * seconds, 0.0, 1.8e6])
    orientation = message.pose.pose.orientation
    orientation.w, *xyz = frames.to_quaternion_wxyz(gRf)
    put(orientation, xyz)
    put(message.twist.twist.linear, gRf.T @ [10.0, 0.0, 0.0])
    put(message.twist.twist.angular, [0.0, 0.0, SPIN_RAD_S])


def with_base(_: int, message: Any) -> None:
    """Mount the IMU 2 m along y of the base, turned by 90 deg about z: x of b is y of the base."""
    add_transform(message, "base_link", "imu0", [0.0, 2.0, 0.0], [0.0, 0.0, np.sqrt(0.5)])


def with_plate(_: int, message: Any) -> None:
    """Mount it as `with_base` does, by way of a plate whose pose is given in the IMU's frame."""
    add_transform(message, "/imu0", "/plate", [-2.0, 1.0, 0.0], [0.0, 0.0, 0.0])
    add_transform(message, "/base_link", "/plate", [-1.0, 0.0, 0.0], [0.0, 0.0, np.sqrt(0.5)])


def add_transform(message: Any, parent: str, child: str, place_m: list[float], xyz: list[float]) -> None:
    one = deepcopy(message.transforms[0])
    one.header.frame_id, one.child_frame_id = parent, child
    put(one.transform.translation, place_m)
    put(one.transform.rotation, xyz)
    one.transform.rotation.w = float(np.sqrt(1.0 - np.dot(xyz, xyz)))
    message.transforms.append(one)


@pytest.mark.parametrize("mounting", [with_base, with_plate])
@pytest.mark.parametrize("rates", [True, False])
def test_poses_of_another_frame_become_those_of_the_imu(
    flight: Path, monkeypatch: pytest.MonkeyPatch, rates: bool, mounting: Callable[[int, Any], None]
) -> None:
    def change(k: int, message: Any) -> None:
        of_base(k, message)
        if not rates:
            put(message.twist.twist.angular, [0.0, 0.0, 0.0])

    changing(monkeypatch, TRUTH_TOPIC, change)
    changing(monkeypatch, STATIC_TOPIC, mounting)
    truth = imported(flight, initial=None).truth
    assert truth is not None
    seconds = 1e-9 * (FRAMES_NS - FRAMES_NS[0])
    angle = SPIN_RAD_S * seconds + np.pi / 2
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    np.testing.assert_allclose(
        truth.gP, 2.0 * circle + np.outer(seconds, [10, 0, 0]) + [0, 0, 1.8e6], atol=1e-9
    )
    np.testing.assert_allclose(truth.gRb[:, :, 0], circle, atol=1e-12)
    tangent = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(3)])
    # Without rates, the velocity is the derivative of the positions.
    close = {"atol": 1e-9} if rates else {"atol": 0.01}
    np.testing.assert_allclose(truth.gV, [10, 0, 0] + 2.0 * SPIN_RAD_S * tangent, **close)


def test_poses_of_an_unknown_frame_are_refused(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changing(monkeypatch, TRUTH_TOPIC, of_base)
    with pytest.raises(InputError, match=r"poses of imu0, .*found those of base_link: --truth-topic none"):
        imported(flight)
    assert imported(flight, truth="none").truth is None


def test_a_twist_of_zeros_is_no_velocity(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(k: int, message: Any) -> None:
        put(message.pose.pose.position, [3.0 * k, 4.0 * k, 1.8e6])
        put(message.twist.twist.linear, [0.0, 0.0, 0.0])

    changing(monkeypatch, TRUTH_TOPIC, change)
    truth = imported(flight).truth
    assert truth is not None
    # 5 m in 0.2 s.
    np.testing.assert_allclose(truth.gV, np.tile([15.0, 20.0, 0.0], (3, 1)), rtol=1e-6, atol=1e-6)


def no_rotation(message: Any) -> None:
    put(message.pose.pose.orientation, [0.0, 0.0, 0.0])
    message.pose.pose.orientation.w = 0.0


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda m: put(m.pose.pose.position, [np.nan, 0, 0]), "expected a position and a quaternion"),
        (lambda m: put(m.pose.pose.orientation, [0, np.inf, 0]), "expected a position and a quaternion"),
        (lambda m: put(m.twist.twist.linear, [0, 0, np.nan]), "expected finite velocities"),
        (no_rotation, "expected a position and a quaternion"),
    ],
    ids=["position", "attitude", "velocity", "zero quaternion"],
)
def test_what_is_no_state_is_refused_by_stamp(
    flight: Path, monkeypatch: pytest.MonkeyPatch, spoil: Callable[[Any], None], expected: str
) -> None:
    def change(k: int, message: Any) -> None:
        if k == 1:
            spoil(message)

    changing(monkeypatch, TRUTH_TOPIC, change)
    with pytest.raises(InputError, match=f"{TRUTH_TOPIC}, stamp {FRAMES_NS[1]}: {expected}"):
        imported(flight)
