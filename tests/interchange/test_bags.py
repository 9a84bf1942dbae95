"""Data sets through ROS bags and back, and bags that are wrong."""

import json
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset, write_dataset
from craternav_fg.dataset.description import description_toml
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.errors import InputError
from craternav_fg.interchange.bag_export import INFO_TOPIC, BagFormat, export_bag
from craternav_fg.interchange.bag_import import BagOptions, import_bag
from craternav_fg.interchange.bag_reading import CAMERA_INFO, Bag, image_of, open_bag
from craternav_fg.interchange.kalibr import kalibr_imu_yaml
from craternav_fg.trajectory import Trajectory
from tests.cli.calls import call
from tests.dataset.samples import FRAMES_NS, random_images, recording

pytest.importorskip("rosbags")


def dataset(folder: Path, bits: int = 8, **changes: object) -> Dataset:
    rng = np.random.default_rng(3)
    given = recording(rng)
    given = replace(given, camera=replace(given.camera, bit_depth=bits, **changes))
    images = random_images(rng)
    if bits > 8:
        images = [rng.integers(0, 2**bits, (48, 64), dtype=np.uint16) for _ in FRAMES_NS]
    write_dataset(folder, given, images)
    return Dataset.open(folder)


def options(data: Dataset, **changes: object) -> BagOptions:
    assert data.imu_noise is not None
    chosen = BagOptions(body=data.body, catalog=data.catalog, imu_noise=data.imu_noise, initial=data.initial)
    return replace(chosen, **changes)


def name_of(folder: Path, kind: BagFormat) -> Path:
    return folder / ("flight.bag" if kind == BagFormat.ROSBAG1 else "flight")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", BagFormat)
def test_stamps_pixels_and_numbers_survive(tmp_path: Path, kind: BagFormat, compressed: bool) -> None:
    data = dataset(tmp_path / "data")
    bag = name_of(tmp_path, kind)
    export_bag(data, bag, kind, compressed=compressed)
    report = import_bag(bag, tmp_path / "again", options(data))
    assert (report.frames, report.skipped, report.truth) == (3, 0, True)
    again = Dataset.open(tmp_path / "again")
    np.testing.assert_array_equal(again.stamps_ns, data.stamps_ns, strict=True)
    for k in range(3):
        np.testing.assert_array_equal(again.image(k), data.image(k), strict=True)
    assert data.imu is not None
    assert again.imu is not None
    for name in ("stamps_ns", "gyro_rad_s", "accelerometer_m_s2"):
        np.testing.assert_array_equal(getattr(again.imu, name), getattr(data.imu, name), strict=True)
    np.testing.assert_array_equal(again.sun.vectors, data.sun.vectors)
    np.testing.assert_array_equal(again.camera.lens, data.camera.lens)
    np.testing.assert_allclose(again.camera.bTc, data.camera.bTc, atol=1e-14)
    assert data.truth is not None
    assert again.truth is not None
    np.testing.assert_array_equal(again.truth.gP, data.truth.gP)
    np.testing.assert_allclose(again.truth.gRb, data.truth.gRb, atol=1e-14)
    np.testing.assert_allclose(again.truth.gV, data.truth.gV, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("rational", (0.1, -0.02, 1e-3, 0.0, 0.0, 0.2, 0.01, 0.0)), ("fisheye", (0.01, 0.0, 0.02, 0.0))],
)
def test_grey_levels_of_twelve_bits_and_other_lenses(
    tmp_path: Path, model: str, distortion: tuple[float, ...]
) -> None:
    data = dataset(tmp_path / "data", bits=12, distortion=distortion, lens_model=model)
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)
    import_bag(tmp_path / "flight", tmp_path / "again", options(data))
    again = Dataset.open(tmp_path / "again")
    assert (again.camera.lens_model, again.camera.bit_depth) == (model, 16)
    np.testing.assert_array_equal(again.camera.lens, data.camera.lens)
    np.testing.assert_array_equal(again.image(1), data.image(1), strict=True)
    # The bag does not say how many of the sixteen bits are used.
    import_bag(tmp_path / "flight", tmp_path / "given", options(data, camera=data.camera))
    assert Dataset.open(tmp_path / "given").camera.bit_depth == 12
    # Nor does Kalibr's camera chain, whose camera has 8 bits then.
    kalibr = replace(data.camera, bit_depth=8)
    import_bag(tmp_path / "flight", tmp_path / "kalibr", options(data, camera=kalibr))
    assert Dataset.open(tmp_path / "kalibr").camera.bit_depth == 16


def test_a_mcap_file_by_itself(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)
    file = next((tmp_path / "flight").glob("*.mcap"))
    import_bag(file, tmp_path / "again", options(data))
    np.testing.assert_array_equal(Dataset.open(tmp_path / "again").image(2), data.image(2))


def test_images_that_the_imu_does_not_cover_are_left_out(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    assert data.imu is not None
    short = replace(
        data.imu,
        stamps_ns=data.imu.stamps_ns[:25],
        gyro_rad_s=data.imu.gyro_rad_s[:25],
        accelerometer_m_s2=data.imu.accelerometer_m_s2[:25],
    )
    export_bag(replace(data, imu=short), tmp_path / "flight", BagFormat.ROSBAG2)
    report = import_bag(tmp_path / "flight", tmp_path / "again", options(data))
    assert (report.frames, report.skipped) == (2, 1)
    np.testing.assert_array_equal(Dataset.open(tmp_path / "again").stamps_ns, data.stamps_ns[:2])


def test_colours_become_grey(tmp_path: Path) -> None:
    class Message:
        class header:  # noqa: N801
            class stamp:  # noqa: N801
                sec, nanosec = 1, 2

        encoding, is_bigendian, height, width, step = "rgb8", 0, 1, 2, 8
        data = np.array([255, 0, 0, 0, 0, 255, 9, 9], np.uint8)

    # ITU-R BT.601: 0.299 red, 0.114 blue; the last two bytes pad the row.
    np.testing.assert_array_equal(image_of(tmp_path, Message), [[76, 29]])
    Message.encoding, Message.is_bigendian = "mono16", 1
    Message.width, Message.data = 4, np.array([1, 2, 0, 3, 0, 0, 255, 255], np.uint8)
    np.testing.assert_array_equal(image_of(tmp_path, Message), [[258, 3, 0, 65535]])


def damaged(tmp_path: Path, kind: BagFormat, change: object) -> tuple[Dataset, Path]:
    data = dataset(tmp_path / "data")
    bag = name_of(tmp_path, kind)
    export_bag(data, bag, kind)
    file = bag if bag.is_file() else next(file for file in bag.iterdir() if file.suffix != ".yaml")
    content = bytearray(file.read_bytes())
    file.write_bytes(change(content))
    return data, bag


@pytest.mark.parametrize("kind", BagFormat)
@pytest.mark.parametrize(
    "change",
    [
        lambda content: content[: len(content) // 2],
        lambda content: b"",
        lambda content: b"not a bag at all",
        lambda content: content[:200] + bytes(len(content) - 200),
    ],
    ids=["half", "empty", "text", "zeros"],
)
def test_a_damaged_bag_is_refused_in_one_line(tmp_path: Path, kind: BagFormat, change: object) -> None:
    data, bag = damaged(tmp_path, kind, change)
    with pytest.raises(InputError) as caught:
        import_bag(bag, tmp_path / "again", options(data))
    assert str(caught.value).startswith(str(bag))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize("kind", BagFormat)
def test_flipped_bytes_never_end_in_a_traceback(tmp_path: Path, kind: BagFormat) -> None:
    """Whatever is wrong is an `InputError`, or lies in pixels and numbers that no checksum guards."""
    data = dataset(tmp_path / "data")
    bag = name_of(tmp_path, kind)
    export_bag(data, bag, kind)
    file = bag if bag.is_file() else next(file for file in bag.iterdir() if file.suffix != ".yaml")
    content = file.read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(40):
        broken = bytearray(content)
        for at in rng.integers(0, len(content), 6):
            broken[at] ^= int(rng.integers(1, 256))
        file.write_bytes(broken)
        try:
            import_bag(bag, tmp_path / "again", options(data))
        except InputError:
            refused += 1
    # Both outcomes occur: otherwise the flips reach the container only, or nothing that is read.
    assert 5 <= refused <= 35


def test_only_what_reads_a_bag_may_call_it_damaged(tmp_path: Path) -> None:
    """A defect in what is done with the messages must show itself."""
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)

    def use() -> None:
        with open_bag(tmp_path / "flight") as bag:
            next(bag.messages("/imu0")).no_such_method()

    with pytest.raises(AttributeError):
        use()


def test_a_topic_of_the_sun_without_messages_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)
    read = Bag.messages
    monkeypatch.setattr(Bag, "messages", lambda bag, topic: iter(()) if topic == "/sun" else read(bag, topic))
    with pytest.raises(InputError, match="/sun: expected directions towards the sun, found none"):
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))


@pytest.mark.parametrize(
    "message",
    [
        {"format": "png", "data": np.zeros(0, np.uint8)},
        {"encoding": "rgb8", "is_bigendian": 0, "height": 0, "width": 4, "step": 12, "data": ()},
        {"encoding": "rgb8", "is_bigendian": 0, "height": 2, "width": 0, "step": 0, "data": ()},
    ],
    ids=["no bytes", "no rows", "no columns"],
)
def test_an_image_without_pixels_is_refused(tmp_path: Path, message: dict[str, object]) -> None:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2))
    with pytest.raises(InputError, match="image of stamp 1000000002: expected"):
        image_of(tmp_path, SimpleNamespace(header=header, **message))


def test_what_a_bag_lacks_is_named(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.ROSBAG2, estimates={"smoother": data.truth})
    with pytest.raises(InputError, match=r"one topic of poses, found /ground_truth/odometry, /smoother"):
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))
    other_imu = options(data, imu="/imu1", truth="/smoother/odometry")
    with pytest.raises(InputError, match="expected a topic of an IMU, one of /imu0, found /imu1"):
        import_bag(tmp_path / "flight", tmp_path / "again", other_imu)
    assert data.initial is not None
    late = options(data, initial=replace(data.initial, stamp_ns=5), truth="/smoother/odometry")
    with pytest.raises(InputError, match="first image's stamp"):
        import_bag(tmp_path / "flight", tmp_path / "again", late)
    with pytest.raises(InputError, match="bag is missing"):
        import_bag(tmp_path / "none.bag", tmp_path / "again", options(data))
    # Half a gigabyte of zeros has no end of a first line: it took 20 s to say so.
    with (tmp_path / "zeros.bag").open("wb") as stream:
        stream.truncate(1 << 29)
    began = time.process_time()
    with pytest.raises(InputError, match=r"zeros\.bag: expected a bag of ROS 1, found a file that"):
        import_bag(tmp_path / "zeros.bag", tmp_path / "again", options(data))
    assert time.process_time() - began < 2.0


def with_camera_infos(monkeypatch: pytest.MonkeyPatch, *infos: str, frame_id: str = "") -> None:
    """Rename the topics of CameraInfo: the others than the first are of another camera."""
    read_topics, read_messages = Bag.connected, Bag.messages

    def connected(bag: Bag, *types: str) -> list[str]:
        return sorted(infos) if types == (CAMERA_INFO,) else read_topics(bag, *types)

    def messages(bag: Bag, topic: str | None) -> Iterator[Any]:
        for message in read_messages(bag, INFO_TOPIC if topic in infos else topic):
            if topic in infos:
                message.header.frame_id = frame_id or message.header.frame_id
            yield message

    monkeypatch.setattr(Bag, "connected", connected)
    monkeypatch.setattr(Bag, "messages", messages)


@pytest.mark.parametrize(
    ("infos", "taken"),
    [
        (("/cam0/camera_info",), "/cam0/camera_info"),
        (("/cam0/camera_info", "/a/camera_info"), "/cam0/camera_info"),
        (("/other/camera_info",), "/other/camera_info"),
    ],
)
def test_the_camera_is_that_beside_the_images_or_the_only_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, infos: tuple[str, ...], taken: str
) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)
    with_camera_infos(monkeypatch, *infos)
    report = import_bag(tmp_path / "flight", tmp_path / "again", options(data))
    assert report.topics["camera"] == taken
    report = import_bag(tmp_path / "flight", tmp_path / "again", options(data, camera=data.camera))
    assert report.topics["camera"] is None


def test_no_other_camera_is_guessed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.MCAP)
    with monkeypatch.context() as patched:
        with_camera_infos(patched, "/a/camera_info", "/b/camera_info")
        several = "one CameraInfo beside /cam0/image_raw, found /a/camera_info, /b/camera_info: give --camera"
        with pytest.raises(InputError, match=several):
            import_bag(tmp_path / "flight", tmp_path / "again", options(data))
    with_camera_infos(monkeypatch, "/a/camera_info", frame_id="cam1")
    with pytest.raises(
        InputError, match=r"/a/camera_info: .* frame, cam0, found that of cam1: give --camera"
    ):
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))


def test_covariances_of_estimates_are_of_position_and_rotation_about_the_axes_of_g(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    assert data.truth is not None
    # The x axis of b points along the y axis of g, and y along z: a roll is a rotation about y of g.
    gTb = data.truth.gTb.copy()
    gTb[:, :3, :3] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    root = np.random.default_rng(2).standard_normal((3, 3))
    position_m2 = root @ root.T
    covariance = np.zeros((3, 6, 6))
    covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2] = 0.04, 0.0009, 0.0001
    covariance[:, 3:, 3:] = position_m2
    # An error of the roll goes with one of the position along x of g.
    covariance[:, 0, 3] = covariance[:, 3, 0] = 0.02
    estimate = replace(data.truth, gTb=gTb, pose_covariance=covariance)
    export_bag(data, tmp_path / "flight", BagFormat.MCAP, estimates={"smoother": estimate})
    with open_bag(tmp_path / "flight") as bag:
        message = list(bag.messages("/smoother/odometry"))[1]
    found = message.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(found[:3, :3], position_m2)
    np.testing.assert_array_equal(found[3:, 3:], np.diag([0.0001, 0.04, 0.0009]))
    expected = np.zeros((3, 3))
    expected[0, 1] = 0.02
    np.testing.assert_array_equal(found[:3, 3:], expected)
    np.testing.assert_array_equal(found[3:, :3], expected.T)


def command_line(folder: Path, data: Dataset) -> list[object]:
    """Import flight.bag by the files that the command asks for."""
    (folder / "dataset.toml").write_text(description_toml(data.body, data.initial))
    assert data.imu_noise is not None
    (folder / "imu.yaml").write_text(kalibr_imu_yaml(data.imu_noise, 100.0, "/imu0"))
    (folder / "sensor.yaml").write_text(camera_yaml(data.camera, 5.0))
    return [
        "import", "bag", folder / "flight.bag", "-o", folder / "again",
        "--description", folder / "dataset.toml", "--catalog", folder / "data/craters.csv",
        "--imu", folder / "imu.yaml", "--camera", folder / "sensor.yaml",
    ]  # fmt: skip


def first_two(track: Trajectory) -> Trajectory:
    return Trajectory(track.stamps_ns[:2], track.gTb[:2], track.gV[:2], track.bias[:2])


def test_what_does_not_open_is_not_kept(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    # Rates that only the reader of data sets refuses.
    assert data.imu is not None
    export_bag(
        replace(data, imu=replace(data.imu, gyro_rad_s=data.imu.gyro_rad_s + 1e4)),
        tmp_path / "flight.bag",
        BagFormat.ROSBAG1,
    )
    done = call(*command_line(tmp_path, data))
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    assert f"{tmp_path / 'again/mav0/imu0/data.csv'}:2: " in done.err
    assert "(from /imu0)" in done.err
    assert not list(tmp_path.glob("*again*"))


def test_a_wrong_truth_is_named_by_its_topic(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    assert data.truth is not None
    # Kilometres.
    gTb = data.truth.gTb.copy()
    gTb[:, :3, 3] *= 1e-3
    wrong = replace(data, truth=replace(data.truth, gTb=gTb))
    export_bag(wrong, tmp_path / "flight.bag", BagFormat.ROSBAG1)
    done = call(*command_line(tmp_path, data))
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    assert "(from /ground_truth/odometry: --truth-topic none takes none)" in done.err
    done = call(*command_line(tmp_path, data), "--truth-topic", "none")
    assert done.code == 0, done.err


def test_the_commands(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    done = call("export", "bag", tmp_path / "data", "-o", tmp_path / "flight.bag", "--format", "rosbag1")
    assert done.code == 0, done.err
    arguments = command_line(tmp_path, data)
    done = call(*arguments)
    assert done.code == 0, done.err
    assert "3 images, 41 IMU samples" in done.out
    again = Dataset.open(tmp_path / "again")
    assert isinstance(again.catalog, Catalog)
    assert again.imu_noise == data.imu_noise
    np.testing.assert_array_equal(again.camera.bTc, data.camera.bTc)
    assert again.initial is not None
    assert "truth: /ground_truth/odometry" in done.out
    assert "camera: " + str(tmp_path / "sensor.yaml") in done.out.replace("\n", "")
    # Truth that does not cover the images is not kept, and not claimed.
    assert data.truth is not None
    export_bag(replace(data, truth=first_two(data.truth)), tmp_path / "flight.bag", BagFormat.ROSBAG1)
    done = call(*arguments, "--force")
    assert "no truth is kept: /ground_truth/odometry does not cover the images" in done.err.replace("\n", " ")
    assert "truth: none" in done.out
    found = json.loads(call(*arguments, "--force", "--json").out)
    assert (found["truth"], found["topics"]["truth"]) == (False, None)
    # A direction of any length.
    assert call(*arguments, "--force", "--sun", "0,0,2").code == 0
    sun = Dataset.open(tmp_path / "again").sun.vectors
    # It turns with the spin, here hardly.
    np.testing.assert_allclose(sun, [[0.0, 0.0, 1.0]] * 3, atol=1e-6)
    done = call(*arguments, "--force", "--sun", "0,0,0")
    assert (done.code, done.err.count("\n")) == (2, 1)


def test_a_pipe_in_a_bag_is_refused(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.ROSBAG2)
    (file,) = (tmp_path / "flight").glob("*.db3")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(InputError, match="expected a file, found a pipe"):
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))


def test_a_bags_description_of_any_size_is_not_read(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data")
    export_bag(data, tmp_path / "flight", BagFormat.ROSBAG2)
    os.truncate(tmp_path / "flight" / "metadata.yaml", 2 << 20)
    with pytest.raises(InputError, match=r"metadata.yaml: expected at most 1 MiB, found 2"):
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))


@pytest.mark.parametrize("length", [1.5e8, 0.0, np.nan])
def test_the_suns_vectors_may_have_any_length_but_zero(tmp_path: Path, length: float) -> None:
    data = dataset(tmp_path / "data")
    scaled = replace(data.sun, vectors=length * data.sun.vectors)
    export_bag(replace(data, sun=scaled), tmp_path / "flight", BagFormat.ROSBAG2)
    if length > 0.0:
        import_bag(tmp_path / "flight", tmp_path / "again", options(data))
        again = Dataset.open(tmp_path / "again")
        np.testing.assert_allclose(again.sun.vectors, data.sun.vectors, atol=1e-15)
    else:
        with pytest.raises(InputError, match="expected directions"):
            import_bag(tmp_path / "flight", tmp_path / "again", options(data))
        assert not (tmp_path / "again").exists()
