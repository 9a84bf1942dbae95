"""Hard cases come to what their scenarios say: what goes wrong shows, and what answers it answers it."""

from pathlib import Path

import numpy as np
import pytest

from craternav_fg.config import built_in_scenarios, load_scenario
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.reconstruction import reconstruct
from craternav_fg.simulation.scenario import simulate

CASES = [name for name in built_in_scenarios() if load_scenario(name).expected]


def check(name: str, folder: Path, trials: int) -> None:
    case = load_scenario(name)
    expected = case.expected
    found: dict[str, list[dict[str, float]]] = {e: [] for e in expected}
    for trial in range(trials):
        data = Dataset.open(simulate(case, folder / str(trial), trial=trial))
        result = reconstruct(data, list(expected))
        for e in expected:
            found[e].append(metrics(result.trajectories[e], data.truth).as_dict())  # type: ignore[arg-type]
    for e, bounds in expected.items():
        for figure, interval in bounds.model_dump(exclude_none=True).items():
            mean = float(np.mean([each[figure] for each in found[e]]))
            assert interval[0] <= mean <= interval[1], f"{name}: {figure} of {e} is {mean:.3g}"


@pytest.mark.parametrize("name", ["hard_wrong_matches", "hard_mounting", "hard_map_errors"])
def test_a_hard_case_is_as_expected(name: str, tmp_path: Path) -> None:
    check(name, tmp_path, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_hard_case_is_as_expected(name: str, tmp_path: Path) -> None:
    check(name, tmp_path, 5)
