"""Command that identifies the craters of an image, and the pose, without any prior position."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import unknown_height_warnings
from craternav_fg.cli.app import app, example
from craternav_fg.cli.catalog_reading import read_any_catalog
from craternav_fg.cli.intrinsics_options import IntrinsicsOptions
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import (
    AttitudeOptions,
    CameraOption,
    CatalogBodyOption,
    CatalogOption,
    ForceOption,
    JsonOption,
    numbers_of,
    require_free,
    require_kept,
    require_suffix,
)
from craternav_fg.cli.poses import focal_text, show_pose
from craternav_fg.cli.terminal import note, out, say, warn
from craternav_fg.dataset.ellipses import read_detected_ellipses, write_matched_ellipses
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.search import Identification, IdentifyOptions, KnownAttitude
from craternav_fg.matching.identify.triple_index import index_path, load_or_build
from craternav_fg.pipeline.input_warnings import mounting_of_image
from factors.arrays import FloatArray

# A search needs room for the error of the attitude, also of one stated as exact, and gains nothing from one
# that is hardly known.
_ATTITUDE_SIGMA_DEG = (1e-3, 10.0)


@dataclass(frozen=True)
class WrittenRims:
    """Where the identified rims are written."""

    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write the rims with their CRATER_ID, for `craternav pose`."),
    ] = None
    force: ForceOption = False


@app.command(
    epilog=example("identify rims.csv --camera sensor.yaml --catalog craters.parquet -o matched.csv")
)
@with_option_groups
def identify(
    rims: Annotated[
        Path, typer.Argument(help="CSV of ellipses as `craternav detect` writes it, or an image file.")
    ],
    camera: CameraOption,
    catalog: CatalogOption,
    attitude: AttitudeOptions,
    intrinsics: IntrinsicsOptions,
    written: WrittenRims,
    altitude_km: Annotated[
        str | None,
        typer.Option(
            help="Lowest and highest altitude to search.",
            show_default="1,2000; as low as the craters are small",
        ),
    ] = None,
    index: Annotated[
        Path | None,
        typer.Option(
            help="Index of the catalogue; built when the file is missing.", show_default="in the user's cache"
        ),
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Identify the craters of an image, and the lander's pose, without any prior."""
    path = index_path(catalog) if index is None else index
    require_suffix(path, [".npz"])
    output = written.output
    if output is not None:
        require_kept([rims, camera, catalog, path], [output])
        require_free(output, force=written.force)
    sensor = intrinsics.of(read_camera(camera))
    known = _attitude(attitude)
    options = IdentifyOptions.of(sensor, _altitudes(altitude_km))
    ellipses, traced, pixels = _read(rims, sensor)
    craters, _ = read_any_catalog(catalog, body_radius_m)
    ready, index_note = load_or_build(path, craters)
    if index_note:
        note(f"index: {index_note}")
    if pixels is None:
        found = identify_detected(ellipses, traced, sensor, ready, known, options)
    else:
        # Rims that are detected already need no detector.
        from craternav_fg.matching.identify.from_image import identify_image

        detected, found = identify_image(pixels, sensor, ready, known, options)
        ellipses = detected.ellipses_px
    if found.identified:
        of_heights = unknown_height_warnings(craters.unknown_height_sigma_m)
        sigma_m = float(np.sqrt(np.diag(found.covariance)[3:].min()))
        of_mounting = mounting_of_image(sensor, sigma_m)
        found = replace(found, warnings=(*found.warnings, *of_heights, *of_mounting))
    values = _plain(found, ellipses, craters.body)
    if output is not None and found.identified:
        write_matched_ellipses(output, ellipses, found.craters)
    if as_json:
        out.print_json(json.dumps({**values, "index": index_note or f"{path}: loaded"}, allow_nan=False))
    else:
        _show(values)
    _require_answer(found)
    for warning in found.warnings:
        warn(warning)


def _attitude(given: AttitudeOptions) -> KnownAttitude | None:
    values = given.values()
    if values is None:
        return None
    wxyz, sigma_deg = values
    low, high = _ATTITUDE_SIGMA_DEG
    if not sigma_deg <= high:
        raise InputError("--attitude-sigma-deg", f"expected {high:g} deg or less, found {sigma_deg:g}")
    q = np.array(wxyz)
    # Scaled first, as the squares of very large or small numbers are not finite.
    q /= np.abs(q).max()
    return KnownAttitude(frames.from_quaternion_wxyz(q), math.radians(max(sigma_deg, low)))


def _altitudes(text: str | None) -> tuple[float, float] | None:
    values = numbers_of("--altitude-km", text, 2)
    if values is None:
        return None
    if not 0.0 < values[0] < values[1]:
        raise InputError("--altitude-km", f"expected 0 < MIN < MAX, found {text}")
    return 1e3 * values[0], 1e3 * values[1]


def _read(
    path: Path, camera: Camera
) -> tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.generic] | None]:
    """Read ellipses (n, 5), px and rad, and whether each was traced; or an image in which to find them."""
    if path.suffix.lower() == ".csv":
        return *read_detected_ellipses(path, camera), None
    return np.empty((0, 5)), np.empty(0, dtype=np.bool_), _image(path, camera)


def _image(path: Path, camera: Camera) -> npt.NDArray[np.generic]:
    """Read an image of the camera."""
    pixels = read_foreign_image(path, opacity=True)
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        size = f"{camera.width_px} x {camera.height_px}"
        raise InputError(path, f"expected an image of the camera's {size} pixels, found {width} x {height}")
    return pixels


def _plain(found: Identification, ellipses: FloatArray, body: Body) -> dict[str, Any]:
    """Return lists, numbers and texts that JSON can carry."""
    rims = [
        {"center_x_px": round(float(x), 3), "center_y_px": round(float(y), 3), "crater": name}
        for (x, y), name in zip(ellipses[:, :2], found.craters, strict=True)
    ]
    pose = None
    if found.identified:
        gP = found.gTb[:3, 3]
        latitude, longitude = frames.latitude_longitude(gP)
        R = found.gTb[:3, :3]
        # As in a run's files: positions in g.
        covariance = frames.rotate_position_block(found.covariance, R)
        pose = {
            "position_m": gP.tolist(),
            "attitude_wxyz": frames.to_quaternion_wxyz(R).tolist(),
            "latitude_deg": float(np.degrees(latitude)),
            "longitude_deg": float(np.degrees(longitude)),
            "altitude_m": float(body.altitude_m(gP)),
            "body": body.name,
            "body_radius_m": body.radius_m,
            "covariance": covariance.tolist(),
            "position_sigma_m": np.sqrt(np.diag(covariance)[3:]).tolist(),
            "attitude_sigma_deg": np.degrees(np.sqrt(np.diag(covariance)[:3])).tolist(),
        }
    return {
        "status": found.status.name.lower(),
        "reason": found.reason,
        "rims": rims,
        "pose": pose,
        "log_chance": found.log_chance,
        "sigma_px": found.sigma_px if found.identified else None,
        "focal_scale": found.focal_scale if math.isfinite(found.focal_scale) else None,
        "focal_scale_sigma": found.focal_scale_sigma if math.isfinite(found.focal_scale_sigma) else None,
        "warnings": list(found.warnings),
        "seconds": found.seconds,
    }


def _show(values: dict[str, Any]) -> None:
    if values["pose"] is None:
        return
    say("      x px       y px      crater")
    for rim in values["rims"]:
        say(f"{rim['center_x_px']:10.3f} {rim['center_y_px']:10.3f}      {rim['crater'] or '-'}")
    identified = sum(rim["crater"] is not None for rim in values["rims"])
    chance = values["log_chance"] / math.log(10.0)
    say(
        f"{identified} of {len(values['rims'])} rims identified; probability that they agree by chance "
        f"10^{chance:.1f}; {1e3 * values['seconds']:.0f} ms"
    )
    show_pose(values["pose"])
    say(f"standard deviation of the rims' centres {values['sigma_px']:.2g} px{focal_text(values)}")


def _require_answer(found: Identification) -> None:
    if not found.identified:
        raise EstimationError(f"{found.status.value}: {found.reason}")
