"""What tracked points add where there are no craters: `python -m tests.sensors.gap_bounds` prints the table.

The bounds are those of `docs/hard_cases.md`, of one descent (trial 0) without craters for two minutes.
"""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario

# Scenario with the gap, and those whose IMU is taken, with the numbers of tracks.
GAP = "hard_craterless"
CASES = {
    GAP: (40, 100, 300),
    "hard_imu_worse": (40, 100),
    "hard_craterless_mems": (40, 100, 200),
}


def gap_bounds(scenario: str, tracks: int, folder: Path) -> dict[str, tuple[float, float]]:
    """Position RMS in the gap, m, without points and with them: `filtered` and `smoothed` bounds."""
    gap = load_scenario(GAP)
    features = {**gap.sensors["features"], "simulation": {"count": tracks}}
    case = load_scenario(scenario).model_copy(
        update={"sensors": {"features": features}, "faults": gap.faults}
    )
    ((begin_s, end_s),) = gap.faults.craterless_s
    data = Dataset.open(simulate(case, folder, trial=0))
    assert data.measurements is not None
    assert data.truth is not None
    frames, descent = list(data.measurements), Descent.of(data)
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    truth = data.truth.take(np.searchsorted(data.truth.stamps_ns, stamps_ns))
    inside = (1e-9 * stamps_ns >= begin_s) & (1e-9 * stamps_ns < end_s)
    bounds = [
        posterior_bound(replace(descent, features=one), frames, truth) for one in (None, descent.features)
    ]
    found = {}
    for kind in ("filtered", "smoothed"):
        without, beside = (
            float(np.sqrt(np.mean(position_rms_m(getattr(one, kind)[inside]) ** 2))) for one in bounds
        )
        found[kind] = without, beside
    return found


def rows() -> Iterator[str]:
    """Lines of the table."""
    for scenario, counts in CASES.items():
        for tracks in counts:
            with tempfile.TemporaryDirectory() as work:
                found = gap_bounds(scenario, tracks, Path(work) / "data")
            cells = [f"{a:.1f}, {b:.1f} m, {b / a:.2f}" for a, b in found.values()]
            yield f"| {scenario} | {tracks} | {' | '.join(cells)} |"


if __name__ == "__main__":
    for row in rows():
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()
