"""Command on the matched rims of one image."""

import json
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.body import Body
from craternav_fg.cli.app import JsonOption, app, numbers_of
from craternav_fg.cli.catalog_reading import CatalogBodyOption, warn, warn_of
from craternav_fg.cli.terminal import out, show_poses
from craternav_fg.dataset.ellipses import SIGMA_RANGE_PX
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.files import as_plain_data, read_rims, resection_problem
from craternav_fg.resection.problem import Status
from craternav_fg.resection.robust import solve_robustly


@app.command()
def pose(
    rims: Annotated[Path, typer.Argument(help="CSV of ellipses, each with its crater (see the README).")],
    camera: Annotated[Path, typer.Option(help="The camera's sensor.yaml.")],
    catalog: Annotated[Path, typer.Option(help="Catalogue: .parquet, or a table that can be imported.")],
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
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the lander's pose from the matched rims of one image, without a start."""
    body = None if body_radius_m is None else Body("", body_radius_m, 1.0, (0.0, 0.0, 0.0))
    sensor = read_camera(camera)
    if sensor.distorts:
        raise InputError(
            camera, "expected a lens without distortion: an ellipse in its image is no ellipse of a rim"
        )
    matched, craters, report = read_rims(
        rims, sensor, catalog, body, sigma_px=sigma_px, edge_points=edge_points
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
    result = solve_robustly(problem) if robust else solve(problem)
    values = as_plain_data(problem, result, craters.body)
    if as_json:
        out.print_json(json.dumps(values, allow_nan=False))
    else:
        show_poses(values)
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS):
        raise EstimationError(f"{result.status.value}: {result.reason}")
    for warning in result.warnings:
        warn(warning)
