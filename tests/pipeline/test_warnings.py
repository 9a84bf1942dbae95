"""Warnings: what is wrong is named, and nothing is said when all is as it should be."""

import numpy as np
import pytest

from craternav_fg.evaluation.innovations import Innovations
from craternav_fg.pipeline import warnings


def innovations(**nis: float) -> Innovations:
    """A hundred innovations of one dimension of each sensor."""
    count = 100 * len(nis)
    return Innovations(
        tuple(np.repeat(list(nis), 100)), np.arange(count), np.repeat(list(nis.values()), 100),
        np.ones(count, dtype=np.int64),
    )  # fmt: skip


def test_nothing_is_said_of_a_sound_run() -> None:
    assert warnings.failed_estimators({}) == []
    assert warnings.inconsistent_trajectories({"smoother": 0.1, "online": None, "dead_reckoning": 1.0}) == []
    assert warnings.inconsistent_sensors("ekf", innovations(imu=1.0, rims=1.3), {}, images=False) == []
    assert warnings.inconsistent_sensors("ekf", None, {}, images=False) == []
    assert warnings.replaced_states("given", ()) == []
    assert warnings.replaced_states("found", ()) == []
    assert warnings.frames_without_rims([3, 1, 2], [4, 1, 0]) == []
    assert warnings.frames_without_rims([3, 1, 2], None) == []


def test_estimators_whose_poses_the_rims_do_not_fit_are_named() -> None:
    (text,) = warnings.inconsistent_trajectories({"smoother": 0.2, "ekf": 0.514, "online": 1.0})
    assert "ekf (51 %), online (100 %)" in text
    assert "smoother" not in text


def test_the_sensor_that_contradicts_the_rest_is_named() -> None:
    (text,) = warnings.inconsistent_sensors(
        "ekf", innovations(imu=1.0, rims=1.4, sun=12.34), {}, images=False
    )
    assert text.startswith("sun: ")
    assert "NIS per dimension 12.3, expected 1" in text
    assert "sun.csv" in text


def test_camera_and_stamps_are_among_the_things_to_check() -> None:
    """A focal length that is 1 % off, or half a second between the clocks, contradicts the IMU first."""
    texts = [
        *warnings.inconsistent_sensors("ekf", innovations(imu=3.0, rims=3.0), {}, images=True),
        *warnings.contradicted_prior({"accelerometer bias": 7.0, "velocity": 7.0}, np.inf),
    ]
    assert len(texts) == 4
    for text in texts:
        assert "intrinsics" in text
        assert "lens" in text
        assert "time offset between camera and IMU" in text


def test_a_motion_model_is_among_the_things_to_check() -> None:
    """Its densities are guesses: they may be wrong where no IMU is, and too wide beside a sound sensor."""
    texts = warnings.inconsistent_sensors(
        "ekf", innovations(imu=3.0, star_tracker=0.4), {}, images=False, motion=True
    )
    assert len(texts) == 2
    for text in texts:
        assert "[motion] in dataset.toml" in text
    assert "units and noise" not in texts[0]


def test_replaced_initial_states_and_new_segments_are_told() -> None:
    replaced, lost = warnings.replaced_states("replaced", (12, 40))
    assert "initial state" in replaced
    assert lost.endswith("re-initialised at frame 12, 40")


@pytest.mark.parametrize(
    ("rims", "expected", "said"),
    [
        (
            [0, 2, 0, 0],
            [0, 3, 4, 5],
            ["no rim was found in 2 of 4 frames (the first: 2)", "in view in 1 of 4 frames (the first: 0)"],
        ),
        ([0, 0], [0, 3], ["in any frame, although 1 should show some"]),
        # Three rims in one of ten frames may be matched wrongly: nothing confirms them.
        ([0, 3] + 8 * [0], 10 * [4], ["no trajectory can be trusted, whatever its covariance: 1 of 10"]),
        # No front end ran: what should be seen is not known.
        ([2, 0, 0], None, ["no rim was measured in 2 of 3 frames (the first: 1)"]),
        ([0, 0], None, ["no rim was measured in 2 of 2 frames (the first: 0)"]),
    ],
)
def test_frames_without_rims_are_counted(
    rims: list[int], expected: list[int] | None, said: list[str]
) -> None:
    found = warnings.frames_without_rims(rims, expected)
    assert len(found) == len(said)
    for text, part in zip(found, said, strict=True):
        assert part in text
