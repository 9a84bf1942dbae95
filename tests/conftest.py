"""Settings of all tests."""

import atexit
import gc
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# Tests neither read nor fill the user's cache.
os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="craternav-cache-")
atexit.register(shutil.rmtree, os.environ["XDG_CACHE_HOME"], ignore_errors=True)

# Child processes run this checkout, whether it, another one or none is installed.
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
)

# The tests start a hundred processes: without bytecode on disk each would compile all modules again. It lies
# beside compiled kernels, which are kept anyway.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# As the command line does, which the tests call in their own process as well; numpy is not imported yet.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts background jobs deaf to Ctrl-C; the tests of it are not about that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Files that take longest: begun first, so that no worker is left alone with one at the end. The second one
# compiles other kernels than the first: of two workers that need the same ones, one waits.
LONGEST = (
    "test_notebooks.py", "test_identify.py", "test_command_line.py", "test_detect.py",
    "test_sensor_checks.py", "test_pose.py", "test_network_detect.py", "test_own_sensor.py",
    "test_hard_cases.py", "test_mosaics.py",
    "test_fuzz.py", "test_refine.py", "test_orbit.py", "test_consensus.py", "test_render.py",
    "test_posed_images.py", "test_guided.py", "test_gate.py", "test_run.py", "test_plugins.py",
    "test_wrong_answers.py", "test_identify_apollo.py", "test_identify_search.py", "test_bags.py",
    "test_calibration.py", "test_sun.py", "test_isis.py", "test_monte_carlo.py", "test_killed.py",
    "test_compiled.py", "test_late_rims.py",
)  # fmt: skip

pytest_plugins = ("pytester", "tests.slow_budget")

# The first example of a property may compile a kernel: time says nothing there.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("slow tests").addoption(
        "--views", type=int, metavar="N", default=50,
        help="views that tests of wrong answers draw of each fault (default: 50)",
    )  # fmt: skip


def pytest_collection_finish() -> None:
    # Modules and tests live to the end: no search for garbage need look through them again.
    gc.collect()
    gc.freeze()


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs have no figures, which take most of the time of a short one."""
    monkeypatch.setattr("craternav_fg.runs.execute._figures", lambda *_: {})


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
