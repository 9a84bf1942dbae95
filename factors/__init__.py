"""The measurement equations of crater-edge navigation, each with its GTSAM factor.

Every factor says when it is zero. `factors.kernels.validity` says what a factor gives at poses from which a
crater has no image; docs/equations.md derives the equations.
"""

from typing import TYPE_CHECKING

from factors import numba_cache as numba_cache

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
