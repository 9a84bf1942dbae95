"""Command that checks a data set, and summarises what it holds."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from craternav_fg.catalogs.common_shift import unknown_height_warnings
from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import JsonOption
from craternav_fg.cli.terminal import out, say, three_digits, warn
from craternav_fg.dataset import Dataset
from craternav_fg.pipeline import catalog_warnings, input_warnings
from craternav_fg.pipeline.processed_images import processed_images
from craternav_fg.pipeline.repeated_images import repeated_images


@app.command(epilog=example("check runs/data"))
def check(
    data: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    as_json: JsonOption = False,
) -> None:
    """Check a data set as `reconstruct` does before it begins, and summarise it."""
    dataset = Dataset.open(data)
    values = _summary(dataset)
    if as_json:
        out.print_json(json.dumps(values))
    else:
        _show(values)
    for warning in values["warnings"]:
        warn(warning)


def _summary(data: Dataset) -> dict[str, Any]:
    """Describe a data set by numbers and texts that JSON can carry."""
    catalog, measured, imu = data.catalog, data.measurements, data.imu
    processed = processed_images(data)
    diameters_km = 2e-3 * catalog.semi_major_m
    return {
        "body": data.body.name,
        "body_radius_m": data.body.radius_m,
        "frames": len(data),
        "span_s": 1e-9 * int(data.stamps_ns[-1] - data.stamps_ns[0]),
        "image_size_px": [data.camera.width_px, data.camera.height_px],
        "images": None if measured is not None else len(data.image_paths),
        "rims_per_frame": None if measured is None else [len(frame.rims) for frame in measured],
        "arcs": sum(len(frame.arcs) for frame in measured or ()),
        "sun_tilts": sum(frame.sun is not None for frame in measured or ()),
        "imu_rate_hz": None if imu is None else 1e9 / float(np.median(np.diff(imu.stamps_ns))),
        "motion_model": None if data.motion is None else data.motion.name,
        "sensors": [sensor.name for sensor in data.sensors],
        "point_features": data.features is not None,
        "craters": len(catalog),
        "diameter_km": [float(diameters_km.min()), float(diameters_km.max())],
        "rim_heights": catalog.has_heights,
        "map_errors": catalog.errors is not None,
        "initial_state": data.initial is not None,
        "truth": data.truth is not None,
        "apriori_states": data.apriori is not None,
        "warnings": [
            *catalog_warnings.unusual_body(catalog),
            *catalog_warnings.heights_in_km(catalog),
            *catalog_warnings.angles_in_radians(catalog),
            *input_warnings.unknown_sensors(data.ignored),
            *input_warnings.dead_imu(None if data.motion is not None else data.imu),
            *input_warnings.saturated_imu(None if data.motion is not None else data.imu),
            *input_warnings.empty_logs({one.name: len(one) for one in data.sensors}),
            *input_warnings.colour_images(data.in_colour),
            *catalog_warnings.repeated_craters(data.repeated_craters),
            *input_warnings.repeated_images(_repeated(data)),
            *input_warnings.equalised_images(processed),
            *input_warnings.repeated_lines(processed),
            *input_warnings.blurred_images(processed, data.camera.psf_sigma_px),
            *input_warnings.departing_sun(data.sun_departure_rad),
            *unknown_height_warnings(catalog.unknown_height_sigma_m),
        ],
    }


def _repeated(data: Dataset) -> dict[str, str]:
    """Names of images that are copies, and of what they are copies of."""
    if data.measurements is not None:
        return {}
    names = [path.name for path in data.image_paths]
    return {names[k]: names[first] for k, first in repeated_images(data.image_paths).items()}


def _show(values: dict[str, Any]) -> None:
    """Print what `_summary` gives."""
    width_px, height_px = values["image_size_px"]
    small_km, large_km = (three_digits(value) for value in values["diameter_km"])
    imu = values["imu_rate_hz"]
    lines = {
        "body": f"{values['body']}, sphere of {1e-3 * values['body_radius_m']:g} km",
        "frames": f"{values['frames']:,} over {values['span_s']:g} s",
        "images": f"{values['images']} of {width_px} x {height_px} px" if values["images"] else "not read",
        "rims": _rims(values),
        "IMU": "none" if imu is None else f"{three_digits(imu)} Hz",
        "motion": f"model {values['motion_model']}" if values["motion_model"] else "measured by the IMU",
        "sensors": ", ".join([*values["sensors"], *["point features"] * values["point_features"]]) or "none",
        "catalogue": f"{values['craters']:,} craters, diameters {small_km} to {large_km} km, "
        f"{'with' if values['rim_heights'] else 'without'} heights, "
        f"{'with its errors' if values['map_errors'] else 'exact, unless the rims show otherwise'}",
        "initial": "given" if values["initial_state"] else "none: found from the first images",
        "truth": "given" if values["truth"] else "none",
        "a-priori": "given" if values["apriori_states"] else "none",
    }
    for name, text in lines.items():
        say(f"{name:10} {text}")


def _rims(values: dict[str, Any]) -> str:
    counts = values["rims_per_frame"]
    if counts is None:
        return "to be measured in the images"
    others = f"{values['arcs']} arcs, {values['sun_tilts']} sun tilts"
    return f"{sum(counts):,} measured, {min(counts)} to {max(counts)} in a frame; {others}"
