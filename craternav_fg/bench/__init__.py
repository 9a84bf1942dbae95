"""Benchmark: cost of factors, estimators, front end and renderer; ratios against GTSAM's own C++ factors."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
