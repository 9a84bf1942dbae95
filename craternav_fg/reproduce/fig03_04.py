"""Figs. 3 and 4: position error by the centres of three image ellipses, without noise."""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from craternav_fg.reproduce import line_plots
from craternav_fg.reproduce.edge_points import matched
from craternav_fg.reproduce.fig02 import ALTITUDES, TILTS_DEG, deviations_deg
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.results import NO_NUMBER, Reproduction, Row
from craternav_fg.resection.least_squares import minimise
from craternav_fg.resection.paper.centres import centre_pose
from craternav_fg.resection.paper.equations import PaperRims, edges
from craternav_fg.simulation.flat_scenes import random_triple
from factors.arrays import FloatArray

# Of fig. 4, in radii.
FIG04_ALTITUDES = (30, 20, 15, 10, 7, 5)
# An estimate this near is the true position but for rounding and the optimiser's tolerance; other solutions
# of the equations lie much further off.
_REACHED_RADII = 1e-6
# Altitudes and angles of the printed tables.
_HEADLINE_ALTITUDES, _HEADLINE_TILTS = (50, 15, 5), (5, 30)


@dataclass(frozen=True)
class Cell:
    """One point of fig. 3: an angle of incidence and an altitude in radii, with its trials."""

    seed: int
    tilt_deg: int
    altitude: int
    trials: int


def run_cell(cell: Cell) -> list[dict[str, float]]:
    """Return the position errors of eq. (10) started at the truth, and of eq. (13) started at its solution.

    Parameters
    ----------
    cell : Cell

    Returns
    -------
    list of dict
        A record per trial; errors in radii.

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eqs. (10) and (13).
    """
    records = []
    for trial in range(cell.trials):
        rng = np.random.default_rng([cell.seed, 3, cell.tilt_deg, cell.altitude, trial])
        scene = random_triple(rng, float(cell.altitude), np.deg2rad(cell.tilt_deg))
        seen = PaperRims(matched(scene, scene.charts, np.repeat(np.eye(5)[None], 3, axis=0)).rims)
        by_centres, _ = centre_pose(seen, scene.gTc)
        by_edges, _ = minimise(lambda T, seen=seen: edges(seen, T), by_centres)  # type: ignore[misc]
        records.append(
            {
                "incidence_deg": float(cell.tilt_deg),
                "altitude_radii": float(cell.altitude),
                "trial": float(trial),
                "deviation_deg": float(deviations_deg(scene).mean()),
                "centres_error_radii": float(np.linalg.norm((by_centres - scene.gTc)[:3, 3])),
                "edges_error_radii": float(np.linalg.norm((by_edges - scene.gTc)[:3, 3])),
            }
        )
    return records


def simulate(options: ReproduceOptions, progress: Progress | None = None) -> pa.Table:
    """Run the trials of figs. 3 and 4.

    Returns
    -------
    pyarrow.Table
        A row per trial.
    """
    cells = [Cell(options.seed, tilt, h, options.trials) for tilt in TILTS_DEG for h in ALTITUDES]
    results = run_all(run_cell, cells, options.workers, "fig03 and fig04", progress)
    return pa.Table.from_pylist([record for result in results for record in result])


def _medians(data: pa.Table, column: str) -> FloatArray:
    """Medians (tilts, altitudes) over the trials."""
    shape = (len(TILTS_DEG), len(ALTITUDES), -1)
    return np.asarray(np.median(data[column].to_numpy().reshape(shape), axis=2))


def fig03(data: pa.Table) -> Reproduction:
    """Position error of eq. (10) over altitude and angle of incidence.

    Parameters
    ----------
    data : pyarrow.Table
        See `simulate`.

    Returns
    -------
    Reproduction

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eq. (10).
    """
    centres, by_edges = _medians(data, "centres_error_radii"), _medians(data, "edges_error_radii")
    rows = [
        Row(
            "fig03",
            "position error of (10), median",
            f"i = {tilt} deg, h = {altitude} r, no noise",
            "r",
            as_printed=float(centres[i, j]),
            corrected=float(by_edges[i, j]),
            verdict=NO_NUMBER,
            headline=altitude in _HEADLINE_ALTITUDES,
        )
        for i, tilt in enumerate(TILTS_DEG)
        for j, altitude in enumerate(ALTITUDES)
    ]
    rises = [(np.diff(centres, axis=axis) > 0.0).mean() for axis in (0, 1)]
    reached = data["edges_error_radii"].to_numpy() < _REACHED_RADII
    note = (
        "The paper's text prints no number of this figure; it says that the error of the centres grows with "
        f"the angle of incidence and as the camera descends. Here the median error grows in {rises[0]:.0%} "
        f"of the steps in angle and in {rises[1]:.0%} of the steps in altitude: it is {centres[0, 0]:.3f} r "
        f"at i = 5 deg, h = 50 r and {centres[-1, -1]:.2f} r at i = 30 deg, h = 5 r. Medians are over random "
        "triples of craters wholly in the image; the largest error of a triple is "
        f"{data['centres_error_radii'].to_numpy().max():.3g} r. The craters of a triple may overlap: from 5 "
        "r the image has no room for three that do not. Eq. (10) is started at the truth. Corrected is eq. "
        "(13) with its sign corrected, started at the solution of (10); without noise it reaches the true "
        f"position in {np.mean(reached):.1%} of the triples."
    )
    return Reproduction(
        "fig03",
        "Position error by three image centres over the altitude, no noise",
        rows,
        note,
        line_plots.draw_centre_error(np.array(TILTS_DEG), np.array(ALTITUDES), centres),
        data,
    )


def fig04(data: pa.Table) -> Reproduction:
    """Position error of eq. (10) over the deviation of the line of sight.

    Parameters
    ----------
    data : pyarrow.Table
        See `simulate`.

    Returns
    -------
    Reproduction

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eq. (10).
    """
    keep = [ALTITUDES.index(h) for h in FIG04_ALTITUDES]
    deviation = _medians(data, "deviation_deg")[:, keep]
    error = _medians(data, "centres_error_radii")[:, keep]
    by_edges = _medians(data, "edges_error_radii")[:, keep]
    rows = [
        Row(
            "fig04",
            "position error of (10), median",
            f"h = {altitude} r, deviation {deviation[i, j]:.3f} deg (i = {tilt} deg), no noise",
            "r",
            as_printed=float(error[i, j]),
            corrected=float(by_edges[i, j]),
            verdict=NO_NUMBER,
            headline=tilt in _HEADLINE_TILTS,
        )
        for j, altitude in enumerate(FIG04_ALTITUDES)
        for i, tilt in enumerate(TILTS_DEG)
    ]
    powers = [float(np.polyfit(np.log(deviation[:, j]), np.log(error[:, j]), 1)[0]) for j in range(len(keep))]
    faster = sum(power > 1.0 for power in powers)
    note = (
        "The paper's text prints no number of this figure. Over the angles of incidence at one altitude, the "
        "median error is proportional to a power of the deviation (fitted to the medians): "
        + ", ".join(f"{p:.2f} at {h} r" for p, h in zip(powers, FIG04_ALTITUDES, strict=True))
        + f". It grows faster than the deviation at {faster} of the {len(powers)} altitudes. The deviation "
        "is the mean over the craters of a triple and the median over the triples; eq. (10) is started at "
        "the truth."
    )
    return Reproduction(
        "fig04",
        "Position error by three image centres over the deviation of the line of sight",
        rows,
        note,
        line_plots.draw_error_over_deviation(np.array(FIG04_ALTITUDES), deviation, error),
        data,
    )
