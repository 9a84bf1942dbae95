"""Command that computes a pose from the matched rims of one image."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.catalogs.common_shift import unknown_height_warnings
from craternav_fg.cli.app import app, example
from craternav_fg.cli.catalog_reading import body_of_radius, warn_of
from craternav_fg.cli.intrinsics_options import IntrinsicsOptions
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import (
    AttitudeOptions,
    CameraOption,
    CatalogBodyOption,
    CatalogOption,
    JsonOption,
    numbers_of,
)
from craternav_fg.cli.poses import focal_text, show_pose
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.dataset.ellipses import SIGMA_RANGE_PX
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.pipeline.input_warnings import mounting_of_image
from craternav_fg.resection.files import as_plain_data, read_rims, resection_problem
from craternav_fg.resection.intrinsics import IntrinsicsPrior, with_unknown_intrinsics
from craternav_fg.resection.map_errors import solve_with_map_errors
from craternav_fg.resection.problem import ResectionResult, Status
from craternav_fg.resection.robust import solve_all, solve_robustly


@dataclass(frozen=True)
class KnownSun:
    """Direction of the sun in the image and in g."""

    sun_tilt_deg: Annotated[
        str | None,
        typer.Option(
            metavar="TILT,SIGMA",
            help="Direction towards the sun in the image, on the ground between the rims: angle from the "
            "x axis towards the y axis, and its standard deviation. Needs --sun.",
        ),
    ] = None
    sun: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Direction towards the sun in g; needed with --sun-tilt-deg."),
    ] = None

    def values(self) -> list[float] | None:
        """Tilt, its sigma (deg) and direction; None without them.

        Raises
        ------
        InputError
            When one is given without the other.
        """
        tilt = numbers_of("--sun-tilt-deg", self.sun_tilt_deg, 2)
        direction = numbers_of("--sun", self.sun, 3)
        if (tilt is None) != (direction is None):
            raise InputError("--sun-tilt-deg, --sun", "expected both, found one")
        return None if tilt is None or direction is None else [*tilt, *direction]


@dataclass(frozen=True)
class RimNoise:
    """How well rims are measured."""

    sigma_px: Annotated[
        float,
        typer.Option(
            min=SIGMA_RANGE_PX[0],
            max=SIGMA_RANGE_PX[1],
            help="Standard deviation of edge points, for files without a column sigma_px.",
        ),
    ] = 1.0
    edge_points: Annotated[
        int, typer.Option(min=6, max=100_000, help="Number of edge points of each ellipse.")
    ] = 60
    sigma_ellipse_px: Annotated[
        float | None,
        typer.Option(
            min=SIGMA_RANGE_PX[0],
            max=SIGMA_RANGE_PX[1],
            help="Standard deviation of an ellipse's semi-axes and of each coordinate of its centre, in "
            "place of that of edge points.",
        ),
    ] = None


@app.command(epilog=example("pose matched.csv --camera sensor.yaml --catalog craters.parquet --robust"))
@with_option_groups
def pose(
    rims: Annotated[
        Path,
        typer.Argument(help="CSV of ellipses, each with its crater, as `craternav identify -o` writes it."),
    ],
    camera: CameraOption,
    catalog: CatalogOption,
    attitude: AttitudeOptions,
    light: KnownSun,
    noise: RimNoise,
    intrinsics: IntrinsicsOptions,
    robust: Annotated[bool, typer.Option("--robust", help="Find wrong matches and reject them.")] = False,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the lander's pose from the matched rims of one image, without an initial guess."""
    sensor = read_camera(camera)
    body = body_of_radius(body_radius_m)
    matched, craters, report = read_rims(rims, sensor, catalog, body, **vars(noise))
    warn_of(catalog, report)
    wxyz, sigma_deg = attitude.values() or (None, 0.0)
    problem = resection_problem(
        matched, craters, sensor, attitude_wxyz=wxyz, attitude_sigma_deg=sigma_deg, sun=light.values()
    )
    problem, result = solve_with_map_errors(problem, craters, solve_robustly if robust else solve_all)
    result = with_unknown_intrinsics(problem, result, IntrinsicsPrior.of(intrinsics.of(sensor)))
    of_heights = unknown_height_warnings(craters.unknown_height_sigma_m)
    result = replace(result, warnings=(*result.warnings, *of_heights))
    values = as_plain_data(problem, result, craters, sensor)
    sigma_m = min((min(found["position_sigma_m"]) for found in values["poses"]), default=math.inf)
    values["warnings"] += mounting_of_image(sensor, sigma_m)
    if as_json:
        out.print_json(json.dumps(values, allow_nan=False))
    else:
        _show(values)
    _require_pose(result)
    for warning in values["warnings"]:
        warn(warning)


def _show(values: dict[str, Any]) -> None:
    if values["wrong"]:
        say(f"wrong matches, rejected: {', '.join(values['wrong'])}")
    for found in values["poses"]:
        show_pose(found, f"probability {found['probability']:.3f}: ")
    if values["poses"]:
        scale = values["sigma_scale"]
        told = "as in the file" if scale == 1.0 else f"{scale:.3g} times those of the file"
        say(f"standard deviations of the rims {told}{focal_text(values)}")


def _require_pose(result: ResectionResult) -> None:
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS):
        raise EstimationError(f"{result.status.value}: {result.reason}")
