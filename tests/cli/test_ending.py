"""However a command ends: one line, and the exit code that a shell expects."""

import ctypes
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from craternav_fg.cli.ending import one_line_endings
from craternav_fg.dataset import Dataset
from craternav_fg.simulation.scenario import simulate
from factors import numba_cache
from tests.campaign.scene import small_scenario, write_scenario
from tests.descents import scenario

COMMAND = [sys.executable, "-m", "craternav_fg"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = simulate(scenario(duration_s=20.0), tmp_path_factory.mktemp("ending") / "data")
    assert len(Dataset.open(folder)) > 10
    return folder


def handles_sigterm(pid: int) -> bool:
    status = Path(f"/proc/{pid}/status").read_text()
    (caught,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def stopped(arguments: list[str], after_s: float, number: int) -> tuple[int, str]:
    """Exit code and errors of a command that gets a signal; 0 is none."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [*COMMAND, *arguments], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        # Before, Python itself starts.
        while process.poll() is None and not handles_sigterm(process.pid):
            time.sleep(0.01)
        time.sleep(after_s)
        process.send_signal(number)
        _, said = process.communicate(timeout=600.0)
    return process.returncode, said


def check(arguments: list[str], after_s: float, number: int) -> None:
    code, said = stopped(arguments, after_s, number)
    if code == 0:
        # It was done before.
        return
    assert code == 128 + number, said
    assert said.count("\n") == 1, said
    assert "Traceback" not in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command_in_one_line(number: int, data: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    check(["reconstruct", str(data), "-o", str(run)], 1.5, number)
    # Nothing is left beside the final names.
    assert [path for path in tmp_path.iterdir() if path != run] == []


def commands(data: Path, folder: Path) -> list[list[str]]:
    """Commands that read and write, with outputs in a folder."""
    own = str(folder)
    return [
        ["reconstruct", str(data), "-o", f"{own}/run"],
        ["simulate", "paper_case3", "-o", f"{own}/data"],
        ["montecarlo", f"{own}/scenario.toml", "-n", "9", "-e", "ekf", "-o", f"{own}/campaign"],
        ["demo", "-o", f"{own}/demo"],
        ["catalog", "import", str(data / "craters.csv"), "-o", f"{own}/craters.parquet"],
        ["report", f"{own}/run"],
        ["--help"],
    ]


@pytest.mark.slow
def test_thirty_moments(data: Path, tmp_path: Path) -> None:
    """Ctrl-C, SIGTERM and kill -9; then the same commands end well, and what the dead have left is gone."""
    rng = random.Random(15)
    write_scenario(tmp_path / "scenario.toml", small_scenario())
    every = commands(data, tmp_path)
    for k in range(30):
        number = rng.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
        check_or_input_error(every[k % len(every)], rng.uniform(0.05, 6.0), number)
    # Younger files may be of a process that has not locked them yet.
    time.sleep(3.0)
    for arguments in every:
        if arguments[0] in ("reconstruct", "simulate", "catalog", "report"):
            arguments = [*arguments, "--force"]
        if arguments[0] != "demo":
            code, said = stopped(arguments, 0.0, 0)
            assert code == 0, said
    assert [path for path in tmp_path.rglob("*") if ".craternav-" in path.name] == []


def check_or_input_error(arguments: list[str], after_s: float, number: int) -> None:
    """As `check`; the run of a report may not be there yet."""
    code, said = stopped(arguments, after_s, number)
    # As a shell shows it: Python itself dies of a signal that comes when all is done.
    code = 128 - code if code < 0 else code
    assert "Traceback" not in said, said
    assert code in (0, 2, 128 + number), said
    if code == 2:
        assert said.count("\n") == 1, said


@pytest.mark.parametrize("moment", range(6))
def test_ctrl_c_while_modules_are_imported(moment: int) -> None:
    check(["montecarlo", "paper_case3", "-n", "1", "-o", "/dev/null/x"], 0.1 * moment, signal.SIGINT)


def ended(error: BaseException, capsys: pytest.CaptureFixture[str]) -> tuple[object, str]:
    with pytest.raises(SystemExit) as end, one_line_endings():
        raise error
    return end.value.code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (PermissionError(13, "?", "/some/file"), "craternav: /some/file: Permission denied\n"),
        (OSError(28, "?"), "craternav: the output: No space left on device\n"),
        (MemoryError(), "craternav: not enough memory\n"),
    ],
)
def test_errors_of_the_machine_are_one_line(
    error: BaseException, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(error, capsys) == (2, line)


def test_a_defect_is_a_traceback() -> None:
    with pytest.raises(ZeroDivisionError), one_line_endings():
        raise ZeroDivisionError


def test_a_signal_that_compiled_code_turns_into_an_error_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    before = signal.getsignal(signal.SIGINT)

    def compiled() -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5.0)
        except KeyboardInterrupt:
            raise SystemError("returned a result with an exception set") from None

    with pytest.raises(SystemExit) as end, one_line_endings():
        compiled()
    assert end.value.code == 130
    assert capsys.readouterr().err == "craternav: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_whose_exception_is_lost_in_a_callback_of_c_ends_a_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    @ctypes.CFUNCTYPE(None)
    def called_by_c() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5.0)

    def command() -> None:
        called_by_c()
        time.sleep(5.0)

    hook = sys.unraisablehook
    start_s = time.monotonic()
    with pytest.raises(SystemExit) as end, one_line_endings():
        command()
    assert end.value.code == 130
    assert capsys.readouterr().err == "craternav: interrupted\n"
    assert time.monotonic() - start_s < 4.0
    assert sys.unraisablehook is hook


def test_a_signal_while_python_ends_changes_nothing() -> None:
    program = """
import atexit, os, signal
from craternav_fg.cli.ending import one_line_endings
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
with one_line_endings():
    pass
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_full_disk_and_a_terminal_of_ascii(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, "--version"], stdout=full, stderr=subprocess.PIPE, text=True, env=environment,
            check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (2, "craternav: the output: No space left on device\n")
    folder = tmp_path / "é[/b]"
    done = subprocess.run(
        [*COMMAND, "report", str(folder)], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 2
    assert done.stderr.endswith("\\xe9[/b]: folder is missing\n")


def test_numba_gets_a_folder_where_it_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Set first, so that at the end it is what it was before, whatever the function has set.
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert numba_cache.provide() is None
    monkeypatch.setattr(numba_cache, "_writable", lambda folder: False)
    # Set again at the end to what it was before.
    monkeypatch.setenv("MPLCONFIGDIR", str(tmp_path))
    folder = numba_cache.provide()
    assert folder == tmp_path / f"craternav-{os.getuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    # Somebody else's folder of that name is not used.
    folder.chmod(0o777)
    other = numba_cache.provide()
    assert other is not None
    assert other != folder
    monkeypatch.delenv("NUMBA_CACHE_DIR")
