"""Warming up compiles what a reconstruction needs, in other processes where that is asked."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from craternav_fg.runs import warm_up
from tests.test_doc_commands import SMALL

ROOT = Path(__file__).resolve().parents[2]

# Runs the commands of a list and prints the names of the kernels that were compiled on the way.
WATCHED = """
import json, sys
from numba.core import event
from typer.testing import CliRunner

class Compiled(event.Listener):
    names = []
    def on_start(self, one):
        self.names.append(one.data["dispatcher"].py_func.__qualname__)
    def on_end(self, one):
        pass

event.register("numba:compile", Compiled())
from craternav_fg.cli.app import app
for words in json.loads(sys.argv[1]):
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output + repr(done.exception)
print(json.dumps(Compiled.names))
"""


def in_cold_cache(cache: Path, *words: str) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *words], env=environment, cwd=cache, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_an_empty_cache_is_cold(tmp_path: Path) -> None:
    asked = "from craternav_fg.runs.warm_up import is_warm; print(is_warm())"
    assert in_cold_cache(tmp_path, "-c", asked) == "False\n"


def test_no_process_is_started_for_kernels_that_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    class Process:
        def __init__(self, **_: object) -> None:
            started.append("made")

        def start(self) -> None:
            started.append("started")

        def join(self) -> None:
            started.append("joined")

        def terminate(self) -> None:
            started.append("ended")

    monkeypatch.setattr("multiprocessing.context.SpawnContext.Process", Process)
    monkeypatch.setattr(warm_up, "is_warm", lambda: True)
    with warm_up.warming_up():
        pass
    assert started == []
    monkeypatch.setattr(warm_up, "is_warm", lambda: False)
    with warm_up.warming_up():
        started.append("work")
    two = [[each] * 2 for each in ("made", "started", "joined", "ended", "joined")]
    assert started == [*two[0], *two[1], "work", *two[2], *two[3], *two[4]]
    # Nobody waits for them when the work has failed.
    started.clear()
    with pytest.raises(ValueError, match="failed"), warm_up.warming_up():
        raise ValueError("failed")
    assert started == [*two[0], *two[1], *two[3], *two[4]]


@pytest.mark.slow
def test_the_demo_and_single_images_compile_nothing_more(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    in_cold_cache(tmp_path, "-m", "craternav_fg", "warmup", "--json")
    sensors = "demo/dataset/mav0/cam0"
    scene = ["--camera", f"{sensors}/sensor.yaml", "--catalog", "demo/dataset/craters.csv"]
    commands = [
        ["demo", "--scenario", "small.toml", "-o", "demo"],
        ["detect", f"{sensors}/data/40000000000.png", "-o", "rims.csv"],
        ["identify", "rims.csv", *scene, "-o", "matched.csv"],
        ["pose", "matched.csv", *scene],
    ]
    assert json.loads(in_cold_cache(tmp_path, "-c", WATCHED, json.dumps(commands)).splitlines()[-1]) == []
