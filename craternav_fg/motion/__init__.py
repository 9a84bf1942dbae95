"""Motion models: how the lander moves between images without an accelerometer.

`model` is the interface that estimators use in place of IMU preintegration; `coast`, `white_acceleration` and
`white_jerk` are the models, `gravity` the field in which `coast` falls, `settings` the table `[motion]` of
dataset.toml.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
