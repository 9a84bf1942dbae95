"""Command that measures speed."""

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.bench import detect_real
from craternav_fg.bench import report as bench_report
from craternav_fg.bench.compare import MOVED, Change, changes, read_benchmark
from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import FIGURE_SUFFIXES, ForceOption, JsonOption, require_free, require_suffix
from craternav_fg.cli.terminal import out, progress_bars, say, table_of_numbers, three_digits
from craternav_fg.errors import InputError
from craternav_fg.vision.detect import BlindOptions


class Subject(StrEnum):
    """What is measured."""

    SPEED = "speed"
    DETECT_REAL = "detect-real"


@app.command(epilog=example("bench detect-real --data ../shared/data"))
def bench(
    subject: Annotated[
        Subject, typer.Argument(help="Speed, or blind detection on annotated real images.")
    ] = Subject.SPEED,
    data: Annotated[
        Path | None, typer.Option(help="Folder of the annotated images (detect-real).", show_default=False)
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure of cost against graph size: .png, .pdf or .svg.")
    ] = Path("runs/bench.png"),
    full: Annotated[
        bool,
        typer.Option("--full", help="Also run the online estimator over 10,000 frames: minutes longer."),
    ] = False,
    compare: Annotated[
        Path | None,
        typer.Option(help="JSON of an earlier benchmark: say what moved beyond noise.", show_default=False),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure speed against GTSAM's own C++ factors, or detection against annotated images."""
    if subject is Subject.DETECT_REAL:
        _detect_real(_given(data), as_json)
        return
    require_suffix(output, FIGURE_SUFFIXES)
    require_free(output, force=force)
    before = None if compare is None else read_benchmark(compare)
    with progress_bars() as report:
        result = bench_report.run(bench_report.FULL if full else bench_report.QUICK, report)
    bench_report.write_figure(result, output)
    found = [] if before is None else changes(before, result.json())
    if as_json:
        moved = {MOVED: [asdict(one) for one in found if one.moved]} if before is not None else {}
        out.print_json(json.dumps({**result.json(), **moved}))
        return
    table = table_of_numbers("ratio", ("median", "10 %", "90 %", "wall", "ours us", "C++ us"))
    for name, ratio in result.ratios.items():
        numbers = (ratio.median, ratio.low, ratio.high, ratio.wall, ratio.ours_us, ratio.reference_us)
        table.add_row(name, *map(three_digits, numbers))
    out.print(table)
    for name, value in result.scalars.items():
        say(f"{name}: {three_digits(value)}")
    say(f"figure: {output}")
    if before is not None:
        _show(found)


def _show(found: list[Change]) -> None:
    """Print what moved since an earlier benchmark."""
    table = table_of_numbers("moved", ("before", "now", "now/before"))
    moved = [one for one in found if one.moved]
    for one in moved:
        share = one.now / one.before if one.before else None
        table.add_row(one.name, three_digits(one.before), three_digits(one.now), three_digits(share))
    if moved:
        out.print(table)
    say(f"{len(moved)} of {len(found)} numbers moved by more than noise")


def _given(data: Path | None) -> Path:
    if data is None:
        raise InputError("bench detect-real", "expected --data, the folder of the annotated images")
    return data


def _detect_real(data: Path, as_json: bool) -> None:
    """Score blind detection on real images."""
    with progress_bars() as report:
        rows = detect_real.run(
            data, BlindOptions.min_quality, lambda done, total: report("annotated images", done, total)
        )
    if as_json:
        values = [
            {"images": r.kind, "method": r.method, "min_radius_px": r.min_radius_px, **asdict(r.scores)}
            for r in rows
        ]
        out.print_json(json.dumps(values))
        return
    names = ("recall", "prec.", "F1", "AP", "recall .9", "centre", "ln r", "ECE")
    table = table_of_numbers("images, method, radius", names)
    for r in rows:
        cells = map(three_digits, asdict(r.scores).values())
        table.add_row(f"{r.kind} {r.method} >= {r.min_radius_px:g}", *cells)
    out.print(table)
    say(
        f"at quality {BlindOptions.min_quality:g} and above; AP: average precision; recall .9: at precision "
        "0.9; centre: median distance, radii; ln r: median logarithm of the radius over the marked one; ECE: "
        "expected calibration error"
    )
