"""Commands that check a reconstruction: against an elevation model, a-priori states, or its own frames."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from craternav_fg.catalogs.dem import read_dem
from craternav_fg.cli.app import evaluate_commands, example
from craternav_fg.cli.options import DemUnitOption, JsonOption
from craternav_fg.cli.terminal import out, progress_bars, say, table_of_numbers
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.apriori import AprioriStates
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import estimator
from craternav_fg.evaluation.dem_check import check_against_dem
from craternav_fg.evaluation.offsets import Offsets, leave_one_out, offsets
from craternav_fg.pipeline.options_file import OptionsFile
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.plots.dem_check import draw_dem_check
from craternav_fg.plots.style import save
from craternav_fg.runs.read import Run, read_run
from craternav_fg.trajectory import Trajectory

RunArgument = Annotated[Path, typer.Argument(help="Folder of a run.")]
NameOption = Annotated[
    str | None,
    typer.Option("--estimator", "-e", help="Estimator of the run.", show_default="the run's first"),
]
FIGURE = "dem_check.png"


@evaluate_commands.command("dem", epilog=example("evaluate dem runs/first --dem gld100.tif"))
def dem_(
    run: RunArgument,
    dem: Annotated[Path, typer.Option(help="Elevation model (GeoTIFF) of the ground in the images.")],
    dem_unit_m: DemUnitOption = 1.0,
    name: NameOption = None,
    as_json: JsonOption = False,
) -> None:
    """Correlate each photograph with the elevation model, shaded at the estimated pose and sun."""
    result = read_run(run)
    name, trajectory = _trajectory(result, name)
    covariance = _covariances(run, name, trajectory)
    data = Dataset.open(result.dataset)
    model = read_dem(dem, dem_unit_m, data.body.radius_m)
    checks = []
    with progress_bars() as report:
        for k, stamp in enumerate(data.stamps_ns.tolist()):
            sun = data.sun.at(stamp)
            checks.append(
                check_against_dem(
                    data.image(k), data.camera, trajectory.gTb[k], sun, model, data.body.radius_m
                )
            )
            report("frames", k + 1, len(data))
    up = trajectory.gP / np.linalg.norm(trajectory.gP, axis=1, keepdims=True)
    sigma_m = np.sqrt(np.einsum("ki,kij,kj->k", up, covariance[:, 3:, 3:], up))
    save(draw_dem_check(checks, sigma_m), run / "figures" / FIGURE)
    rows = [
        {
            "frame": k,
            "correlation": one.correlation,
            "best_correlation": one.best,
            "altitude_offset_m": one.altitude_m,
            "altitude_sigma_m": float(sigma),
            "shift_px": one.shift_px.tolist(),
            "rotation_rad": one.rotation_rad,
        }
        for k, (one, sigma) in enumerate(zip(checks, sigma_m.tolist(), strict=True))
    ]
    if as_json:
        out.print_json(json.dumps({"estimator": name, "frames": rows}))
        return
    table = table_of_numbers("frame", ("correlation", "best", "offset m", "sigma m", "shift px"))
    for k, one in enumerate(checks):
        table.add_row(
            str(k), f"{one.correlation:.3f}", f"{one.best:.3f}", f"{one.altitude_m:.0f}",
            f"{sigma_m[k]:.0f}", f"{np.hypot(*one.shift_px):.2f}",
        )  # fmt: skip
    out.print(table)
    mean = float(np.mean([one.altitude_m for one in checks]))
    say(f"{name}: best minus estimated altitude on the elevation model: mean {mean:.0f} m")
    say(f"{run / 'figures' / FIGURE}")


@evaluate_commands.command("apriori", epilog=example("evaluate apriori runs/first"))
def apriori(run: RunArgument, name: NameOption = None, as_json: JsonOption = False) -> None:
    """Compare a run with the a-priori states of its data set, such as those from SPICE."""
    result = read_run(run)
    name, trajectory = _trajectory(result, name)
    stated = _stated(result)
    found = offsets(trajectory, stated.states)
    _finish(name, found, "a-priori states", as_json, stated.position_sigma_m)


@evaluate_commands.command(
    "leave-one-out", epilog=example("evaluate leave-one-out runs/data -e smoother --config options.toml")
)
def leave_out(
    data: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    name: Annotated[
        str, typer.Option("--estimator", "-e", help="Estimator that predicts the frames.")
    ] = "smoother",
    config: Annotated[Path | None, typer.Option(help="Options of front end and estimators (TOML).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Predict each frame from the others, and compare with the position from its own rims."""
    file = None if config is None else OptionsFile(config)
    one = estimator(name) if file is None else file.estimator(name)
    with progress_bars() as report:
        result = reconstruct(data, [one], front_end=None if file is None else file.front_end, progress=report)
        stamps_ns = np.array([frame.stamp_ns for frame in result.frames], dtype=np.int64)
        found = leave_one_out(result.problems, one, stamps_ns)
    _finish(name, found, "the frame's own rims", as_json)


def _trajectory(run: Run, name: str | None) -> tuple[str, Trajectory]:
    chosen = next(iter(run.trajectories)) if name is None else name
    if chosen not in run.trajectories:
        known = ", ".join(run.trajectories)
        raise InputError(run.path, f"expected an estimator of the run, one of {known}, found {chosen}")
    return chosen, run.trajectories[chosen]


def _covariances(run: Path, name: str, trajectory: Trajectory) -> npt.NDArray[np.float64]:
    if trajectory.pose_covariance is None:
        raise InputError(run, f"expected an estimator with covariances, found {name}")
    return trajectory.pose_covariance


def _stated(run: Run) -> AprioriStates:
    stated = Dataset.open(run.dataset).apriori
    if stated is None:
        raise InputError(run.dataset, "expected a data set with a-priori states (mav0/state_apriori0)")
    return stated


def _finish(
    name: str, found: Offsets, against: str, as_json: bool, reference_sigma_m: float | None = None
) -> None:
    """Print offsets of an estimator from a reference; its sigma where those of the offsets leave it out."""
    if as_json:
        values: dict[str, Any] = {
            "estimator": name,
            "frames": found.frames.tolist(),
            "east_north_up_m": found.enu_m.tolist(),
            "sigma_m": found.sigma_m.tolist(),
            **({} if reference_sigma_m is None else {"reference_sigma_m": reference_sigma_m}),
        }
        out.print_json(json.dumps(values))
        return
    table = table_of_numbers("frame", ("east m", "north m", "up m", "sigmas m", "attitude deg"))
    for k, enu, sigma, turn in zip(found.frames, found.enu_m, found.sigma_m, found.attitude_rad, strict=True):
        sigmas = ", ".join(f"{one:.0f}" for one in sigma)
        angle = float(np.degrees(np.linalg.norm(turn)))
        table.add_row(str(k), *(f"{one:.0f}" for one in enu), sigmas, f"{angle:.3f}")
    out.print(table)
    if len(found.frames) > 1:
        mean, scatter = found.enu_m.mean(axis=0), found.scatter_m
        say(f"{name} minus {against}: mean {_three(mean)} m, scatter {_three(scatter)} m (east, north, up)")
    both = "" if reference_sigma_m is None else f" of both (states: {reference_sigma_m:g} m)"
    largest = np.max(np.abs(found.enu_m) / np.hypot(found.sigma_m, reference_sigma_m or 0.0))
    say(f"largest difference {largest:.1f} sigmas{both}")


def _three(values: Any) -> str:
    return " ".join(f"{one:.0f}" for one in values)
