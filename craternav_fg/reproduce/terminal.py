"""Terminal tables of a reproduced figure."""

from collections.abc import Iterator

from rich import box
from rich.table import Table

from craternav_fg.reproduce.results import NO_NUMBER, NUMBERS, Reproduction, number


def tables(result: Reproduction) -> Iterator[tuple[str, Table]]:
    """Return heading and table of each quantity: its headline rows, without columns that have no number."""
    headlines = [row for row in result.rows if row.headline]
    for quantity, unit in dict.fromkeys((row.quantity, row.unit) for row in headlines):
        rows = [row for row in headlines if (row.quantity, row.unit) == (quantity, unit)]
        shown = [name for name in NUMBERS if any(getattr(row, name) is not None for row in rows)]
        table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, collapse_padding=True)
        # In a narrow terminal words wrap; numbers must not, as a truncated number is another number.
        table.add_column("", min_width=14)
        for name in shown:
            table.add_column(name.replace("_", "\n"), justify="right", no_wrap=True)
        judged = any(row.verdict != NO_NUMBER for row in rows)
        if judged:
            table.add_column("verdict", min_width=14)
        for row in rows:
            numbers = [number(getattr(row, name)) for name in shown]
            words = "" if row.verdict == NO_NUMBER else row.verdict
            table.add_row(row.condition, *numbers, *([words] if judged else []))
        yield f"{quantity}, {unit}", table
