"""Decisions of the tracker about one image, with front end and identification replaced."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.matching.gate import Matches
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline import tracking
from craternav_fg.pipeline.images_ahead import ImagesAhead
from craternav_fg.pipeline.relocalisation import PoseFix
from craternav_fg.pipeline.tracking import Tracker, _Guided, _Track
from craternav_fg.simulation.scenario import simulate
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import IntArray
from tests.descents import scenario


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate(scenario(duration_s=16.0), tmp_path_factory.mktemp("data") / "d"))


def first_frame(data: Dataset, rims: int) -> FrameMeasurement:
    assert data.measurements is not None
    frame = data.measurements[0]
    return dataclasses.replace(frame, rims=frame.rims.take(np.arange(rims)))


def tracker_of(data: Dataset) -> Any:
    tracker: Any = Tracker.__new__(Tracker)
    tracker.dataset = data
    tracker.front_end = SimpleNamespace(options=GuidedOptions())
    tracker._poor_frames = 0
    tracker._images = ImagesAhead(data)
    return tracker


def test_rims_that_fit_another_crater_as_well_are_left_out(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that the gate gives no crater are kept: it may have found no pose at all."""
    frame = first_frame(data, 5)
    rows = frame.rims.craters
    craters = np.array([rows[0], rows[0], -1, rows[3], 0 if rows[4] else 1])
    ambiguous = np.array([False, False, False, True, False])
    assert data.truth is not None
    gTb, covariance = data.truth.gTb[0], np.eye(6)
    monkeypatch.setattr(Dataset, "image", lambda self, index: None)
    monkeypatch.setattr(tracking, "match_rims", lambda *_: Matches(craters, ambiguous, gTb, covariance))
    tracker = tracker_of(data)
    tracker.front_end = SimpleNamespace(measure=lambda *_: frame)
    kept = tracker._guided(0, gTb, covariance).frame.rims.craters
    np.testing.assert_array_equal(kept, rows[[0, 2]])


@pytest.mark.parametrize(
    ("rims", "expected", "agrees"), [(3, 0, True), (2, 0, False), (5, 20, True), (5, 21, False)]
)
def test_an_image_agrees_with_enough_rims(
    data: Dataset, monkeypatch: pytest.MonkeyPatch, rims: int, expected: int, agrees: bool
) -> None:
    """Three at the least, and a quarter of those expected."""
    monkeypatch.setattr(Tracker, "_expected", lambda self, gTb: expected)
    guided = _Guided(first_frame(data, rims), np.eye(4))
    assert tracker_of(data)._agrees(guided) == agrees
    track: Any = SimpleNamespace(measured=[guided])
    assert _Track.supported.fget(track) == ([0] if rims >= 3 else [])  # type: ignore[attr-defined]


def test_identification_is_tried_less_and_less_often(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ground without any known crater is no lost track."""
    # At the first image at once; from 3 on, at the second, fourth and eighth.
    assert asked(data, monkeypatch, attitude_rad=1e-4, position_m=5.0) == [
        (k, True) for k in (0, 1, 4, 6, 10)
    ]


def test_identification_is_tried_in_every_image_that_nothing_guides(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Worn ground shows enough rims in a few images only. The whole map is asked less and less often."""
    tried = asked(data, monkeypatch, attitude_rad=0.02, position_m=4e3)
    assert [k for k, _ in tried] == [k for k in range(12) if k != 2]
    assert [k for k, whole in tried if whole] == [0, 1, 4, 6, 10]


def asked(
    data: Dataset, monkeypatch: pytest.MonkeyPatch, attitude_rad: float, position_m: float
) -> list[tuple[int, bool]]:
    """Images, of twelve of which only the third agrees, that are identified, and whether by the whole map."""
    tried: list[tuple[int, bool]] = []
    tracker = tracker_of(data)
    craters = len(data.catalog)

    def locate(index: int, sun_angle_rad: float | None, among: IntArray | None) -> None:
        assert among is None or 0 < len(among) <= craters
        tried.append((index, among is None))

    tracker.relocaliser = SimpleNamespace(locate=locate)
    monkeypatch.setattr(Tracker, "_expected", lambda self, gTb: 20)
    prior = filter_state.prior(Descent.of(data))
    covariance = prior.covariance.copy()
    covariance[:6, :6] = np.diag(np.repeat([attitude_rad, position_m], 3)) ** 2
    state = dataclasses.replace(prior, covariance=covariance)
    few, enough = first_frame(data, 4), first_frame(data, 5)
    monkeypatch.setattr(Tracker, "_sun_angle_rad", lambda *_: None)
    # The clock stands still.
    tracker.dataset = dataclasses.replace(data, stamps_ns=np.repeat(data.stamps_ns[:1], 12))
    for index in range(12):
        assert tracker._relocalise(index, state, enough if index == 2 else few) is None
    return tried


def test_an_identified_pose_that_only_confirms_is_not_used(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert data.truth is not None
    prior = filter_state.prior(Descent.of(data))
    covariance = prior.covariance.copy()
    covariance[:6, :6] = np.diag(np.repeat([1e-4, 5.0], 3)) ** 2
    state = dataclasses.replace(prior, gTb=data.truth.gTb[0], covariance=covariance)
    monkeypatch.setattr(Tracker, "_expected", lambda self, gTb: 20)
    spread = np.diag(np.repeat([1e-3, 10.0], 3)) ** 2
    away = state.gTb.copy()
    away[0, 3] += 500.0
    for gTb, had, shown, used in (
        (state.gTb, 1, 5, False),
        (away, 1, 5, True),
        # Too few rims, or no more than the prediction showed.
        (away, 1, 2, False),
        (away, 1, 3, True),
        (away, 4, 4, False),
        (away, 4, 5, True),
    ):
        tracker = tracker_of(data)
        fix = PoseFix(gTb, spread, 9)
        tracker.relocaliser = SimpleNamespace(locate=lambda *_, fix=fix: fix)
        there = _Guided(first_frame(data, shown), gTb)
        monkeypatch.setattr(Tracker, "_guided", lambda *_, there=there: there)
        found = tracker._relocalise(0, state, first_frame(data, had))
        assert (found is not None) == used
        assert found is None or (found[0] is fix and found[1] is there.frame)
    # After a poor prediction any pose helps, also one that agrees.
    covariance[:6, :6] = np.diag(np.repeat([0.1, 5e3], 3)) ** 2
    tracker.relocaliser = SimpleNamespace(locate=lambda *_: PoseFix(state.gTb, spread, 9))
    poor = dataclasses.replace(state, covariance=covariance)
    assert tracker._relocalise(0, poor, first_frame(data, 1)) is not None
