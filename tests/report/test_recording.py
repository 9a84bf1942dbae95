"""Recordings for the rerun viewer, where its library is installed."""

import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from craternav_fg.errors import CraternavError
from craternav_fg.reports.foxglove_recording import write_mcap
from craternav_fg.reports.recording import write_recording
from craternav_fg.runs.read import read_run
from tests.cli.calls import call


def test_a_recording_holds_trajectories_craters_camera_and_rims(made_run: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs rerun: pip install 'craternav_fg[viewer]'")
    path = tmp_path / "run.rrd"
    write_recording(read_run(made_run), path)
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for entity in ("world/trajectories/smoother", "world/trajectories/truth", "world/craters", "image/rims"):
        assert entity in printed


def test_a_mcap_recording_holds_map_camera_and_rims_at_the_stamps(made_run: Path, tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="needs foxglove-sdk: pip install 'craternav_fg[viewer]'")
    path = tmp_path / "run.mcap"
    run = read_run(made_run)
    write_mcap(run, path)
    schemas: dict[str, str] = {}
    stamps: dict[str, list[int]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            schemas[channel.topic] = schema.name
            stamps.setdefault(channel.topic, []).append(message.log_time)
    assert schemas == {
        "/map": "foxglove.SceneUpdate",
        "/tf": "foxglove.FrameTransform",
        "/camera/calibration": "foxglove.CameraCalibration",
        "/camera/rims": "foxglove.ImageAnnotations",
    }
    frames_ns = run.trajectories["smoother"].stamps_ns.tolist()
    assert stamps["/camera/rims"] == stamps["/camera/calibration"] == frames_ns
    assert stamps["/tf"] == [stamp for stamp in frames_ns for _ in range(2)]
    assert stamps["/map"] == frames_ns[:1]


def test_the_command_tells_the_viewer_by_the_suffix(made_run: Path, tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="needs foxglove-sdk: pip install 'craternav_fg[viewer]'")
    page, recording = tmp_path / "r.html", tmp_path / "run.mcap"
    done = call("report", made_run, "-o", page, "--recording", recording)
    assert done.code == 0, done.err
    assert recording.read_bytes().startswith(b"\x89MCAP0")
    assert call("report", made_run, "-o", page, "--recording", tmp_path / "run.bag").code == 2


def test_without_the_library_the_error_says_what_to_install(
    made_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(CraternavError, match=r"pip install 'craternav_fg\[viewer\]'"):
        write_recording(read_run(made_run), tmp_path / "run.rrd")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(CraternavError, match=r"pip install 'craternav_fg\[viewer\]'"):
        write_mcap(read_run(made_run), tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())
