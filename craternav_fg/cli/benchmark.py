"""Command that measures speed."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table

from craternav_fg.bench import report as bench_report
from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.terminal import bar, number, out
from craternav_fg.errors import InputError

PICTURES = (".png", ".pdf", ".svg")


@app.command()
def bench(
    output: Annotated[Path, typer.Option("--output", "-o", help="Figure of cost against size.")] = Path(
        "runs/bench.png"
    ),
    full: Annotated[
        bool,
        typer.Option(
            "--full", help="Online over 10,000 frames, too: minutes more than the two or three without."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure cost against graphs of the same size made of GTSAM's own C++ factors."""
    if output.suffix not in PICTURES:
        raise InputError(output, f"expected a name that ends in {' or '.join(PICTURES)}")
    with bar() as report:
        result = bench_report.run(bench_report.FULL if full else bench_report.QUICK, report)
    bench_report.write_figure(result, output)
    if as_json:
        out.print_json(json.dumps(result.json()))
        return
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)
    table.add_column("ratio", no_wrap=True)
    for heading in ("median", "10 %", "90 %", "ours us", "C++ us"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, ratio in result.ratios.items():
        numbers = (ratio.median, ratio.low, ratio.high, ratio.ours_us, ratio.reference_us)
        table.add_row(name, *map(number, numbers))
    out.print(table)
    for name, value in result.scalars.items():
        out.print(f"{name}: {number(value)}", highlight=False)
    out.print(f"figure: {output}", highlight=False, soft_wrap=True)
