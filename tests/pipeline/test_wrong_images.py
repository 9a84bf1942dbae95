"""Images that are not of their stamps: stale, exchanged, or copies; and tracks that were lost indeed."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import write_image
from craternav_fg.errors import InputError
from craternav_fg.estimators.base import Descent
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline import input_warnings
from craternav_fg.pipeline.initial_state import find_initial
from craternav_fg.pipeline.measuring import Measured
from craternav_fg.pipeline.relocalisation import PoseFix
from craternav_fg.pipeline.repeated_images import repeated_images
from craternav_fg.pipeline.sensor_checks import check_imu
from craternav_fg.pipeline.tracking import Segment, Tracked, Tracker, _Guided
from craternav_fg.simulation.scenario import simulate
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.guided_options import GuidedOptions
from tests.descents import scenario

DARK = -1
SPREAD = np.diag([1e-3] * 3 + [10.0] * 3) ** 2


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate(scenario(duration_s=48.0), tmp_path_factory.mktemp("data") / "d"))


def tracked(
    data: Dataset,
    shown: Sequence[int],
    monkeypatch: pytest.MonkeyPatch,
    repeated: Sequence[int] = (),
    *,
    with_sun: bool = False,
) -> Tracked:
    """Track images of which the k-th shows what frame shown[k] should, to who looks near its pose."""
    assert data.measurements is not None
    assert data.truth is not None
    measured, truth = data.measurements, data.truth

    def guided(self: Tracker, index: int, gTb: np.ndarray, covariance: np.ndarray) -> _Guided:
        there = shown[index]
        seen = there != DARK and np.linalg.norm(gTb[:3, 3] - truth.gP[there]) < 100.0
        rims = measured[there].rims if seen else RimSet.empty()
        sun = measured[there].sun if seen and with_sun else None
        return _Guided(FrameMeasurement(int(data.stamps_ns[index]), rims, sun), gTb)

    def locate(index: int, *_: object) -> PoseFix | None:
        return None if shown[index] == DARK else PoseFix(truth.gTb[shown[index]], SPREAD, 9)

    monkeypatch.setattr(Tracker, "_guided", guided)
    monkeypatch.setattr("craternav_fg.pipeline.tracking.acquire", lambda *_: None)
    monkeypatch.setattr(Dataset, "image", lambda self, index: None)
    relocaliser: Any = SimpleNamespace(
        locate=locate, match=lambda index, *_: locate(index) if shown[index] == index else None
    )
    front_end: Any = SimpleNamespace(options=GuidedOptions())
    return Tracker(data, Descent.of(data), front_end, relocaliser, repeated).run(lambda *_: None)


def with_rims(result: Tracked) -> list[int]:
    return [k for k, frame in enumerate(result.frames) if len(frame.rims)]


def test_one_image_does_not_replace_the_track(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    every = list(range(len(data)))
    assert with_rims(tracked(data, every, monkeypatch)) == every
    # Stale by one and by two, and two that are exchanged: the second is identified.
    for wrong in ({4: 3, 5: 3}, {4: 5, 5: 4}):
        result = tracked(data, [wrong.get(k, k) for k in every], monkeypatch)
        assert len(result.segments) == 1
        assert list(result.disbelieved) == [5]
        assert with_rims(result) == [k for k in every if k not in wrong]
        assert data.truth is not None
        assert np.linalg.norm(result.guides[:, :3, 3] - data.truth.gP, axis=1)[1:].max() < 100.0


def test_what_no_later_frame_confirms_is_not_believed(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    every = list(range(len(data)))
    last = every[-1]
    result = tracked(data, [*every[:-2], 3, 3], monkeypatch)
    assert len(result.segments) == 1
    assert list(result.disbelieved) == [last]
    assert with_rims(result) == every[:-2]


def lost(data: Dataset) -> Dataset:
    """Let the accelerometer be wrong by 30 m/s^2 for 8 s of darkness."""
    assert data.imu is not None
    force = data.imu.accelerometer_m_s2.copy()
    time_s = 1e-9 * (data.imu.stamps_ns - data.stamps_ns[0])
    force[(time_s > 9.0) & (time_s < 17.0), 0] += 30.0
    return dataclasses.replace(data, imu=dataclasses.replace(data.imu, accelerometer_m_s2=force))


def test_a_track_that_is_lost_is_replaced_once_two_frames_confirm(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = [DARK if 3 <= k < 10 else k for k in range(len(data))]
    result = tracked(lost(data), shown, monkeypatch)
    assert result.disbelieved == {}
    assert [segment.first for segment in result.segments] == [0, 10]
    assert with_rims(result) == [k for k in range(len(data)) if shown[k] != DARK]


@pytest.mark.parametrize("sigma_m", [4000.0, 30.0])
def test_a_first_image_with_few_rims_that_later_ones_contradict_is_left_out(
    data: Dataset, monkeypatch: pytest.MonkeyPatch, sigma_m: float
) -> None:
    """Near a wide prior, chance finds a few; all frames are then one track, with the prior if that fits."""
    assert data.initial is not None
    assert data.truth is not None
    every = range(len(data))
    initial = data.initial
    if sigma_m < 1000.0:
        gTb = data.truth.gTb[5].copy()
        initial = dataclasses.replace(initial, gTb=gTb, position_sigma_m=sigma_m, attitude_sigma_rad=1e-3)
    wrong = dataclasses.replace(data, initial=initial)
    result = tracked(wrong, [5 if k == 0 else k for k in every], monkeypatch)
    assert 3 <= len(result.disbelieved[0].rims) < 7
    assert list(result.disbelieved) == [0]
    assert with_rims(result)[0] <= 2
    assert [segment.first for segment in result.segments] == [0]
    assert (result.segments[0].initial is initial) == (sigma_m > 1000.0)
    off_m = np.linalg.norm(result.segments[0].initial.gTb[:3, 3] - data.truth.gP[0])
    assert off_m < 3.0 * np.sqrt(3.0) * result.segments[0].initial.position_sigma_m


def test_a_copy_while_two_tracks_compete_belongs_to_both(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = list(range(len(data)))
    # The second stale image begins a track; the third is a copy, which decides nothing.
    shown = [3 if k in (4, 5, 6) else k for k in every]
    result = tracked(data, shown, monkeypatch, repeated=(6,))
    assert len(result.frames) == len(data)
    assert len(result.segments) == 1
    assert list(result.disbelieved) == [5]
    assert with_rims(result) == [k for k in every if k not in (4, 5, 6)]


def test_what_sensors_measured_between_images_predicts_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Images are searched near poses that know of the star tracker, dark ones as well."""
    tracker = {"rate_hz": 1.0, "cross_sigma_arcsec": 15.0, "roll_sigma_arcsec": 70.0}
    case = scenario(duration_s=24.0, sensors={"star_tracker": tracker})
    known = Dataset.open(simulate(case, tmp_path / "d"))
    assert known.imu is not None
    assert known.truth is not None
    assert known.initial is not None
    # The gyro drifts by a degree in ten seconds.
    wrong = known.imu.gyro_rad_s + np.array([2e-3, 0.0, 0.0])
    initial = dataclasses.replace(known.initial, gyro_bias_sigma_rad_s=2e-3)
    drifts = dataclasses.replace(known, imu=dataclasses.replace(known.imu, gyro_rad_s=wrong), initial=initial)
    result = tracked(drifts, [k if k < 3 else DARK for k in range(len(known))], monkeypatch)
    turns = np.einsum("kji,kjl->kil", result.guides[:, :3, :3], known.truth.gRb)
    off_rad = np.arccos(np.clip(0.5 * (np.trace(turns, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    assert off_rad[4:].max() < 5e-4


def test_the_only_image_contradicts_the_initial_state(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no others whose sun tilts would have the same error."""
    assert data.initial is not None
    assert data.truth is not None
    gTb = data.initial.gTb.copy()
    gTb[:3, 3] += [0.0, 20e3, 15e3]
    wrong = dataclasses.replace(data.initial, gTb=gTb, position_sigma_m=100.0, attitude_sigma_rad=1e-3)
    for count in (1, 3):
        result = tracked(first(data, count, wrong), range(count), monkeypatch, with_sun=True)
        assert with_rims(result) == list(range(count))
        assert [segment.first for segment in result.segments] == [0]
        assert np.linalg.norm(result.segments[0].initial.gTb[:3, 3] - data.truth.gP[0]) < 100.0
        tilts = [frame.sun.sigma_rad for frame in result.frames if frame.sun is not None]
        assert data.measurements is not None
        given = [one.sun.sigma_rad for one in data.measurements[:count] if one.sun is not None]
        np.testing.assert_allclose(tilts, [given[0], *(np.sqrt(2.0) * sigma for sigma in given[1:])])


def first(data: Dataset, count: int, initial: InitialState) -> Dataset:
    """The first frames of a data set, with another initial state."""
    assert data.measurements is not None
    return dataclasses.replace(
        data, initial=initial, stamps_ns=data.stamps_ns[:count], measurements=data.measurements[:count]
    )


def test_copies_of_images_are_left_out(
    data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = list(range(len(data)))
    shown = [3 if k in (4, 5) else k for k in every]
    result = tracked(data, shown, monkeypatch, repeated=(4, 5))
    assert (len(result.segments), result.disbelieved) == (1, {})
    assert with_rims(result) == [k for k in every if k not in (4, 5)]
    paths = [tmp_path / f"{k}.png" for k in range(6)]
    for path, content in zip(paths, (b"one", b"two", b"one", b"longer", b"six", b"two"), strict=True):
        path.write_bytes(content)
    assert repeated_images(paths) == {2: 0, 5: 1}
    assert repeated_images([*paths[:2], tmp_path / "missing.png"]) == {}


def test_images_of_one_grey_level_are_no_copies(tmp_path: Path) -> None:
    """The night side is black in every image; a lone bright pixel twice is a copy."""
    star = np.zeros((8, 8), np.uint8)
    star[3, 4] = 9
    paths = [tmp_path / f"{k}.png" for k in range(4)]
    for path, image in zip(paths, (np.zeros_like(star), star, np.zeros_like(star), star), strict=True):
        write_image(path, image)
    assert repeated_images(paths) == {3: 1}


def test_no_velocity_is_taken_from_a_copy(data: Dataset) -> None:
    assert data.truth is not None
    poses = data.truth.gTb[[0, 0, 2]]
    relocaliser: Any = SimpleNamespace(locate=lambda index: PoseFix(poses[index], SPREAD, 9))
    initial = find_initial(data, relocaliser, lambda done: None, repeated={1: 0})
    assert np.linalg.norm(initial.gV - data.truth.gV[0]) < 5.0


def test_frames_that_were_left_out_tell_the_unit_of_the_imu(data: Dataset) -> None:
    assert data.imu is not None
    assert data.measurements is not None
    in_deg = dataclasses.replace(
        data, imu=dataclasses.replace(data.imu, gyro_rad_s=np.degrees(data.imu.gyro_rad_s))
    )
    descent = Descent.of(in_deg)
    left_out = {k: one for k, one in enumerate(data.measurements) if k > 0}
    kept = tuple(
        dataclasses.replace(one, rims=RimSet.empty(), sun=None) if k in left_out else one
        for k, one in enumerate(data.measurements)
    )
    measured = Measured(kept, (Segment(0, descent.initial),), disbelieved=left_out)
    check_imu(measured.problems(descent), Path("data"))
    with pytest.raises(InputError, match="w_RS_S_x: expected rad/s, found deg/s"):
        check_imu(measured.every.problems(descent), Path("data"))


def test_wrong_images_are_named() -> None:
    (text,) = input_warnings.repeated_images({f"{k}.png": "0.png" for k in range(1, 8)})
    assert "1.png (same pixels as 0.png), 2.png" in text
    assert "and 2 more" in text
    (text,) = input_warnings.disbelieved_frames({7: "frame_0007.png"})
    assert "frame 7 (frame_0007.png) contradict the IMU" in text
    assert input_warnings.repeated_images({}) == input_warnings.disbelieved_frames({}) == []
