"""Monte Carlo campaigns: many trials of one scenario, on processes here or on a Dask cluster."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
