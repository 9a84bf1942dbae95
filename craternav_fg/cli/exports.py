"""Commands that export data sets and trajectories for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.camera import Camera
from craternav_fg.cli.app import example, export_commands
from craternav_fg.cli.option_groups import never_replacing, never_replacing_any
from craternav_fg.cli.options import require_suffix
from craternav_fg.cli.terminal import say
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.files import replacing, replacing_folder
from craternav_fg.interchange.bag_export import IMAGE_TOPIC, IMU_TOPIC, BagFormat, export_bag
from craternav_fg.interchange.colmap import write_colmap
from craternav_fg.interchange.kalibr import camchain_yaml, kalibr_imu_yaml
from craternav_fg.interchange.maps import write_geojson, write_kml
from craternav_fg.interchange.trajectories import kitti_times, write_kitti
from craternav_fg.runs.read import Run, read_run
from craternav_fg.runs.store import MARKER
from craternav_fg.runs.write import write_tum
from craternav_fg.trajectory import Trajectory

_CAMCHAIN, _IMU = "camchain.yaml", "imu.yaml"


RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]
ChosenOption = Annotated[
    str | None,
    typer.Option(
        "--estimator", "-e", help="Estimator of the trajectory, or truth.", show_default="the run's first"
    ),
]


@export_commands.command("bag", epilog=example("export bag runs/demo -o demo.bag --format rosbag1"))
@never_replacing
def bag(
    folder: Annotated[Path, typer.Argument(metavar="DATA|RUN", help="Folder of a data set or a run.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="File (rosbag1) or folder (others).")],
    kind: Annotated[BagFormat, typer.Option("--format", help="Format of the bag.")] = BagFormat.ROSBAG2,
    compressed: Annotated[
        bool, typer.Option("--compressed", help="Write images as PNG (CompressedImage).")
    ] = False,
) -> None:
    """Write a data set as a ROS bag, and a run's trajectories with it (extra `ros`)."""
    run = read_run(folder) if (folder / MARKER).is_file() else None
    data = Dataset.open(folder if run is None else run.dataset)
    estimates = {} if run is None else run.trajectories
    export_bag(data, output, kind, compressed=compressed, estimates=estimates)
    say(f"{output}")


@export_commands.command("kalibr", epilog=example("export kalibr runs/data -o calibration"))
@never_replacing
def kalibr(
    data: Annotated[Path, typer.Argument(help="Folder of a data set.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for camchain.yaml and imu.yaml.")],
) -> None:
    """Write the calibration of a data set as Kalibr's camchain.yaml and imu.yaml."""
    dataset = Dataset.open(data)
    texts = {_CAMCHAIN: _camchain(data, dataset.camera)}
    if dataset.imu is not None and dataset.imu_noise is not None:
        stamps = dataset.imu.stamps_ns
        rate_hz = 1e9 * (len(stamps) - 1) / float(stamps[-1] - stamps[0])
        texts[_IMU] = kalibr_imu_yaml(dataset.imu_noise, rate_hz, IMU_TOPIC)
    with replacing_folder(output, marker=_CAMCHAIN, ours=(_CAMCHAIN, _IMU)) as temporary:
        for name, text in texts.items():
            (temporary / name).write_text(text, encoding="utf-8")
    say(f"{output}")


@export_commands.command("tum", epilog=example("export tum runs/demo -e smoother -o smoother.tum"))
@never_replacing
def tum(
    run: RunArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")],
    estimator: ChosenOption = None,
) -> None:
    """Write a trajectory in TUM format: time in s, position in g in m, quaternion x y z w of gRb."""
    trajectory = _chosen(read_run(run), estimator)
    with replacing(output) as temporary:
        write_tum(temporary, trajectory)
    say(f"{output}")


@export_commands.command("kitti", epilog=example("export kitti runs/demo -e smoother -o smoother.txt"))
@never_replacing_any(lambda values: [values["output"], kitti_times(values["output"])])
def kitti(
    run: RunArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write; the times go into a second one beside it.")
    ],
    estimator: ChosenOption = None,
) -> None:
    """Write poses of the camera relative to the first one in KITTI format."""
    found = read_run(run)
    write_kitti(output, _chosen(found, estimator), Dataset.open(found.dataset).camera)
    say(f"{output}")


@export_commands.command("map", epilog=example("export map runs/demo -o demo.geojson --every 10"))
@never_replacing
def map_(
    run: RunArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .geojson or .kml.")],
    estimator: ChosenOption = None,
    every: Annotated[int, typer.Option(min=1, help="Write the footprint of every Nth frame.")] = 1,
) -> None:
    """Write ground track and image footprints for a geographic information system."""
    require_suffix(output, (".geojson", ".kml"))
    found = read_run(run)
    data = Dataset.open(found.dataset)
    write = write_kml if output.suffix == ".kml" else write_geojson
    write(output, _chosen(found, estimator), data.camera, data.body, every)
    say(f"{output}")


@export_commands.command("colmap", epilog=example("export colmap runs/demo -o model"))
@never_replacing
def colmap(
    run: RunArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the text model.")],
    estimator: ChosenOption = None,
) -> None:
    """Write camera and poses as a text model of COLMAP."""
    found = read_run(run)
    data = Dataset.open(found.dataset)
    names = tuple(path.name for path in data.image_paths)
    write_colmap(output, _chosen(found, estimator), data.camera, names)
    say(f"{output}")


def _camchain(data: Path, camera: Camera) -> str:
    try:
        return camchain_yaml(camera, IMAGE_TOPIC)
    except ValueError as error:
        raise InputError(data, str(error)) from None


def _chosen(run: Run, name: str | None) -> Trajectory:
    """Trajectory of an estimator, or the truth."""
    known = dict(run.trajectories) if run.truth is None else {**run.trajectories, "truth": run.truth}
    if name is None:
        return next(iter(known.values()))
    if name not in known:
        raise InputError(run.path, f"expected one of {', '.join(known)}, found {name}")
    return known[name]
