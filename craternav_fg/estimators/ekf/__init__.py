"""The distributed extended Kalman filter of the paper, and its exact counterpart."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
