"""Tables of reproduced figures in a terminal."""

from io import StringIO
from types import SimpleNamespace

import pytest
from rich.console import Console

from craternav_fg.reproduce.results import Row
from craternav_fg.reproduce.terminal import tables


@pytest.mark.parametrize("width", [80, 200])
def test_no_number_is_cut_and_no_verdict_squeezed_out(width: int) -> None:
    row = Row(
        "fig17", "position error", "90 km, craters in view: 2.3", "m", paper=123.4, as_printed=1.23e13,
        corrected=234.5, efficient=345.6, bound=456.7, verdict="reproduced", headline=True,
    )  # fmt: skip
    console = Console(width=width, record=True, file=StringIO())
    ((_, table),) = tables(SimpleNamespace(rows=[row]))
    console.print(table)
    text = console.export_text()
    for cell in ("123", "1.23e+13", "234", "346", "457", "reproduced"):
        assert cell in text
