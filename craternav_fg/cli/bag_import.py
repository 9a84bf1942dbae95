"""Commands that import recordings and calibrations of other programs."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.catalogs.files import import_catalog
from craternav_fg.cli.app import example, import_commands
from craternav_fg.cli.catalog_reading import warn_of
from craternav_fg.cli.option_groups import never_replacing, with_option_groups
from craternav_fg.cli.options import JsonOption, require_unused, sun_direction
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.config import read_text
from craternav_fg.dataset.description import read_description
from craternav_fg.dataset.sensor_files import camera_yaml, imu_yaml, read_camera, read_imu_noise
from craternav_fg.files import replacing
from craternav_fg.imu import ImuNoise
from craternav_fg.interchange.bag_import import BagOptions, import_bag
from craternav_fg.interchange.kalibr import (
    is_camchain,
    read_camchain,
    read_kalibr_imu,
    read_kalibr_imu_rate_hz,
)
from craternav_fg.sensors.yaml_files import parse_yaml

# Nominal rate in a sensor.yaml that is made of a camera chain, which does not state it.
_CAMERA_RATE_HZ = 1.0


@dataclass(frozen=True)
class _Topics:
    """Topics of a bag that has several of a kind."""

    image_topic: Annotated[
        str | None, typer.Option(help="Topic of the images.", show_default="the only one")
    ] = None
    imu_topic: Annotated[str | None, typer.Option(help="Topic of the IMU.", show_default="the only one")] = (
        None
    )
    truth_topic: Annotated[
        str | None,
        typer.Option(help="Topic of the true poses in g; none to take none.", show_default="the only one"),
    ] = None
    sun_topic: Annotated[
        str | None, typer.Option(help="Topic of the sun's direction.", show_default="the only one")
    ] = None


@import_commands.command(
    "bag",
    epilog=example(
        "import bag flight.bag -o data --description dataset.toml --catalog moon.parquet --imu imu.yaml"
    ),
)
@never_replacing
@with_option_groups
def bag(
    path: Annotated[Path, typer.Argument(metavar="BAG", help=".bag, .mcap, or the folder of a rosbag2.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")],
    description: Annotated[
        Path, typer.Option(help="dataset.toml with the body, and the initial state if known.")
    ],
    catalog: Annotated[
        Path, typer.Option(help="Crater catalogue (.parquet), or a table that `catalog import` reads.")
    ],
    imu: Annotated[Path, typer.Option(help="Noise of the IMU: sensor.yaml, or Kalibr's imu.yaml.")],
    topics: _Topics,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="sensor.yaml, or Kalibr's camchain.yaml.", show_default="CameraInfo and static transform"
        ),
    ] = None,
    sun: Annotated[
        str | None,
        typer.Option(
            help="Direction towards the sun at the first image, in g: x,y,z.",
            show_default="a topic of Vector3Stamped",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a ROS bag to a data set: rosbag1, rosbag2 or MCAP (extra `ros`)."""
    body, initial = read_description(description)
    craters, read = import_catalog(catalog, body)
    warn_of(catalog, read)
    found, shift_s = None, 0.0
    if camera is not None:
        found, shift_s = read_camchain(camera) if is_camchain(camera) else (read_camera(camera), 0.0)
    options = BagOptions(
        body=body, catalog=craters, imu_noise=_noise(imu), initial=initial, camera=found,
        time_shift_s=shift_s, sun=sun_direction(sun),
        image=topics.image_topic, imu=topics.imu_topic, truth=topics.truth_topic, sun_topic=topics.sun_topic,
    )  # fmt: skip
    report = import_bag(path, output, options)
    if report.uncovered_truth is not None:
        warn(f"{path}: no truth is kept: {report.uncovered_truth} does not cover the images")
    if report.skipped:
        warn(f"{path}: {report.skipped} images skipped: the IMU log does not cover them")
    if as_json:
        values = {"dataset": str(output), "topics": report.topics, "frames": report.frames}
        more = {"skipped": report.skipped, "imu_samples": report.samples, "truth": report.truth}
        out.print_json(json.dumps({**values, **more}))
        return
    given = {"camera": camera, "sun": sun}
    for what, topic in report.topics.items():
        say(f"{what}: {topic or given.get(what) or 'none'}")
    say(f"{report.frames} images, {report.samples} IMU samples")
    say(f"{output}\nnext: craternav reconstruct {output} -o RUN")


@import_commands.command("kalibr", epilog=example("import kalibr camchain-imucam.yaml -o sensor.yaml"))
@never_replacing
def kalibr(
    context: typer.Context,
    path: Annotated[Path, typer.Argument(metavar="YAML", help="camchain.yaml or imu.yaml of Kalibr.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="sensor.yaml to write.")],
    name: Annotated[str, typer.Option("--camera-name", help="Camera of the chain.")] = "cam0",
) -> None:
    """Convert Kalibr's calibration of a camera or an IMU to sensor.yaml."""
    if is_camchain(path):
        camera, shift_s = read_camchain(path, name)
        if shift_s:
            warn(f"{path}: timeshift_cam_imu {shift_s:g} s is not in {output}: add it to the images' stamps")
        text = camera_yaml(camera, _CAMERA_RATE_HZ)
    else:
        require_unused(context, {"name"}, "for the calibration of an IMU")
        text = imu_yaml(read_kalibr_imu(path), read_kalibr_imu_rate_hz(path))
    with replacing(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(f"{output}")


def _noise(path: Path) -> ImuNoise:
    """Noise of an IMU, by EuRoC's sensor.yaml or by Kalibr's imu.yaml."""
    if "sensor_type" in parse_yaml(path, read_text(path)):
        return read_imu_noise(path)
    return read_kalibr_imu(path)
