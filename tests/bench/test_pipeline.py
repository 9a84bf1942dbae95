"""What the cost of a frame contains."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from craternav_fg.bench.pipeline import frame_costs
from craternav_fg.dataset import Dataset
from craternav_fg.pipeline import tracking
from craternav_fg.simulation.scenario import simulate
from craternav_fg.vision.guided import GuidedFrontEnd
from tests.descents import scenario


def test_a_frames_cost_is_that_of_all_that_the_tracker_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = Dataset.open(simulate(scenario(duration_s=16.0), tmp_path / "d"))
    assert data.measurements is not None
    frames = {one.stamp_ns: one for one in data.measurements}
    monkeypatch.setattr(
        GuidedFrontEnd, "measure", lambda self, image, stamp_ns, *_: dataclasses.replace(frames[stamp_ns])
    )
    monkeypatch.setattr(Dataset, "image", lambda self, frame: None)
    monkeypatch.setattr(tracking, "acquire", lambda *_: None)
    nowhere = SimpleNamespace(match=lambda *_: None, locate=lambda *_: None)
    monkeypatch.setattr("craternav_fg.bench.pipeline.Relocaliser", lambda dataset: nowhere)
    gated = []
    original = tracking.match_rims

    def gate(*given: Any) -> Any:
        gated.append(len(given[0]))
        return original(*given)

    monkeypatch.setattr(tracking, "match_rims", gate)
    costs = frame_costs(data)
    rims = [len(one.rims) for one in data.measurements]
    # The first frame is measured twice.
    assert gated == [rims[0], *rims]
    np.testing.assert_array_equal(costs[:, 2], rims[1:])
    assert np.all((costs[:, 1] >= 0.0) & (costs[:, 1] < costs[:, 0]))
