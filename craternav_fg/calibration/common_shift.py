"""Shift of a published map as rims in rendered images of real ground show it, and what others say of it.

`python -m craternav_fg.calibration common_shift FOLDER` renders descents over the crops of the elevation
model in FOLDER and measures their rims. A scenario's `common_place_sigma_m` is the root mean square, per
axis, of the shifts of the other two crops. What craters deviate from the shift of their crop by has heavier
tails than a normal distribution: `catalogs.map_errors.CRATER_FREEDOM`.
"""

import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.optimize import minimize
from scipy.special import gammaln

from craternav_fg import frames
from craternav_fg.calibration.catalogue_errors import place_errors
from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes

SCENARIOS = ("gld100_highlands", "gld100_mare", "gld100_mixed")
_TRIALS = (0, 1)


def crater_shifts_m(data: Dataset, measured: tuple[FrameMeasurement, ...]) -> dict[int, FloatArray]:
    """Shifts of craters' rims from their mapped places, each the mean over the frames that show it.

    Parameters
    ----------
    data : Dataset
        With ground truth.
    measured : tuple of FrameMeasurement

    Returns
    -------
    dict of int to ndarray, shape (2,)
        East and north, m, by row of the catalogue.

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
    return {row: np.mean(every, axis=0) for row, every in seen.items()}


def common_shift(folder: Path) -> None:
    """Print the shift in each crop, and what the other crops say of it.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.
    """
    found, deviations, shifts_m, radii_m, console = [], [], [], [], Console(soft_wrap=True)
    for name in SCENARIOS:
        shifts, sigmas_m = [], []
        for trial in _TRIALS:
            with tempfile.TemporaryDirectory() as place:
                case = load_scenario(name).with_data(folder)
                data = Dataset.open(simulate(case, Path(place) / "d", trial=trial))
                by_crater = crater_shifts_m(data, reconstruct(data, ["ekf"]).frames)
                assert data.catalog.errors is not None
                shifts += list(by_crater.values())
                rows = list(by_crater)
                sigmas_m += data.catalog.errors.place_m[rows].tolist()
                axes_m = data.catalog.semi_major_m[rows], data.catalog.semi_minor_m[rows]
                radii_m += np.sqrt(axes_m[0] * axes_m[1]).tolist()
        found.append(np.median(shifts, axis=0))
        shifts_m.append(np.array(shifts) - found[-1])
        deviations.append(shifts_m[-1] / np.array(sigmas_m)[:, None])
        console.print(f"{name}: east {found[-1][0]:.0f}, north {found[-1][1]:.0f} m, {len(shifts)} craters")
    for name, others in zip(SCENARIOS, without_each(np.array(found)), strict=True):
        console.print(f"{name}: common_place_sigma_m {others:.0f}")
    freedom, scale = student(np.concatenate(deviations))
    console.print(
        f"Student's t: {freedom:.1f} degrees of freedom, {scale:.2f} times the stated errors of places"
    )
    console.print(place_errors(np.concatenate(shifts_m), np.array(radii_m)).told(len(radii_m)))


def student(deviations: FloatArray) -> tuple[float, float]:
    """Fit Student's t distribution by maximum likelihood.

    Parameters
    ----------
    deviations : ndarray, shape (n, d)
        Of n vectors in units of their stated standard deviations; their directions are random.

    Returns
    -------
    freedom, scale : float
        Degrees of freedom, and the scale in these units.
    """
    squares, d = np.sum(deviations**2, axis=1), deviations.shape[1]

    def cost(logarithms: FloatArray) -> float:
        freedom, scale = np.exp(logarithms)
        constant = (
            gammaln(0.5 * (freedom + d)) - gammaln(0.5 * freedom) - 0.5 * d * np.log(freedom * scale**2)
        )
        tails = 0.5 * (freedom + d) * np.log1p(squares / (freedom * scale**2))
        return float(np.sum(tails) - len(squares) * constant)

    freedom, scale = np.exp(minimize(cost, np.log([4.0, 1.0]), method="Nelder-Mead").x)
    return float(freedom), float(scale)


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
