"""The script of the README, word for word."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from craternav_fg.simulation.scenario import simulate
from tests import descents

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script() -> str:
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## As a library\n")[1]
    found = re.search(r"```python\n(.*?)```", section, flags=re.DOTALL)
    assert found is not None
    return found.group(1)


def test_it_is_twenty_lines_of_code(script: str) -> None:
    assert sum(bool(line.strip()) for line in script.splitlines()) <= 20


def test_it_runs_and_its_own_factor_counts(script: str, tmp_path: Path) -> None:
    simulate(descents.scenario(duration_s=60.0), tmp_path / "runs/data")
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "script.py"],
        cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")
    rms_m = {m[1]: float(m[2]) for m in re.finditer(r"^(\w+): position ([\d.]+) m RMS", done.stdout, re.M)}
    assert list(rms_m) == ["smoother", "ekf", "smoother_with_beacon"]
    assert rms_m["smoother_with_beacon"] < 0.7 * rms_m["smoother"]
