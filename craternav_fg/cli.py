"""The command line `craternav`."""

import json
import math
import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich import box
from rich.table import Table

import craternav_fg
from craternav_fg.bench import report as bench_report
from craternav_fg.body import Body
from craternav_fg.config import load_scenario
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import CraternavError, EstimationError, InputError
from craternav_fg.estimators.registry import ESTIMATORS, estimator
from craternav_fg.evaluation.detections import rims_json, write_overlay, write_rims_csv
from craternav_fg.evaluation.run_folder import CONTENTS, MARKER, read_run
from craternav_fg.evaluation.runs import write_reconstruction
from craternav_fg.files import replacing_folder
from craternav_fg.reproduce import run as reproduction
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.terminal import tables
from craternav_fg.simulation.scenario import simulate as simulate_scenario
from craternav_fg.static.efficient import solve
from craternav_fg.static.files import SIGMA_RANGE_PX, as_plain_data, read_rims, static_problem
from craternav_fg.static.problem import Status
from craternav_fg.static.robust import solve_robustly
from craternav_fg.terminal import (
    LEGEND,
    bar,
    err,
    from_smoother,
    number,
    out,
    row_of_estimator,
    say,
    show_poses,
    show_run,
    table_of_estimators,
)
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, find_rims

app = typer.Typer(
    help="Reconstruct a planetary landing from crater rims and an IMU.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

PICTURES = (".png", ".pdf", ".svg")
DEMO_DATASET = "dataset"


class Method(StrEnum):
    """Blind detectors."""

    TEMPLATE = "template"
    CANNY = "canny"


METHODS = {Method.TEMPLATE: find_rims, Method.CANNY: find_rims_canny}

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON, nothing else.")]
EstimatorOption = Annotated[
    list[str] | None,
    typer.Option(
        "--estimator", "-e", help=f"One of {', '.join(ESTIMATORS)}; may be repeated.  [default: all]"
    ),
]


def _version(show: bool) -> None:
    if show:
        say(craternav_fg.__version__)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Reconstruct a planetary landing from crater rims and an IMU."""
    del version


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")] = Path("runs/demo"),
    scenario: Annotated[
        str, typer.Option(help="Name of a built-in scenario, or a TOML file.")
    ] = "lunar_descent",
    as_json: JsonOption = False,
) -> None:
    """Simulate a descent, reconstruct it with every estimator, and compare them."""
    began_s = time.perf_counter()
    case = load_scenario(scenario)
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, bar() as report:
        simulate_scenario(
            case, folder / DEMO_DATASET, progress=lambda done, total: report("simulated frames", done, total)
        )
        simulated_s = time.perf_counter() - began_s
        summary = write_reconstruction(
            Dataset.open(folder / DEMO_DATASET),
            folder,
            tuple(ESTIMATORS),
            label=DEMO_DATASET,
            began_s=began_s,
            earlier_s={"simulation": simulated_s},
            progress=report,
        )
    show_run(output, summary, as_json)


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")],
    as_json: JsonOption = False,
) -> None:
    """Simulate a scenario and write its data set (EuRoC/ASL layout)."""
    case = load_scenario(scenario)
    with bar() as report:
        simulate_scenario(case, output, progress=lambda done, total: report("simulated frames", done, total))
    if as_json:
        out.print_json(json.dumps({"dataset": str(output)}))
    else:
        say(f"{output}\nnext: craternav reconstruct {output} -o RUN")


@app.command()
def reconstruct(
    data: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")],
    estimators: EstimatorOption = None,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the trajectory of a data set."""
    began_s = time.perf_counter()
    names = tuple(dict.fromkeys(estimators or ESTIMATORS))
    for name in names:
        estimator(name)
    if data.resolve().is_relative_to(output.resolve()):
        raise InputError(output, f"holds the data set {data}, which would be lost when the run replaces it")
    dataset = Dataset.open(data)
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, bar() as report:
        summary = write_reconstruction(
            dataset, folder, names, label=str(data.resolve()), began_s=began_s, progress=report
        )
    show_run(output, summary, as_json)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs.")],
    as_json: JsonOption = False,
) -> None:
    """Compare the estimators of one or more runs."""
    loaded = [read_run(path) for path in runs]
    if as_json:
        result = {
            str(run.path): {
                name: {**run.metrics["estimators"][name], "from_smoother_rms_m": from_smoother(run, name)}
                for name in run.trajectories
            }
            for run in loaded
        }
        out.print_json(json.dumps(result))
        return
    for run in loaded:
        table = table_of_estimators()
        table.add_column("off m", justify="right", no_wrap=True)
        for name in run.trajectories:
            cells = row_of_estimator(name, run.metrics["estimators"][name])
            table.add_row(*cells, number(from_smoother(run, name)))
        say(f"{run.path}")
        out.print(table)
    say(f"{LEGEND}\noff: RMS distance from the smoother")


@app.command()
def bench(
    output: Annotated[Path, typer.Option("--output", "-o", help="Figure of cost against size.")] = Path(
        "runs/bench.png"
    ),
    full: Annotated[
        bool,
        typer.Option("--full", help="Online over 10,000 frames, too: minutes. The default takes about one."),
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


@app.command()
def pose(
    rims: Annotated[Path, typer.Argument(help="CSV of ellipses, each with its crater (see the README).")],
    camera: Annotated[Path, typer.Option(help="The camera's sensor.yaml.")],
    catalog: Annotated[Path, typer.Option(help="Crater catalogue, with the columns of Robbins (2018).")],
    attitude: Annotated[
        str | None, typer.Option(help="Known attitude gRb, as a quaternion w,x,y,z: the position is sought.")
    ] = None,
    attitude_sigma_deg: Annotated[
        float, typer.Option(min=0.0, help="Its standard deviation per axis; 0 takes it as exact.")
    ] = 0.0,
    sun: Annotated[
        str | None,
        typer.Option(
            help="TILT,SIGMA,X,Y,Z: direction of the light on the ground amid the rims, from the image's x "
            "axis towards its y axis, with its standard deviation, deg; unit vector towards the sun in g."
        ),
    ] = None,
    robust: Annotated[bool, typer.Option("--robust", help="Find wrong matches and leave them out.")] = False,
    sigma_px: Annotated[
        float,
        typer.Option(
            min=SIGMA_RANGE_PX[0],
            max=SIGMA_RANGE_PX[1],
            help="Standard deviation of edge points, without a column sigma_px.",
        ),
    ] = 1.0,
    edge_points: Annotated[
        int, typer.Option(min=6, max=100_000, help="Edge points that an ellipse rests on.")
    ] = 60,
    body_radius_m: Annotated[
        float, typer.Option(min=1.0, help="Of the catalogue's sphere; the Moon's by default.")
    ] = 1737400.0,
    as_json: JsonOption = False,
) -> None:
    """Find the lander's pose from the matched rims of one image, without a start."""
    body = Body("", body_radius_m, 1.0, (0.0, 0.0, 0.0))
    sensor = read_camera(camera)
    if sensor.distorts:
        raise InputError(
            camera, "expected a lens without distortion: an ellipse in its image is no ellipse of a rim"
        )
    matched, craters = read_rims(rims, sensor, catalog, body, sigma_px=sigma_px, edge_points=edge_points)
    problem = static_problem(
        matched,
        craters,
        sensor,
        attitude_wxyz=_numbers("--attitude", attitude, 4),
        attitude_sigma_deg=attitude_sigma_deg,
        sun=_numbers("--sun", sun, 5),
    )
    result = solve_robustly(problem) if robust else solve(problem)
    values = as_plain_data(problem, result, body)
    if as_json:
        out.print_json(json.dumps(values, allow_nan=False))
    else:
        show_poses(values)
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS):
        raise EstimationError(f"{result.status.value}: {result.reason}")
    for warning in result.warnings:
        err.print(f"craternav: warning: {warning}", style="yellow", highlight=False, soft_wrap=True)


def _numbers(option: str, text: str | None, count: int) -> list[float] | None:
    """Read an option of several numbers."""
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(option, f"expected {count} numbers, separated by commas, found {text!r}")
    return values


@app.command()
def reproduce(
    figures: Annotated[list[str], typer.Argument(help=f"{', '.join(reproduction.FIGURES)}, or all.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the figures.")] = Path(
        "runs/reproduction"
    ),
    craters: Annotated[int, typer.Option(help="Craters of figs. 11 and 12, 3 or more.")] = 3,
    altitudes: Annotated[
        tuple[float, float], typer.Option(help="Lowest and highest altitude of figs. 11 to 14, km.")
    ] = (10.0, 100.0),
    noise: Annotated[float, typer.Option(help="Noise of each coordinate of an edge point, px.")] = 1.0,
    arc: Annotated[float, typer.Option(help="Part of each rim that shows, of 1.")] = 1.0,
    trials: Annotated[int, typer.Option(help="Trials at each altitude and point.")] = 100,
    seed: Annotated[int, typer.Option(help="The same seed gives the same result.")] = 1,
    workers: Annotated[int, typer.Option(help="Processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Reproduce the paper's static figures, each number beside the bound and with a verdict."""
    names = reproduction.chosen(figures)
    options = ReproduceOptions(
        craters=craters, altitudes_km=altitudes, noise_px=noise, arc=arc, trials=trials, seed=seed,
        workers=workers,
    )  # fmt: skip
    contents = reproduction.CONTENTS
    with replacing_folder(output, marker=reproduction.MARKER, ours=contents) as folder, bar() as report:
        results = reproduction.reproduce(names, options, report)
        reproduction.write(folder, results, options)
    if as_json:
        out.print_json(json.dumps([row.as_dict() for result in results for row in result.rows]))
        return
    for result in results:
        say(f"{result.name}: {result.title}\n")
        for heading, table in tables(result):
            say(heading)
            out.print(table)
        out.print(f"{result.note}\n", highlight=False, markup=False)
    say(f"all numbers: {output / reproduction.MARKER}, drawings and tables: {output / 'reproduction.md'}")


@app.command()
def detect(
    image: Annotated[Path, typer.Argument(help="Image file of any origin: PNG, TIFF, JPEG.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Table of rims; the overlay is written beside it.")
    ] = Path("runs/rims.csv"),
    sun_deg: Annotated[
        float | None,
        typer.Option(
            "--sun",
            help="Where in the image the light comes from: 0 right, 90 below, 180 left.  [default: seen]",
        ),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="Matching with a rendered crater, or grouped arcs of Canny edges.")
    ] = Method.TEMPLATE,
    min_radius_px: Annotated[
        float, typer.Option("--min-radius", min=4.0, help="Smallest radius searched, px.")
    ] = BlindOptions.min_radius_px,
    min_quality: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Least quality of a rim: less finds more, also wrong ones."),
    ] = BlindOptions.min_quality,
    as_json: JsonOption = False,
) -> None:
    """Find crater rims in an image without any prior."""
    overlay = output.with_name(f"{output.stem}_overlay.png")
    if image.resolve() in (output.resolve(), overlay.resolve()):
        raise InputError(image, "would be overwritten by the result: choose another --output")
    if sun_deg is not None and not math.isfinite(sun_deg):
        raise InputError("--sun", f"expected an angle in degrees, found {sun_deg}")
    pixels = read_foreign_image(image)
    light_rad = None if sun_deg is None else math.radians(sun_deg)
    began_s = time.perf_counter()
    try:
        blind = BlindOptions(min_radius_px=min_radius_px, min_quality=min_quality)
        rims = METHODS[method](pixels, light_rad, blind)
    except EstimationError as error:
        raise InputError(image, f"{error}; leave out --sun to go by the image") from error
    detect_ms = 1e3 * (time.perf_counter() - began_s)
    write_rims_csv(output, rims, image.name)
    write_overlay(overlay, pixels, rims)
    if as_json:
        result = {"image": str(image), "method": method.value, "detect_ms": detect_ms, **rims_json(rims)}
        out.print_json(json.dumps({**result, "csv": str(output), "overlay": str(overlay)}))
        return
    light = "" if math.isnan(rims.light_rad) else f", lit from {math.degrees(rims.light_rad) % 360.0:.0f} deg"
    say(f"{len(rims) or 'no'} rims{light}\n{output}\n{overlay}")


def main() -> None:
    """Run the command line: a known error is one line on stderr and exit code 2."""
    try:
        app()
    except CraternavError as error:
        err.print(f"craternav: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
