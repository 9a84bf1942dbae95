"""Commands that compare a run with a reference."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.simulation.scenario import simulate
from tests.cli.calls import call
from tests.descents import scenario

HIGHER_M, SIGMA_M = 400.0, 200.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose data set states the lander 400 m too high, to 200 m per axis."""
    folder = tmp_path_factory.mktemp("apriori")
    mav0 = simulate(scenario(duration_s=6.0), folder / "data") / "mav0"
    head, *rows = csv.reader(
        (mav0 / "state_groundtruth_estimate0" / "data.csv").read_text(encoding="utf-8").splitlines()
    )
    stated = mav0 / "state_apriori0"
    stated.mkdir()
    lines = [",".join(head)]
    for row in rows:
        P = np.array(row[1:4], dtype=np.float64)
        higher = P * (1.0 + HIGHER_M / np.linalg.norm(P))
        lines.append(",".join([row[0], *map(repr, higher.tolist()), *row[4:]]))
    (stated / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    sigmas = f"sensor_type: apriori\nposition_sigma_m: {SIGMA_M}\nattitude_sigma_rad: 0.01\n"
    (stated / "sensor.yaml").write_text(sigmas, encoding="utf-8")
    call("reconstruct", folder / "data", "-o", folder / "run", "-e", "smoother")
    return folder / "run"


def test_apriori_states_have_errors_of_their_own(run: Path) -> None:
    """A trajectory known to metres is 2 sigmas from a state known to 200 m, not 100."""
    found = json.loads(call("evaluate", "apriori", run, "--json").out)
    offsets_m, sigma_m = np.array(found["east_north_up_m"]), np.array(found["sigma_m"])
    assert found["reference_sigma_m"] == SIGMA_M
    assert np.abs(offsets_m[:, 2] + HIGHER_M).max() < 50.0
    assert sigma_m[:, 2].max() < 0.1 * SIGMA_M
    said = call("evaluate", "apriori", run).out
    largest = np.max(np.abs(offsets_m) / np.hypot(sigma_m, SIGMA_M))
    assert 1.7 < largest < 2.3
    assert f"largest difference {largest:.1f} sigmas of both (states: 200 m)" in said
