"""Command that detects rims in images and mosaics."""

import json
import math
import os
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.cli.app import app, example
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import (
    ForceOption,
    JsonOption,
    WorkerOptions,
    require_free,
    require_kept,
    require_unused,
)
from craternav_fg.cli.terminal import out, progress_bars, say, warn
from craternav_fg.dataset.ellipses import write_detected_ellipses
from craternav_fg.dataset.foreign_images import TooManyPixelsError, read_foreign_image
from craternav_fg.detection.images import SUMMARY, Where, detect_images, rims_as_plain_data
from craternav_fg.detection.mosaics import CATALOG, OVERLAY, TABLE, detect_mosaic, is_mosaic
from craternav_fg.detection.settings import DetectionSettings, Method
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import replacing
from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.detect import BlindOptions, FoundRims

_TABLE, _FOLDER = Path("runs/detect.csv"), Path("runs/detect")


@dataclass(frozen=True)
class Search:
    """What is searched."""

    sun_deg: Annotated[
        float | None,
        typer.Option(
            help="Direction towards the sun in the image, deg: 0 right, 90 down, 180 left.",
            show_default="estimated from the image",
        ),
    ] = None
    method: Annotated[
        Method,
        typer.Option(
            help="A network proposes craters (network); a matched filter and rules, which find less in "
            "photographs (template); or Canny edges."
        ),
    ] = Method.NETWORK
    min_radius_px: Annotated[float, typer.Option(min=4.0, help="Smallest radius to search, px.")] = (
        BlindOptions.min_radius_px
    )
    min_quality: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Smallest quality of a rim; lower values list more rims, including false ones.",
        ),
    ] = BlindOptions.min_quality

    def settings(self) -> DetectionSettings:
        """Return them checked.

        Returns
        -------
        DetectionSettings

        Raises
        ------
        InputError
            When the direction towards the sun is no number.
        """
        if self.sun_deg is not None and not math.isfinite(self.sun_deg):
            raise InputError("--sun-deg", f"expected an angle in degrees, found {self.sun_deg}")
        return DetectionSettings(self.method, self.sun_deg, self.min_radius_px, self.min_quality)


@dataclass(frozen=True)
class ShownBody:
    """What a mosaic shows."""

    body: Annotated[
        str | None,
        typer.Option(help="Body of a mosaic with coordinates.", show_default="that of its coordinates"),
    ] = None
    body_radius_m: Annotated[
        float | None,
        typer.Option(min=1.0, help="Radius of the sphere of --body.", show_default="that known by its name"),
    ] = None

    def named(self) -> Body | None:
        """Return the body, None when none is named.

        Returns
        -------
        Body or None

        Raises
        ------
        InputError
            When its radius is not known.
        """
        if self.body is None and self.body_radius_m is None:
            return None
        return named_body(self.body or "", self.body_radius_m)


@app.command(epilog=example("detect frames/*.png -o runs/rims"))
@with_option_groups
def detect(
    context: typer.Context,
    images: Annotated[list[Path], typer.Argument(help="Image files of any origin: PNG, TIFF, JPEG.")],
    search: Search,
    where: WorkerOptions,
    shown: ShownBody,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="CSV of ellipses of one image, with the overlay beside it; or a folder, for several images "
            "or a mosaic.",
            show_default=f"{_TABLE}, or the folder {_FOLDER}",
        ),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Detect crater rims in images without any prior."""
    settings = search.settings()
    of_body = {field.name for field in fields(ShownBody)}
    if len(images) == 1 and not _is_folder(output):
        of_workers = {field.name for field in fields(WorkerOptions)}
        require_unused(
            context, of_body | of_workers, "for one image that is not searched into a folder (-o FOLDER)"
        )
        _detect_one(images[0], output or _TABLE, settings, force=force, as_json=as_json)
        return
    if len(images) > 1:
        require_unused(context, of_body, "for several images, only for one mosaic")
    folder = output or _FOLDER
    _require_folder(folder, len(images))
    require_kept(images, [folder])
    run_by = Where(*where.checked(os.cpu_count() or 1))
    body = shown.named()
    if len(images) == 1 and (body is not None or is_mosaic(images[0])):
        _detect_mosaic(images[0], folder, settings, run_by, body, force=force, as_json=as_json)
    else:
        _detect_many(images, folder, settings, run_by, force=force, as_json=as_json)


def _require_folder(folder: Path, count: int) -> None:
    if folder.suffix == ".csv" and not folder.is_dir():
        raise InputError(folder, f"expected a folder for the results of {count} images")
    require_free(folder, force=True)


def _is_folder(output: Path | None) -> bool:
    return output is not None and (output.suffix == "" or output.is_dir())


def _detect_one(
    image: Path, output: Path, settings: DetectionSettings, *, force: bool, as_json: bool
) -> None:
    """Write table and overlay of one image."""
    overlay = output.with_name(f"{output.stem}_overlay.png")
    require_kept([image], [output, overlay])
    for path in (output, overlay):
        require_free(path, force=force)
    try:
        pixels = read_foreign_image(image, opacity=True)
    except TooManyPixelsError as error:
        raise CraternavError(f"{error}, or name a folder (-o FOLDER) to read it in windows") from None
    began_s = time.perf_counter()
    rims = settings.detect(pixels, settings.sun_rad)
    detect_ms = 1e3 * (time.perf_counter() - began_s)
    values = rims_as_plain_data(rims)
    warning = values.pop("warning")
    if warning is not None:
        warn(f"{image}: {warning}")
    with replacing(output) as table, replacing(overlay) as picture:
        # Both, or neither.
        write_detected_ellipses(table, rims.ellipses_px, rims.traced, image.name)
        write_overlay(picture, pixels, rims)
    if as_json:
        values = {"image": str(image), "method": settings.method.value, "detect_ms": detect_ms, **values}
        out.print_json(json.dumps({**values, "csv": str(output), "overlay": str(overlay)}))
        return
    coarse = int(np.sum(~rims.traced))
    found = f"{len(rims)} rims" if len(rims) else f"no rims: {_why_none(pixels, settings.options())}"
    found += f" ({coarse} not traced, coarse)" if coarse else ""
    say(f"{found}{_sun(rims)}\n{output}\n{overlay}")


def _detect_many(
    images: list[Path],
    folder: Path,
    settings: DetectionSettings,
    where: Where,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Write tables and overlays of several images into a folder; it is an error when some cannot be read."""
    try:
        with progress_bars() as report:
            rows = detect_images(images, folder, settings, where, force=force, progress=report)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"finished images are kept; {_resuming(force=force)} resumes") from None
    for row in rows:
        if row["warning"] is not None:
            warn(f"{row['image']}: {row['warning']}")
        if row["error"] is not None:
            warn(row["error"])
    failed = sum(row["error"] is not None for row in rows)
    if as_json:
        out.print_json(json.dumps({"folder": str(folder), "images": rows}))
    else:
        rims = sum(row["rims"] or 0 for row in rows)
        say(f"{rims} rims in {len(rows) - failed} of {len(rows)} images\n{folder / SUMMARY}")
    if failed:
        raise CraternavError(
            f"{failed} of {len(rows)} images failed, see the warnings above; the others are done"
        )


def _detect_mosaic(
    image: Path,
    folder: Path,
    settings: DetectionSettings,
    where: Where,
    body: Body | None,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Write table, overlay and catalogue of a mosaic; it is an error when windows cannot be read."""
    try:
        with progress_bars() as report:
            found = detect_mosaic(image, folder, settings, where, body=body, force=force, progress=report)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"finished windows are kept; {_resuming(force=force)} resumes") from None
    for error in found.errors:
        warn(error)
    if found.contradicted:
        warn(
            f"{image}: in {found.contradicted} of {found.windows} windows craters look lit from elsewhere "
            "than --sun-deg says; omit it to estimate the direction"
        )
    if found.undecided:
        warn(
            f"{image}: {found.undecided} windows do not show from where they are lit: craters lit from both "
            "sides are listed there; --sun-deg gives the direction"
        )
    catalog = folder / CATALOG if found.craters else None
    if as_json:
        values = {"image": str(image), "windows": found.windows, "rims": len(found.rims)}
        values |= {"catalog": None if catalog is None else str(catalog), "craters": found.craters}
        out.print_json(json.dumps({**values, "csv": str(folder / TABLE)}))
    else:
        say(f"{len(found.rims)} rims in {found.windows} windows\n{folder / TABLE}\n{folder / OVERLAY}")
        if found.craters is None:
            say("no catalogue: the image has no coordinates")
        if catalog is not None:
            say(f"{catalog}")
    if found.errors:
        raise CraternavError(f"{len(found.errors)} of {found.windows} windows failed; the others are done")


def _resuming(*, force: bool) -> str:
    """Name the command that goes on with what is done."""
    return "the same command without --force" if force else "the same command"


def _why_none(pixels: npt.NDArray[np.generic], options: BlindOptions) -> str:
    """Explain why an image shows no rims."""
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


def _sun(rims: FoundRims) -> str:
    """Describe where the sun is."""
    if math.isnan(rims.sun_angle_rad):
        return ", the image does not show from where it is lit" if len(rims) else ""
    sure = "" if math.isnan(rims.sun_probability) else f" (probability {rims.sun_probability:.2f})"
    return f", the sun towards {math.degrees(rims.sun_angle_rad) % 360.0:.0f} deg{sure}"
