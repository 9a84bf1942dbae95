"""Recordings for the rerun viewer, where its library is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

from craternav_fg.errors import CraternavError
from craternav_fg.reports.recording import write_recording
from craternav_fg.runs.read import read_run


def test_a_recording_holds_trajectories_craters_camera_and_rims(made_run: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs rerun: pip install -e '.[viewer]'")
    path = tmp_path / "run.rrd"
    write_recording(read_run(made_run), path)
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for entity in ("world/trajectories/smoother", "world/trajectories/truth", "world/craters", "image/rims"):
        assert entity in printed


def test_without_the_library_the_error_says_what_to_install(
    made_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(CraternavError, match=r"pip install -e .\.\[viewer\]"):
        write_recording(read_run(made_run), tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())
