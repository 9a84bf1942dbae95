"""Settings of all tests."""

from hypothesis import settings

pytest_plugins = ("pytester", "tests.slow_budget")

# The first example of a property may compile a kernel: time says nothing there.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")
