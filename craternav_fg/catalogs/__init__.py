"""Crater catalogues: the model with its spatial index, files of any origin, checks, elevation models."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
