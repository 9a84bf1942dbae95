"""From a data set to trajectories: front end, tracking, relocalisation, estimators."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
