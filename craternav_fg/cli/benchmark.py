"""Command that measures speed."""

import json
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.bench import report as bench_report
from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import FIGURE_SUFFIXES, JsonOption, require_suffix
from craternav_fg.cli.terminal import out, progress_bars, say, table_of_numbers, three_digits


@app.command(epilog=example("bench -o runs/bench.png"))
def bench(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure of cost against graph size: .png, .pdf or .svg.")
    ] = Path("runs/bench.png"),
    full: Annotated[
        bool,
        typer.Option("--full", help="Also run the online estimator over 10,000 frames: minutes longer."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure speed against graphs of the same size of GTSAM's own C++ factors."""
    require_suffix(output, FIGURE_SUFFIXES)
    with progress_bars() as report:
        result = bench_report.run(bench_report.FULL if full else bench_report.QUICK, report)
    bench_report.write_figure(result, output)
    if as_json:
        out.print_json(json.dumps(result.json()))
        return
    table = table_of_numbers("ratio", ("median", "10 %", "90 %", "ours us", "C++ us"))
    for name, ratio in result.ratios.items():
        numbers = (ratio.median, ratio.low, ratio.high, ratio.ours_us, ratio.reference_us)
        table.add_row(name, *map(three_digits, numbers))
    out.print(table)
    for name, value in result.scalars.items():
        say(f"{name}: {three_digits(value)}")
    say(f"figure: {output}")
