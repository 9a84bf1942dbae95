"""Figures of scenarios with `[expected]`: `python -m tests.pipeline.hard_cases NAME...` measures them.

They are those of 20 trials, whatever a scenario names.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import Metrics, metrics
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario

FIGURES = ("position_rms_m", "anees")


def run_trials(name: str, folder: Path, trials: int) -> dict[str, list[Metrics]]:
    """Metrics of the first trials of a scenario, for each estimator of which it expects something."""
    case = load_scenario(name)
    found: dict[str, list[Metrics]] = {e: [] for e in case.expected}
    for trial in range(trials):
        data = Dataset.open(simulate(case, folder / str(trial), trial=trial))
        result = reconstruct(data, list(case.expected))
        for e in case.expected:
            found[e].append(metrics(result.trajectories[e], data.truth))
    return found


def _print(name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = run_trials(name, Path(folder), 20)
    for e, trials in found.items():
        sys.stdout.write(f"# {name}\n[expected.{e}]\n")
        for figure in FIGURES:
            values = np.array([getattr(each, figure) for each in trials])
            sys.stdout.write(f"{figure} = {{ mean = {values.mean():.3g}, sd = {values.std(ddof=1):.3g} }}\n")


if __name__ == "__main__":
    for wanted in sys.argv[1:]:
        _print(wanted)
