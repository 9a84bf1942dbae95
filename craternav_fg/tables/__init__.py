"""Tables: text with columns and units, and Parquet with a schema."""

from craternav_fg.tables.text import Column, Table, read_table, write_table

__all__ = ["Column", "Table", "read_table", "write_table"]
