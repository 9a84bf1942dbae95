"""A second world: descents over ground that shares no code with `craternav_fg.simulation`.

Other crater profiles, relief, reflectance, optics and motion; the data sets are written from the format's
description alone. `python -m tests.foreign` prints the front end's errors by world.
"""
