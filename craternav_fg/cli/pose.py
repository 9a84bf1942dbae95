"""Command that computes a pose from the matched rims of one image."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.camera import Camera
from craternav_fg.cli.app import app, example
from craternav_fg.cli.catalog_reading import body_of_radius, warn_of
from craternav_fg.cli.options import (
    CameraOption,
    CatalogBodyOption,
    CatalogOption,
    JsonOption,
    numbers_of,
)
from craternav_fg.cli.poses import show_pose
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.dataset.ellipses import SIGMA_RANGE_PX
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.resection.files import as_plain_data, read_rims, resection_problem
from craternav_fg.resection.problem import ResectionResult, Status
from craternav_fg.resection.robust import solve_all, solve_robustly


@app.command(epilog=example("pose matched.csv --camera sensor.yaml --catalog craters.parquet --robust"))
def pose(
    rims: Annotated[
        Path,
        typer.Argument(help="CSV of ellipses, each with its crater, as `craternav identify -o` writes it."),
    ],
    camera: CameraOption,
    catalog: CatalogOption,
    attitude: Annotated[
        str | None, typer.Option(help="Attitude gRb of another sensor, as a quaternion w,x,y,z.")
    ] = None,
    attitude_sigma_deg: Annotated[
        float, typer.Option(min=0.0, help="Its standard deviation per axis; 0 for an exact attitude.")
    ] = 0.0,
    sun: Annotated[
        str | None,
        typer.Option(
            help="TILT,SIGMA,X,Y,Z: angle of the direction towards the sun on the ground amid the rims, from "
            "the image's x axis towards its y axis, and its standard deviation, deg; unit vector towards the "
            "sun in g."
        ),
    ] = None,
    robust: Annotated[bool, typer.Option("--robust", help="Find wrong matches and reject them.")] = False,
    sigma_px: Annotated[
        float,
        typer.Option(
            min=SIGMA_RANGE_PX[0],
            max=SIGMA_RANGE_PX[1],
            help="Standard deviation of the edge points, for files without a column sigma_px.",
        ),
    ] = 1.0,
    edge_points: Annotated[
        int, typer.Option(min=6, max=100_000, help="Number of edge points of each ellipse.")
    ] = 60,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the lander's pose from the matched rims of one image, without an initial guess."""
    sensor = _undistorted_camera(camera)
    matched, craters, report = read_rims(
        rims, sensor, catalog, body_of_radius(body_radius_m), sigma_px=sigma_px, edge_points=edge_points
    )
    warn_of(catalog, report)
    problem = resection_problem(
        matched,
        craters,
        sensor,
        attitude_wxyz=numbers_of("--attitude", attitude, 4),
        attitude_sigma_deg=attitude_sigma_deg,
        sun=numbers_of("--sun", sun, 5),
    )
    result = solve_robustly(problem) if robust else solve_all(problem)
    values = as_plain_data(problem, result, craters.body)
    if as_json:
        out.print_json(json.dumps(values, allow_nan=False))
    else:
        _show(values)
    _require_pose(result)
    for warning in result.warnings:
        warn(warning)


def _undistorted_camera(path: Path) -> Camera:
    camera = read_camera(path)
    if camera.distorts:
        raise InputError(
            path, "expected a lens without distortion, whose image of a rim is an ellipse; found distortion"
        )
    return camera


def _show(values: dict[str, Any]) -> None:
    if values["wrong"]:
        say(f"wrong matches, rejected: {', '.join(values['wrong'])}")
    for found in values["poses"]:
        show_pose(found, f"probability {found['probability']:.3f}: ")


def _require_pose(result: ResectionResult) -> None:
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS):
        raise EstimationError(f"{result.status.value}: {result.reason}")
