"""Command that detects rims in an image."""

import json
import math
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import ForceOption, JsonOption, require_free, require_kept
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.dataset.ellipses import detections_as_plain_data, write_detected_ellipses
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, FoundRims, find_rims
from craternav_fg.vision.learned import find_rims_learned


class Method(StrEnum):
    """Blind detectors."""

    TEMPLATE = "template"
    LEARNED = "learned"
    CANNY = "canny"


_DETECTORS = {Method.TEMPLATE: find_rims, Method.LEARNED: find_rims_learned, Method.CANNY: find_rims_canny}


@app.command(epilog=example("detect frame.png --sun-deg 180 -o runs/rims.csv"))
def detect(
    image: Annotated[Path, typer.Argument(help="Image file of any origin: PNG, TIFF, JPEG.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="CSV of ellipses; the overlay is written beside it.")
    ] = Path("runs/detect.csv"),
    sun_deg: Annotated[
        float | None,
        typer.Option(
            help="Direction towards the sun in the image, deg: 0 right, 90 down, 180 left.",
            show_default="estimated from the image",
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            help="Template candidates, checked by rules (template) or by a network (learned); or Canny edges."
        ),
    ] = Method.TEMPLATE,
    min_radius_px: Annotated[
        float, typer.Option(min=4.0, help="Smallest radius to search, px.")
    ] = BlindOptions.min_radius_px,
    min_quality: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Smallest quality of a rim; a lower limit finds more rims, also false ones.",
        ),
    ] = BlindOptions.min_quality,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Detect crater rims in an image without any prior."""
    overlay = output.with_name(f"{output.stem}_overlay.png")
    require_kept([image], [output, overlay])
    require_free(output, force=force)
    sun_rad = _angle_rad("--sun-deg", sun_deg)
    pixels = read_foreign_image(image)
    began_s = time.perf_counter()
    options = BlindOptions(min_radius_px=min_radius_px, min_quality=min_quality)
    rims = _DETECTORS[method](pixels, sun_rad, options)
    detect_ms = 1e3 * (time.perf_counter() - began_s)
    _warn_of_sun(image, rims)
    with replacing(output) as table, replacing(overlay) as picture:
        # Both, or neither.
        write_detected_ellipses(table, rims.ellipses_px, image.name)
        write_overlay(picture, pixels, rims)
    if as_json:
        values = {"image": str(image), "method": method.value, "detect_ms": detect_ms, **_plain(rims)}
        out.print_json(json.dumps({**values, "csv": str(output), "overlay": str(overlay)}))
        return
    towards_deg = math.degrees(rims.sun_angle_rad) % 360.0
    sun = "" if math.isnan(towards_deg) else f", the sun towards {towards_deg:.0f} deg"
    found = f"{len(rims)} rims" if len(rims) else f"no rims: {_why_none(pixels, options)}"
    say(f"{found}{sun}\n{output}\n{overlay}")


def _angle_rad(option: str, angle_deg: float | None) -> float | None:
    if angle_deg is None:
        return None
    if not math.isfinite(angle_deg):
        raise InputError(option, f"expected an angle in degrees, found {angle_deg}")
    return math.radians(angle_deg)


def _why_none(pixels: npt.NDArray[np.generic], options: BlindOptions) -> str:
    """Say why an image shows no rims."""
    grey = brightness(pixels)
    known = grey[np.isfinite(grey)]
    if not len(known):
        return "the image has no data"
    if known.min() == known.max():
        return "all pixels have one value"
    if options.max_radius_share * min(grey.shape) < options.min_radius_px:
        height, width = grey.shape
        return f"{width} x {height} px are too small for a radius of {options.min_radius_px:g} px"
    return "nothing looks like a lit crater, or what does is lit from no common direction"


def _warn_of_sun(path: Path, rims: FoundRims) -> None:
    """Warn of a direction of the sun that was given and that the craters contradict."""
    if rims.sun_contradicted:
        given, seen = (math.degrees(a) % 360.0 for a in (rims.sun_angle_rad, rims.seen_sun_angle_rad))
        warn(
            f"{path}: the sun is given at {given:.0f} deg in the image, but its craters look lit from "
            f"{seen:.0f} deg; omit --sun-deg to estimate it from the image"
        )


def _plain(rims: FoundRims) -> dict[str, Any]:
    return detections_as_plain_data(rims.ellipses_px, rims.covariance_px, rims.quality, rims.sun_angle_rad)
