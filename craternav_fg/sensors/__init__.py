"""Sensors beside the camera and the IMU: a protocol, and the sensors that come with the package.

A sensor is one class in one module (see `protocol.Sensor`): the folder `mav0/NAME0` that holds its log,
one measurement function that the factor and the Kalman filters share, and its simulation. `registry` finds
those of other packages by their entry points.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
