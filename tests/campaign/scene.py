"""A scenario small enough for many trials, and what the tests ask of a campaign's folder."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import tomli_w

from craternav_fg.campaign.run import CampaignOptions
from craternav_fg.simulation.scenario_file import Scenario
from tests import descents

ESTIMATORS = ("ekf", "dead_reckoning")
TIMES = {"wall_s", "time_per_trial_s"}


def small_scenario(**sections: object) -> Scenario:
    """Six frames with a handful of rims each."""
    return descents.scenario(duration_s=10.0, **sections)


def options(trials: int, **changes: Any) -> CampaignOptions:
    """Options of a small campaign."""
    return CampaignOptions(**{"trials": trials, "estimators": ESTIMATORS, **changes})


def write_scenario(path: Path, scenario: Scenario) -> Path:
    """Write a scenario file."""
    path.write_text(tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True)))
    return path


def without_times(summary: Any) -> Any:
    """Return a summary's figures that do not depend on the clock."""
    if not isinstance(summary, dict):
        return summary
    return {key: without_times(value) for key, value in summary.items() if key not in TIMES}


def contents(folder: Path) -> dict[str, Any]:
    """Return all that a campaign must hold the same whenever it is run: every file, whole."""
    files: dict[str, Any] = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("times.jsonl", "summary.json")
    }
    if (folder / "summary.json").exists():
        files["summary.json"] = without_times(json.loads((folder / "summary.json").read_text()))
    return files


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """Start the command in a process group of its own."""
    command = [sys.executable, "-m", "craternav_fg", "montecarlo", *map(str, arguments)]
    chosen = [part for name in ESTIMATORS for part in ("-e", name)]
    return subprocess.Popen(
        [*command, *chosen],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def group_is_gone(group: int, patience_s: float = 20.0) -> bool:
    """Whether all processes of a group have ended, or do so soon."""
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    os.killpg(group, signal.SIGKILL)
    return False


def until_trials(folder: Path, count: int, patience_s: float = 120.0) -> None:
    """Wait until so many trials are there."""
    until = time.monotonic() + patience_s
    while len(list((folder / "trials").glob("trial_*.parquet"))) < count:
        assert time.monotonic() < until, f"no {count} trials in {folder}"
        time.sleep(0.02)
