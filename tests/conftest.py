"""Settings of all tests."""

import os
import tempfile

from hypothesis import settings

# Tests neither read nor fill the user's cache.
os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="craternav-cache-")

pytest_plugins = ("pytester", "tests.slow_budget")

# The first example of a property may compile a kernel: time says nothing there.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")
