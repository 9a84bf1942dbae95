"""Reproduction of the paper's figures and tables, each number beside that of its equations and the bound."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
