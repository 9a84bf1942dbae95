"""Command that finds out which craters an image shows, and from where, without any prior position."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.cli.app import JsonOption, app, numbers_of
from craternav_fg.cli.catalog_reading import CatalogBodyOption, read_any_catalog
from craternav_fg.cli.terminal import err, out, say
from craternav_fg.dataset.ellipses import read_ellipses, write_matched_ellipses
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.matching.identify.search import Identification, IdentifyOptions, KnownAttitude
from craternav_fg.matching.identify.search import identify as identify_rims
from craternav_fg.matching.identify.triple_index import load_or_build
from craternav_fg.pipeline.relocalisation import index_path
from craternav_fg.vision.detect import find_rims


@app.command()
def identify(
    rims: Annotated[
        Path, typer.Argument(help="CSV of ellipses as `craternav detect` writes it, or an image file.")
    ],
    camera: Annotated[Path, typer.Option(help="The camera's sensor.yaml.")],
    catalog: Annotated[Path, typer.Option(help="Catalogue: .parquet, or a table that can be imported.")],
    attitude: Annotated[
        str | None, typer.Option(help="Attitude gRb of a star tracker, as a quaternion w,x,y,z.")
    ] = None,
    attitude_sigma_deg: Annotated[
        float, typer.Option(min=1e-3, max=10.0, help="Its standard deviation per axis.")
    ] = 1.5,
    altitude_km: Annotated[
        str | None, typer.Option(help="LEAST,LARGEST altitude that is possible.", show_default="1,2000")
    ] = None,
    index: Annotated[
        Path | None,
        typer.Option(help="Where the catalogue's index is kept.", show_default="beside it, FILE.index.npz"),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write the rims with their CRATER_ID, for `craternav pose`."),
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the crater of each rim and the lander's pose, from nowhere; with an image, its rims first."""
    path = index_path(catalog) if index is None else index
    if path.suffix != ".npz":
        raise InputError(path, "expected a name that ends in .npz for the index")
    if output is not None and output.resolve() in (file.resolve() for file in (rims, camera, catalog, path)):
        raise InputError(output, "would be overwritten by the result: choose another --output")
    sensor = read_camera(camera)
    known = _attitude(attitude, attitude_sigma_deg)
    options = IdentifyOptions(altitudes_m=_altitudes(altitude_km))
    ellipses = read_ellipses(rims, sensor) if rims.suffix.lower() == ".csv" else _from_image(rims, sensor)
    craters, _ = read_any_catalog(catalog, body_radius_m)
    ready, said = load_or_build(path, craters)
    if said:
        err.print(f"craternav: index: {said}", highlight=False, soft_wrap=True)
    found = identify_rims(ellipses, sensor, ready, known, options)
    values = _plain(found, ellipses, craters.body)
    if output is not None and found.identified:
        write_matched_ellipses(output, ellipses, found.craters)
    if as_json:
        out.print_json(json.dumps({**values, "index": said or f"{path}: loaded"}, allow_nan=False))
    else:
        _show(values)
    if not found.identified:
        raise EstimationError(f"{found.status.value}: {found.reason}")


def _attitude(text: str | None, sigma_deg: float) -> KnownAttitude | None:
    values = numbers_of("--attitude", text, 4)
    if values is None:
        return None
    q = np.array(values)
    if not np.abs(q).max() > 0.0:
        raise InputError("--attitude", "expected a quaternion, found zero")
    q /= np.abs(q).max()
    return KnownAttitude(frames.from_quaternion_wxyz(q), math.radians(sigma_deg))


def _altitudes(text: str | None) -> tuple[float, float]:
    values = numbers_of("--altitude-km", text, 2)
    if values is None:
        return IdentifyOptions.altitudes_m
    if not 0.0 < values[0] < values[1]:
        raise InputError("--altitude-km", f"expected 0 < LEAST < LARGEST, found {text}")
    return 1e3 * values[0], 1e3 * values[1]


def _from_image(path: Path, camera: Camera) -> npt.NDArray[np.float64]:
    pixels = read_foreign_image(path)
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        size = f"{camera.width_px} x {camera.height_px}"
        raise InputError(path, f"expected an image of the camera's {size} pixels, found {width} x {height}")
    return find_rims(pixels).ellipses_px


def _plain(found: Identification, ellipses: npt.NDArray[np.float64], body: Body) -> dict[str, Any]:
    """Give lists, numbers and texts: what JSON can carry."""
    rims = [
        {"center_x_px": round(float(x), 3), "center_y_px": round(float(y), 3), "crater": name}
        for (x, y), name in zip(ellipses[:, :2], found.craters, strict=True)
    ]
    pose = None
    if found.identified:
        gP = found.gTb[:3, 3]
        latitude, longitude = frames.latitude_longitude(gP)
        R = found.gTb[:3, :3]
        pose = {
            "position_m": gP.tolist(),
            "attitude_wxyz": frames.to_quaternion_wxyz(R).tolist(),
            "latitude_deg": float(np.degrees(latitude)),
            "longitude_deg": float(np.degrees(longitude)),
            "altitude_m": float(body.altitude_m(gP)),
            "body": body.name,
            "body_radius_m": body.radius_m,
            "covariance": found.covariance.tolist(),
            "position_sigma_m": np.sqrt(np.diag(R @ found.covariance[3:, 3:] @ R.T)).tolist(),
            "attitude_sigma_deg": np.degrees(np.sqrt(np.diag(found.covariance)[:3])).tolist(),
        }
    return {
        "status": found.status.name.lower(),
        "reason": found.reason,
        "rims": rims,
        "pose": pose,
        "log_probability_of_chance": found.log_chance,
        "sigma_px": found.sigma_px if found.identified else None,
        "seconds": found.seconds,
    }


def _show(values: dict[str, Any]) -> None:
    pose = values["pose"]
    if pose is None:
        return
    say("      x px       y px      crater")
    for rim in values["rims"]:
        say(f"{rim['center_x_px']:10.3f} {rim['center_y_px']:10.3f}      {rim['crater'] or '-'}")
    matched = sum(rim["crater"] is not None for rim in values["rims"])
    gP, attitude, sigma_m, sigma_deg = (
        ", ".join(f"{number:{form}}" for number in pose[name])
        for name, form in (
            ("position_m", ".2f"),
            ("attitude_wxyz", ".8f"),
            ("position_sigma_m", ".3g"),
            ("attitude_sigma_deg", ".3g"),
        )
    )
    chance = values["log_probability_of_chance"] / math.log(10.0)
    say(
        f"{matched} of {len(values['rims'])} rims are craters of the catalogue; by chance with a "
        f"probability of 10^{chance:.1f}; {1e3 * values['seconds']:.0f} ms"
    )
    say(
        f"latitude {pose['latitude_deg']:.5f}, longitude {pose['longitude_deg']:.5f} deg, altitude "
        f"{pose['altitude_m']:.1f} m above the sphere of {1e-3 * pose['body_radius_m']:g} km"
    )
    say(f"  position in g {gP} m; sigma {sigma_m} m")
    say(f"  attitude gRb (w, x, y, z) {attitude}; sigma in b {sigma_deg} deg")
