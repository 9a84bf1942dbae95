"""Command that finds rims in an image."""

import json
import math
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.terminal import out, say
from craternav_fg.dataset.ellipses import detections_as_plain_data, write_detected_ellipses
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, find_rims


class Method(StrEnum):
    """Blind detectors."""

    TEMPLATE = "template"
    CANNY = "canny"


METHODS = {Method.TEMPLATE: find_rims, Method.CANNY: find_rims_canny}


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
            help="Where in the image the light comes from: 0 right, 90 below, 180 left.",
            show_default="seen",
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
    sun_angle_rad = None if sun_deg is None else math.radians(sun_deg)
    began_s = time.perf_counter()
    try:
        blind = BlindOptions(min_radius_px=min_radius_px, min_quality=min_quality)
        rims = METHODS[method](pixels, sun_angle_rad, blind)
    except EstimationError as error:
        raise InputError(image, f"{error}; leave out --sun to go by the image") from error
    detect_ms = 1e3 * (time.perf_counter() - began_s)
    write_detected_ellipses(output, rims.ellipses_px, image.name)
    write_overlay(overlay, pixels, rims)
    if as_json:
        found = detections_as_plain_data(
            rims.ellipses_px, rims.covariance_px, rims.quality, rims.sun_angle_rad
        )
        result = {"image": str(image), "method": method.value, "detect_ms": detect_ms, **found}
        out.print_json(json.dumps({**result, "csv": str(output), "overlay": str(overlay)}))
        return
    light = (
        ""
        if math.isnan(rims.sun_angle_rad)
        else f", lit from {math.degrees(rims.sun_angle_rad) % 360.0:.0f} deg"
    )
    say(f"{len(rims) or 'no'} rims{light}\n{output}\n{overlay}")
