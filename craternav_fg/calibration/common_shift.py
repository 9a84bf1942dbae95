"""Shift of a published map as rims in rendered images of real ground show it, and what others say of it.

`python -m craternav_fg.calibration.common_shift FOLDER` renders descents over the crops of the elevation
model in FOLDER and measures their rims. A scenario's `common_place_sigma_m` is the root mean square, per
axis, of the shifts of the other two crops.
"""

import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes

FloatArray = npt.NDArray[np.float64]

SCENARIOS = ("gld100_highlands", "gld100_mare", "gld100_mixed")
_TRIALS = (0, 1)


def crater_shifts_m(data: Dataset, measured: tuple[FrameMeasurement, ...]) -> FloatArray:
    """Shifts of craters' rims from their mapped places, each the mean over the frames that show it.

    Parameters
    ----------
    data : Dataset
        With ground truth.
    measured : tuple of FrameMeasurement

    Returns
    -------
    ndarray, shape (n, 2)
        East and north, m, of n craters.

    Raises
    ------
    ValueError
        Without ground truth.
    """
    catalog, bTc = data.catalog, data.camera.bTc
    truth = data.truth_at(np.array([frame.stamp_ns for frame in measured]))
    if truth is None:
        raise ValueError(f"{data.path}: expected ground truth, found none")
    seen: dict[int, list[FloatArray]] = defaultdict(list)
    for frame, gTb in zip(measured, truth.gTb, strict=True):
        rows = frame.rims.craters
        error = frame.rims.chart - project_rims(gTb, bTc, catalog.centres[rows], catalog.axes[rows])[0]
        slopes = ground_slopes(gTb, bTc, catalog.centres[rows], catalog.axes[rows])
        along = np.linalg.solve(slopes[:, :, [0, 1, 3, 4, 5]], error[..., None])[:, :2, 0]
        length_m = np.linalg.norm(catalog.axes[rows], axis=-1)
        unit = catalog.axes[rows] / length_m[..., None]
        shift = np.einsum("nk,nkc->nc", along * np.sqrt(length_m.prod(axis=-1))[:, None], unit)
        local = frames.east_north_up(catalog.latitude_rad[rows], catalog.longitude_rad[rows])[:, :, :2]
        east_north = np.einsum("nc,ncj->nj", shift, local)
        for row, one in zip(rows.tolist(), east_north, strict=True):
            seen[row].append(one)
    return np.array([np.mean(every, axis=0) for every in seen.values()]).reshape(-1, 2)


def main(folder: Path) -> None:
    """Print the shift in each crop, and what the other crops say of it.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.
    """
    found, console = [], Console()
    for name in SCENARIOS:
        shifts = []
        for trial in _TRIALS:
            with tempfile.TemporaryDirectory() as place:
                case = load_scenario(name).with_data(folder)
                data = Dataset.open(simulate(case, Path(place) / "d", trial=trial))
                shifts.append(crater_shifts_m(data, reconstruct(data, ["ekf"]).frames))
        every = np.concatenate(shifts)
        found.append(np.median(every, axis=0))
        console.print(f"{name}: east {found[-1][0]:.0f}, north {found[-1][1]:.0f} m, {len(every)} craters")
    for name, others in zip(SCENARIOS, without_each(np.array(found)), strict=True):
        console.print(f"{name}: common_place_sigma_m {others:.0f}")


def without_each(shifts_m: FloatArray) -> FloatArray:
    """Root mean square, per axis, of the shifts of all crops but one.

    Parameters
    ----------
    shifts_m : ndarray, shape (n, 2)
        Of n crops.

    Returns
    -------
    ndarray, shape (n,)
        m, without each in turn.
    """
    squares = np.sum(shifts_m**2, axis=1)
    return np.asarray(np.sqrt((squares.sum() - squares) / (2.0 * (len(squares) - 1))))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
