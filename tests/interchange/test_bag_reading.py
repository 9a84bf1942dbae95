"""Messages of a bag that cannot be taken: stamps that go back, cameras without a calibration."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg import lens
from craternav_fg.errors import InputError
from craternav_fg.interchange.bag_reading import camera_of, increasing_stamps

BAG: Any = SimpleNamespace(path=Path("flight"))


def test_stamps_increase_or_the_first_that_does_not_is_named() -> None:
    assert increasing_stamps(BAG, "/imu", [3, 5, 6]).tolist() == [3, 5, 6]
    for stamps, found in (([3, 5, 5, 9], "found 5 after 5"), ([3, 9, 4, 5, 1], "found 4 after 9")):
        with pytest.raises(InputError, match=f"^flight: /imu: expected stamps that increase, {found} ns"):
            increasing_stamps(BAG, "/imu", stamps)


def info(**changes: object) -> SimpleNamespace:
    """`CameraInfo` as ROS 1 spells it."""
    K = [800.0, 0.0, 330.0, 0.0, 801.0, 240.0, 0.0, 0.0, 1.0]
    message = {"width": 640, "height": 480, "K": K, "D": [], "distortion_model": "", **changes}
    return SimpleNamespace(**message)


@pytest.mark.parametrize("spelling", [str.upper, str.lower])
def test_a_calibration_of_either_version_is_a_camera(spelling: Any) -> None:
    message = info(distortion_model="plumb_bob")
    changed = {spelling("k"): message.K, spelling("d"): [-0.1, 0.02, 1e-3, -2e-3]}
    message = SimpleNamespace(**{k: v for k, v in vars(message).items() if k not in "KD"}, **changed)
    camera = camera_of(BAG.path, message, np.eye(4), 12)
    assert (camera.width_px, camera.height_px, camera.bit_depth) == (640, 480, 12)
    # The principal point is the image of the axis; a pixel of 1 / f beside it is one of 1 / f rad.
    undistorted = camera_of(BAG.path, info(), np.eye(4), 8)
    at = undistorted.normalised(np.array([[330.0, 240.0], [331.0, 240.0], [330.0, 241.0]]))
    np.testing.assert_allclose(at, [[0.0, 0.0], [1.0 / 800.0, 0.0], [0.0, 1.0 / 801.0]], atol=1e-9)
    assert camera.lens_model == undistorted.lens_model == lens.RADIAL_TANGENTIAL
    # A third radial coefficient of zero.
    five = info(distortion_model="plumb_bob", D=[-0.1, 0.02, 1e-3, -2e-3, 0.0])
    pixel = np.array([[600.0, 20.0]])
    expected = camera_of(BAG.path, five, np.eye(4), 12).normalised(pixel)
    np.testing.assert_array_equal(camera.normalised(pixel), expected)
    assert np.abs(expected - undistorted.normalised(pixel)).max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"K": [0.0] * 9}, "expected a calibrated CameraInfo, found no focal length"),
        ({"K": []}, "expected a calibrated CameraInfo, found no focal length"),
        ({"D": [float("nan")] * 5}, "expected a calibrated CameraInfo, found numbers that are not finite"),
        ({"distortion_model": "fancy"}, "expected a lens that is known, found 'fancy'"),
        ({"distortion_model": "plumb_bob", "D": [0.1, 0.2]}, "CameraInfo: "),
    ],
)
def test_a_camera_without_a_calibration_is_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(InputError, match=f"^flight: {problem}"):
        camera_of(BAG.path, info(**changes), np.eye(4), 8)


def test_regions_and_binned_pixels_are_those_of_the_images() -> None:
    """A ray falls where it does on the whole sensor, whatever part of it is read out and binned."""
    region = SimpleNamespace(x_offset=100, y_offset=40, width=400, height=300)
    whole = camera_of(BAG.path, info(), np.eye(4), 8)
    part = camera_of(BAG.path, info(roi=region, binning_x=4, binning_y=2), np.eye(4), 8)
    assert (part.width_px, part.height_px) == (100, 150)
    # The corner of the first pixel that is read out, and of the last one.
    on_sensor = np.array([[99.5, 39.5], [499.5, 339.5]])
    in_image = np.array([[-0.5, -0.5], [99.5, 149.5]])
    np.testing.assert_allclose(part.normalised(in_image), whole.normalised(on_sensor), atol=1e-12)
    empty = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    same = camera_of(BAG.path, info(roi=empty, binning_x=0, binning_y=1), np.eye(4), 8)
    assert (same.width_px, same.fx_px, same.cx_px) == (whole.width_px, whole.fx_px, whole.cx_px)
