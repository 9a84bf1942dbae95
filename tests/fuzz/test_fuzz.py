"""A spoilt input ends in an answer, or in one line and exit code 2: soon, and in bounded memory."""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

# CPU time after which a case hangs, and after which the sound examples are not made: on a busy machine
# everything takes long.
HANGS_CPU_S, BEGIN_CPU_S = 60.0, 600.0
# A process that used no more than a second of CPU time in this time waits for something, such as a pipe.
WAITS_S = 120.0


class Watch:
    """Tells whether a process hangs, since it last said something."""

    def __init__(self, pid: int) -> None:
        self._stat = Path(f"/proc/{pid}/stat")
        self._limit_s = BEGIN_CPU_S
        self._begin()

    def heard(self) -> None:
        self._limit_s = HANGS_CPU_S
        self._begin()

    def hangs(self) -> bool:
        used_s = self._cpu_s() - self._cpu_before_s
        return used_s > self._limit_s or (used_s < 1.0 and time.monotonic() - self._before_s > WAITS_S)

    def _begin(self) -> None:
        self._before_s, self._cpu_before_s = time.monotonic(), self._cpu_s()

    def _cpu_s(self) -> float:
        try:
            fields = self._stat.read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cases(folder: Path, first: int, last: int) -> list[dict[str, Any]]:
    """Run cases, those after a crash or a hang in a new process; give those at fault."""
    faults: list[dict[str, Any]] = []
    while first < last:
        command = [sys.executable, "-m", "tests.fuzz.worker", str(folder), str(first), str(last)]
        with (
            (folder / "errors").open("w") as errors,
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
        ):
            lines: queue.Queue[str] = queue.Queue()
            threading.Thread(target=read, args=(process, lines), daemon=True).start()
            begun: dict[str, Any] | None = None
            watch = Watch(process.pid)
            while first < last:
                try:
                    line = lines.get(timeout=5.0)
                except queue.Empty:
                    if not watch.hangs():
                        continue
                    line = ""
                if not line:
                    process.kill()
                    said = (folder / "errors").read_text()[-500:]
                    assert begun is not None, said
                    faults.append({**begun, "fault": f"crash or hang: {said}"})
                    first = begun["seed"] + 1
                    break
                watch.heard()
                case = json.loads(line)
                if "begins" in case:
                    begun = case["begins"]
                elif "seed" in case:
                    first = case["seed"] + 1
                    faults += [case] if case["fault"] else []
            process.kill()
        for left in folder.iterdir():
            if left.is_dir():
                subprocess.run(["rm", "-rf", str(left)], check=True)
    return faults


def read(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")


def shown(faults: list[dict[str, Any]]) -> str:
    return "\n\n".join(json.dumps(fault, indent=1).replace("\\n", "\n") for fault in faults)


def test_three_hundred_spoilt_inputs(tmp_path: Path) -> None:
    faults = cases(tmp_path, 0, 300)
    assert not faults, shown(faults)


@pytest.mark.slow
@pytest.mark.parametrize("thousand", range(10))
def test_ten_thousand_spoilt_inputs(thousand: int, tmp_path: Path) -> None:
    faults = cases(tmp_path, 1000 * thousand, 1000 * (thousand + 1))
    assert not faults, shown(faults)
