"""Settings of all tests."""

import os
import signal
import tempfile

import pytest
from hypothesis import settings

# Tests neither read nor fill the user's cache.
os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="craternav-cache-")

# A shell starts background jobs deaf to Ctrl-C; the tests of it are not about that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Files that take longest: begun first, so that no worker is left alone with one at the end.
LONGEST = (
    "test_notebooks.py", "test_fuzz.py", "test_identify.py", "test_ratios.py", "test_command_line.py",
    "test_cluster.py",
)  # fmt: skip

pytest_plugins = ("pytester", "tests.slow_budget")

# The first example of a property may compile a kernel: time says nothing there.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
