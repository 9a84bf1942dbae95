"""The report of a run or a campaign: one HTML page that needs nothing but a browser."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
