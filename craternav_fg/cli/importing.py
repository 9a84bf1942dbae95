"""Commands that import images from other sources as data sets."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.cli.app import example, import_commands
from craternav_fg.cli.catalog_reading import read_any_catalog
from craternav_fg.cli.option_groups import never_replacing, with_option_groups
from craternav_fg.cli.options import CameraOption, CatalogOption, JsonOption, sun_direction
from craternav_fg.cli.terminal import out, say
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.dataset.sensor_files import read_camera
from craternav_fg.errors import InputError
from craternav_fg.importing.assemble import Imported, ImportedFrame, write_imported
from craternav_fg.importing.bodies import with_gravity_and_spin
from craternav_fg.importing.cubes import of_cubes, of_photographs
from craternav_fg.importing.images import grey_images, stamps_of
from craternav_fg.importing.isis import Cube, read_cube
from craternav_fg.importing.spice import SpiceQuery, camera_states
from craternav_fg.motion.coast import ACCELERATION_DENSITY, coast
from craternav_fg.motion.model import Motion

OutputOption = Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")]
ImagesArgument = Annotated[
    list[Path],
    typer.Argument(metavar="IMAGES...", help="Grey images of one size, or their PDS4 labels (.xml)."),
]
TimesOption = Annotated[
    Path | None,
    typer.Option(
        help="CSV of the images' times: filename, utc (ISO 8601).", show_default="those of the PDS4 labels"
    ),
]
MuOption = Annotated[
    float | None,
    typer.Option(
        "--mu-m3-s2", min=0.0, help="Gravitational parameter.", show_default="known for most bodies"
    ),
]
SpinOption = Annotated[
    float | None,
    typer.Option(
        "--spin-rad-s",
        help="Spin of the body about its pole, negative if retrograde.",
        show_default="that of the file, or the IAU's",
    ),
]
AccelerationOption = Annotated[
    float,
    typer.Option(
        "--acceleration-density-m-s2-sqrt-hz",
        min=1e-12,
        help="White-noise density of the accelerations that the motion model leaves out, m/s^2/√Hz.",
    ),
]
RateWalkOption = Annotated[
    float,
    typer.Option(
        "--rate-walk-rad-s2-sqrt-hz",
        min=1e-12,
        help="White-noise density of the angular accelerations, which thrusters make larger, rad/s^2/√Hz.",
    ),
]
PositionSigmaOption = Annotated[
    float, typer.Option(min=1e-3, help="Stated standard deviation per axis of the states' positions, m.")
]
AttitudeSigmaOption = Annotated[
    float, typer.Option(min=1e-6, help="Stated standard deviation per axis of the states' attitudes, deg.")
]


@dataclass(frozen=True)
class _Moved:
    """What moves the spacecraft."""

    mu_m3_s2: MuOption = None
    spin_rad_s: SpinOption = None
    acceleration_density_m_s2_sqrt_hz: AccelerationOption = ACCELERATION_DENSITY
    rate_walk_rad_s2_sqrt_hz: RateWalkOption = Motion.rate_walk_rad_s2_sqrt_hz

    @property
    def motion(self) -> Motion:
        """The motion model."""
        return coast(
            self.acceleration_density_m_s2_sqrt_hz, rate_walk_rad_s2_sqrt_hz=self.rate_walk_rad_s2_sqrt_hz
        )


@dataclass(frozen=True)
class _Stated(_Moved):
    """What moves the spacecraft, and how well its states are known."""

    position_sigma_m: PositionSigmaOption = 1000.0
    attitude_sigma_deg: AttitudeSigmaOption = 0.1


@dataclass(frozen=True)
class _Kernels:
    """What is asked of SPICE."""

    meta_kernel: Annotated[list[Path], typer.Option(help="Kernel or meta-kernel; may be repeated.")]
    spacecraft: Annotated[str, typer.Option(help="Name or number of the spacecraft.")]
    instrument_frame: Annotated[str, typer.Option(help="Frame of the camera: x right, y down, z forward.")]
    target: Annotated[str, typer.Option(help="Body in the images.")] = "MOON"
    body_frame: Annotated[str, typer.Option(help="Body-fixed frame of the catalogue.")] = "IAU_MOON"

    @property
    def query(self) -> SpiceQuery:
        """The same as the reader of kernels takes it."""
        kernels = tuple(self.meta_kernel)
        return SpiceQuery(kernels, self.spacecraft, self.instrument_frame, self.target, self.body_frame)


@import_commands.command(epilog=example("import isis A.cub B.cub -o DATA --catalog craters.parquet"))
@never_replacing
@with_option_groups
def isis(
    cubes: Annotated[list[Path], typer.Argument(help="ISIS cubes of one camera, after spiceinit.")],
    output: OutputOption,
    catalog: CatalogOption,
    stated: _Stated,
    images: Annotated[
        list[Path] | None,
        typer.Option(
            "--photographs",
            help="Uncropped photographs in place of the cubes' pixels; may be repeated; needs --times.",
        ),
    ] = None,
    times: Annotated[
        Path | None, typer.Option(help="CSV of the images' times: filename, utc (ISO 8601).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Import ISIS cubes: pixels, camera, states, sun."""
    read = [read_cube(path) for path in cubes]
    camera, frames, pixels = _pixels(read, images, times)
    body = with_gravity_and_spin(read[0].body, stated.mu_m3_s2, stated.spin_rad_s)
    craters, _ = read_any_catalog(catalog, body.radius_m)
    given = Imported(
        frames, camera, body, craters, stated.motion,
        stated.position_sigma_m, math.radians(stated.attitude_sigma_deg),
    )  # fmt: skip
    _finish(write_imported(output, given, pixels), as_json)


@import_commands.command(
    epilog=example(
        "import images *.png -o DATA --times times.csv --camera sensor.yaml --catalog C.parquet --sun 0,3,4"
    )
)
@never_replacing
@with_option_groups
def images(
    paths: ImagesArgument,
    output: OutputOption,
    camera: CameraOption,
    catalog: CatalogOption,
    sun: Annotated[
        str,
        typer.Option(help="Direction towards the sun at the first image, in g: x,y,z."),
    ],
    moved: _Moved,
    times: TimesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Import plain images with a table of their times, or images of PDS4 products."""
    sensor = read_camera(camera)
    frames = _frames(paths, times)
    direction = sun_direction(sun)
    craters, _ = read_any_catalog(catalog, None)
    body = with_gravity_and_spin(craters.body, moved.mu_m3_s2, moved.spin_rad_s)
    given = Imported(frames, sensor, body, craters, moved.motion, sun=direction)
    _finish(write_imported(output, given, _images(frames, sensor)), as_json)


@import_commands.command(
    epilog=example(
        "import spice *.png -o DATA --times times.csv --camera sensor.yaml --catalog C.parquet"
        " --meta-kernel K.tm --spacecraft -915 --instrument-frame A15_METRIC --target MOON"
        " --body-frame MOON_ME"
    )
)
@never_replacing
@with_option_groups
def spice(
    paths: ImagesArgument,
    output: OutputOption,
    camera: CameraOption,
    catalog: CatalogOption,
    kernels: _Kernels,
    stated: _Stated,
    times: TimesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Import plain images, or PDS4 products, with states and sun from SPICE kernels."""
    sensor = read_camera(camera)
    frames = _frames(paths, times)
    states, spin = camera_states(kernels.query, [frame.stamp_ns for frame in frames])
    craters, _ = read_any_catalog(catalog, None)
    known = Body(craters.body.name, craters.body.radius_m, 0.0, spin)
    frames = [ImportedFrame(f.path, f.stamp_ns, s) for f, s in zip(frames, states, strict=True)]
    body = with_gravity_and_spin(known, stated.mu_m3_s2, stated.spin_rad_s)
    given = Imported(
        frames, sensor, body, craters, stated.motion,
        stated.position_sigma_m, math.radians(stated.attitude_sigma_deg),
    )  # fmt: skip
    _finish(write_imported(output, given, _images(frames, sensor)), as_json)


def _pixels(
    cubes: list[Cube], images: list[Path] | None, times: Path | None
) -> tuple[Camera, list[ImportedFrame], list[ImageArray]]:
    """Camera, frames and grey levels: of the photographs if they are given, else of the cubes."""
    if images is None and times is None:
        return of_cubes(cubes)
    if images is None or times is None:
        raise InputError("--photographs, --times", "expected both, found one")
    return of_photographs(cubes, images, times)


def _images(frames: list[ImportedFrame], camera: Camera) -> Iterator[ImageArray]:
    """Grey levels of plain images."""
    size_px = camera.width_px, camera.height_px
    return grey_images([frame.path for frame in frames], size_px, camera.bit_depth)


def _frames(paths: list[Path], times: Path | None) -> list[ImportedFrame]:
    """Frames of plain images, in the order of time."""
    frames = [ImportedFrame(path, stamp) for path, stamp in zip(paths, stamps_of(paths, times), strict=True)]
    return sorted(frames, key=lambda frame: frame.stamp_ns)


def _finish(folder: Path, as_json: bool) -> None:
    """Say what was written."""
    data = Dataset.open(folder)
    if as_json:
        out.print_json(
            json.dumps({"dataset": str(folder), "frames": len(data), "craters": len(data.catalog)})
        )
        return
    camera = data.camera
    say(
        f"{folder}: {len(data)} images of {camera.width_px} x {camera.height_px} px, focal length "
        f"{camera.focal_px:.1f} px, {1e-9 * (data.stamps_ns[-1] - data.stamps_ns[0]):.1f} s"
    )
    say(f"next: craternav reconstruct {folder} -o RUN")
