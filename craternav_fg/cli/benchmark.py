"""Command that measures speed."""

import json
import math
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.bench import detect_real, identify_ground, scaling
from craternav_fg.bench import report as bench_report
from craternav_fg.bench.compare import MOVED, Change, changes, read_benchmark
from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import (
    FIGURE_SUFFIXES,
    ForceOption,
    JsonOption,
    require_free,
    require_suffix,
    require_unused,
)
from craternav_fg.cli.terminal import out, progress_bars, say, table_of_numbers, three_digits
from craternav_fg.errors import InputError
from craternav_fg.vision.detect import BlindOptions


class Subject(StrEnum):
    """What is measured."""

    SPEED = "speed"
    SCALING = "scaling"
    DETECT_REAL = "detect-real"
    IDENTIFY_GROUND = "identify-ground"


# Options that not all subjects use, and those that each does.
_OPTIONS = {"data", "views", "seed", "fault", "output", "full", "compare", "force"}
_USED = {
    Subject.SPEED: {"output", "full", "compare", "force"},
    Subject.SCALING: {"output", "force"},
    Subject.DETECT_REAL: {"data"},
    Subject.IDENTIFY_GROUND: {"data", "views", "seed", "fault"},
}


@app.command(epilog=example("bench detect-real --data FOLDER"))
def bench(
    context: typer.Context,
    subject: Annotated[
        Subject,
        typer.Argument(
            help="Speed, its scaling, detection on annotated images, or identification on real ground."
        ),
    ] = Subject.SPEED,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the annotated images (detect-real) or of the public files (identify-ground).",
            show_default=False,
        ),
    ] = None,
    views: Annotated[int, typer.Option(min=1, help="Number of images (identify-ground).")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the images (identify-ground).")] = 1,
    fault: Annotated[
        identify_ground.Fault | None,
        typer.Option(
            help="Mirror the images, or remove their region from the map: no answer is right"
            " (identify-ground).",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure of cost against size: .png, .pdf or .svg.")
    ] = Path("runs/bench.png"),
    full: Annotated[
        bool,
        typer.Option("--full", help="Also run the online estimator over 10,000 frames (takes minutes)."),
    ] = False,
    compare: Annotated[
        Path | None,
        typer.Option(
            help="JSON of an earlier benchmark; changes beyond noise are reported.", show_default=False
        ),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure speed against GTSAM's own C++ factors, detection, or identification on real ground."""
    require_unused(context, _OPTIONS - _USED[subject], f"for bench {subject.value}")
    if subject is Subject.DETECT_REAL:
        _detect_real(_given(data, "--data, the folder of the annotated images"), as_json)
        return
    if subject is Subject.IDENTIFY_GROUND:
        _identify_ground(_given(data, "--data, the folder of the public files"), views, seed, fault, as_json)
        return
    require_suffix(output, FIGURE_SUFFIXES)
    require_free(output, force=force)
    if subject is Subject.SCALING:
        _scaling(output, as_json)
        return
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


def _scaling(output: Path, as_json: bool) -> None:
    """Measure the cost of all methods over frames and craters."""
    with progress_bars() as report:
        rows = scaling.scaling(report)
    scaling.write_figure(rows, output)
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = table_of_numbers("frames x craters, ms a frame", scaling.METHODS)
    for row in rows:
        table.add_row(
            f"{row['frames']} x {row['craters']}", *(three_digits(row[name]) for name in scaling.METHODS)
        )
    out.print(table)
    say(f"figure: {output}")


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


def _given(folder: Path | None, expected: str) -> Path:
    if folder is None:
        raise InputError("bench", f"expected {expected}")
    return folder


def _known(value: Any) -> Any:
    """Return a value, None for NaN: the median of no crater."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _detect_real(folder: Path, as_json: bool) -> None:
    """Score blind detection on real images."""
    with progress_bars() as report:
        rows, worn = detect_real.run(
            folder, BlindOptions.min_quality, lambda done, total: report("annotated images", done, total)
        )
    if as_json:
        values = [
            {"images": r.kind, "method": r.method, "min_radius_px": r.min_radius_px, **asdict(r.scores)}
            for r in rows
        ]
        both = {"by_size": values, "by_wear": [one._asdict() for one in worn]}
        known = {
            name: [{k: _known(v) for k, v in one.items()} for one in part] for name, part in both.items()
        }
        out.print_json(json.dumps(known, allow_nan=False))
        return
    names = ("recall", "prec.", "F1", "AP", "recall .9", "centre", "ln r", "ECE")
    table = table_of_numbers("images, method, radius", names)
    for r in rows:
        cells = (three_digits(_known(value)) for value in asdict(r.scores).values())
        table.add_row(f"{r.kind} {r.method} >= {r.min_radius_px:g}", *cells)
    out.print(table)
    say(
        f"at quality {BlindOptions.min_quality:g} and above; AP: average precision; recall .9: at precision "
        "0.9; centre: median distance, radii; ln r: median logarithm of the radius over the marked one; ECE: "
        "expected calibration error"
    )
    by_wear = table_of_numbers(
        "images, method, shading of the marked craters", ("marked", "recall", "centre", "ln r")
    )
    for one in worn:
        numbers = (three_digits(_known(v)) for v in (one.recall, one.centre_radii, one.log_radius))
        by_wear.add_row(f"{one.kind} {one.method} {one.wear}", str(one.marked), *numbers)
    out.print(by_wear)


def _identify_ground(
    data: Path, views: int, seed: int, fault: identify_ground.Fault | None, as_json: bool
) -> None:
    """Identify rendered images of real ground."""
    with progress_bars() as report:
        answers = identify_ground.run(
            data,
            views,
            lambda done, total: report("identified images", done, total),
            seed=seed,
            fault=fault,
        )
    groups = identify_ground.summaries(answers)
    if as_json:
        values = {
            "images": [{k: _known(v) for k, v in one._asdict().items()} for one in answers],
            "groups": [{k: _known(v) for k, v in one._asdict().items()} for one in groups],
        }
        out.print_json(json.dumps(values, allow_nan=False))
        return
    table = table_of_numbers("ground", ("images", "answered", "wrong", "rims", "error m", "s"))
    for one in groups:
        table.add_row(one.name, *map(three_digits, map(_known, one[1:])))
    out.print(table)
    say("rims, error of the position and duration of the identification: medians")
