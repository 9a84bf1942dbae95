"""A campaign that is killed, interrupted: what is finished stays, and a rerun does the rest."""

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.campaign import run
from craternav_fg.campaign.run import montecarlo
from tests.campaign import inline
from tests.campaign.scene import (
    contents,
    group_is_gone,
    options,
    small_scenario,
    start,
    until_trials,
    write_scenario,
)

TRIALS = 12


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenario file."""
    return write_scenario(tmp_path_factory.mktemp("case") / "small.toml", small_scenario())


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All trials, without a disturbance."""
    folder = tmp_path_factory.mktemp("campaign") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "processes", inline.processes)
        montecarlo(small_scenario(), folder, options(TRIALS))
    return folder


def kill(case: Path, folder: Path, after_s: float) -> bool:
    """Start a campaign and kill -9 its process; tell whether it was still at work."""
    campaign = start(case, "-n", TRIALS, "-o", folder, "--workers", 2)
    try:
        campaign.wait(timeout=after_s)
    except subprocess.TimeoutExpired:
        campaign.kill()
    campaign.communicate()
    # The workers see it and end, too.
    assert group_is_gone(campaign.pid)
    return campaign.returncode == -signal.SIGKILL


def test_killed_and_run_again_it_is_the_same(
    case: Path, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "c"
    campaign = start(case, "-n", TRIALS, "-o", folder, "--workers", 2)
    until_trials(folder, 3)
    campaign.kill()
    campaign.communicate()
    assert group_is_gone(campaign.pid)
    finished = {path: path.stat().st_mtime_ns for path in (folder / "trials").glob("trial_*")}
    assert 3 <= len(finished) < TRIALS
    monkeypatch.setattr(run, "processes", inline.processes)
    montecarlo(small_scenario(), folder, options(TRIALS))
    assert contents(folder) == contents(undisturbed)
    assert {path: path.stat().st_mtime_ns for path in finished} == finished


@pytest.mark.slow
def test_killed_at_twenty_random_moments_it_is_the_same(
    case: Path, undisturbed: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(20)
    began = time.perf_counter()
    assert not kill(case, tmp_path / "timed", 600.0)
    whole_s = time.perf_counter() - began
    at_work = 0
    for k in range(20):
        folder = tmp_path / f"c{k}"
        at_work += kill(case, folder, rng.uniform(0.0, whole_s))
        montecarlo(small_scenario(), folder, options(TRIALS, workers=2))
        assert contents(folder) == contents(undisturbed)
    assert at_work > 10


def test_ctrl_c_ends_in_one_line_and_finished_trials_stay(
    case: Path, undisturbed: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "c"
    campaign = start(case, "-n", 1000, "-o", folder, "--workers", 2)
    until_trials(folder, 2)
    # A terminal tells all processes of the group.
    os.killpg(campaign.pid, signal.SIGINT)
    out, said = campaign.communicate(timeout=30.0)
    assert campaign.returncode == 130
    assert out == ""
    assert said == "craternav: interrupted; finished trials are kept; the same command resumes\n"
    assert group_is_gone(campaign.pid)
    expected = contents(undisturbed)
    found = contents(folder)
    assert len(found) >= 3
    for name, content in found.items():
        if name in expected:
            assert content == expected[name]
