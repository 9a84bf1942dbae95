"""Tables: text with columns and units, and Parquet with a schema."""

from typing import TYPE_CHECKING

from craternav_fg.tables.text import Column, Table, read_table, write_table

__all__ = ["Column", "Table", "read_table", "write_table"]

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
