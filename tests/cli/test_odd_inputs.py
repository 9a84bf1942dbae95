"""Odd but allowed: names of any letters, ground without craters, folders that cannot be written."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import craternav_fg
import factors
from craternav_fg.campaign.run import montecarlo
from craternav_fg.dataset import Dataset
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario
from craternav_fg.simulation.scenario_tables import Crater, CraterList
from tests import descents
from tests.campaign.scene import options, small_scenario, write_scenario
from tests.cli.calls import call

# An emoji, rich's markup, HTML, a line break.
NAME = "\U0001f311[/b]<i>é\n%s"


def without_rims() -> Scenario:
    """Return a descent whose only crater is on the other side of the body."""
    away = Crater(east_m=2.5e6, north_m=0.0, semi_major_m=2e3, semi_minor_m=1.5e3, angle_deg=0.0)
    return descents.scenario(duration_s=6.0).model_copy(
        update={"craters": CraterList(source="list", crater=(away,))}
    )


def with_an_odd_body() -> Scenario:
    case = descents.scenario(duration_s=6.0)
    return case.model_copy(update={"body": case.body.model_copy(update={"name": NAME})})


@pytest.mark.parametrize("case", [without_rims, with_an_odd_body])
def test_what_is_written_is_read_again(case: object, tmp_path: Path) -> None:
    """From scenario to report, in folders of an odd name."""
    folder = tmp_path / NAME.replace("/", "|")
    folder.mkdir()
    assert callable(case)
    scenario = write_scenario(folder / "scenario.toml", case())
    data, run = folder / "data", folder / "run"
    for command in (
        ("simulate", scenario, "-o", data),
        ("reconstruct", data, "-o", run, "-e", "smoother,ekf,dead_reckoning"),
        ("report", run),
        ("compare", run),
        ("catalog", "info", data / "craters.csv"),
    ):
        done = call(*command)
        assert done.code == 0, f"{command}: {done.err}"
    assert (run / "report.html").is_file()
    measured = Dataset.open(data).measurements
    assert measured is not None
    if case is without_rims:
        assert not any(len(frame.rims) for frame in measured)


def bound_by_modes() -> None:
    """Let modes of files bind root, too: Linux's capabilities to override them are given up."""
    if os.geteuid() == 0:
        of_process = ctypes.CDLL(None)
        for capability in (1, 2):
            # PR_CAPBSET_DROP of CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH; takes effect with what is run next.
            if of_process.prctl(24, capability, 0, 0, 0):
                raise OSError("capabilities cannot be dropped")


@pytest.fixture
def modest(tmp_path: Path) -> Iterator[Callable[..., subprocess.CompletedProcess[str]]]:
    """Run a copy of the package that cannot be written, as a user who cannot write the home folder."""
    if not sys.platform.startswith("linux"):
        pytest.skip("modes bind root on no other system")
    package = tmp_path / "package"
    for module in (craternav_fg, factors):
        here = Path(module.__file__).parent
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(here, package / here.name, ignore=ignored)
    folders = [package, *(path for path in package.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    (tmp_path / "tmp").mkdir()
    nowhere = {"HOME": "/proc", "XDG_CACHE_HOME": "/proc/cache", "XDG_CONFIG_HOME": "/proc/config"}
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": os.pathsep.join([str(package), *sys.path]), **nowhere}
    environment["TMPDIR"] = str(tmp_path / "tmp")

    def run(*command: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "craternav_fg", *map(str, command)], preexec_fn=bound_by_modes,
            capture_output=True, text=True, env=environment, check=False, cwd=tmp_path / "tmp",
        )  # fmt: skip

    yield run
    for folder in folders:
        folder.chmod(0o755)


@pytest.mark.slow
def test_neither_package_nor_home_need_be_writable(modest: Any, tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path / "scenario.toml", descents.scenario(duration_s=6.0))
    kept = f"no folder for compiled code can be written: {tmp_path}/tmp/craternav-{os.getuid()} is used"
    for command in (
        ["--help"],
        ["simulate", scenario, "-o", tmp_path / "data"],
        ["reconstruct", tmp_path / "data", "-o", tmp_path / "run", "-e", "dead_reckoning"],
    ):
        done = modest(*command)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        assert done.stderr.count(kept) == 1, done.stderr
    assert list((tmp_path / "tmp").rglob("*.nbc"))
    assert not list((tmp_path / "package").rglob("__pycache__"))


@pytest.mark.slow
def test_what_is_closed_is_neither_empty_nor_missing(modest: Any, tmp_path: Path) -> None:
    """A campaign whose trials cannot be read would begin anew."""
    scenario = write_scenario(tmp_path / "scenario.toml", small_scenario())
    campaign = tmp_path / "campaign"
    montecarlo(small_scenario(), campaign, options(1, workers=1))
    before = sorted(path.name for path in campaign.rglob("*"))
    data = simulate(descents.scenario(duration_s=6.0), tmp_path / "data")
    for closed, command in (
        (campaign / "trials", ["montecarlo", scenario, "-n", 2, "-o", campaign, "-e", "ekf,dead_reckoning"]),
        (campaign / "trials", ["report", campaign]),
        (data / "craters.csv", ["reconstruct", data, "-o", tmp_path / "run"]),
        (data / "craters.csv", ["catalog", "info", data / "craters.csv"]),
        (scenario, ["simulate", scenario, "-o", tmp_path / "again"]),
    ):
        mode = closed.stat().st_mode & 0o777
        closed.chmod(0)
        done = modest(*command)
        closed.chmod(mode)
        assert done.returncode == 2, done.stderr
        last = done.stderr.splitlines()[-1]
        assert last.startswith(f"craternav: {closed}"), last
        assert last.endswith("cannot be read: Permission denied"), last
        assert "Traceback" not in done.stderr
    assert sorted(path.name for path in campaign.rglob("*")) == before
