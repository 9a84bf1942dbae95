"""Figs. 3 and 4: what the centres of image ellipses cost in position, three craters, no noise."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.reproduce import line_plots
from craternav_fg.reproduce.edge_points import matched
from craternav_fg.reproduce.fig02 import ALTITUDES, TILTS_DEG, deviations_deg
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress, run_all
from craternav_fg.reproduce.results import Reproduction, Row, verdict
from craternav_fg.resection.least_squares import minimise
from craternav_fg.resection.paper.centres import centre_pose
from craternav_fg.resection.paper.equations import PaperRims, edges
from craternav_fg.simulation.flat_scenes import random_triple

FloatArray = npt.NDArray[np.float64]

# Of fig. 4, in radii.
FIG04_ALTITUDES = (30, 20, 15, 10, 7, 5)
# Rounding and the optimiser's tolerance; another solution lies much further off.
_MET_RADII = 1e-6


@dataclass(frozen=True)
class Cell:
    """One point of fig. 3: an angle of incidence and an altitude in radii, with its trials."""

    seed: int
    tilt_deg: int
    altitude: int
    trials: int


def run_cell(cell: Cell) -> list[dict[str, float]]:
    """Position errors, in radii, of eq. (10) from the truth, and of eq. (13) started at its solution."""
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
    """All trials of figs. 3 and 4."""
    cells = [Cell(options.seed, tilt, h, options.trials) for tilt in TILTS_DEG for h in ALTITUDES]
    results = run_all(run_cell, cells, options.workers, "fig03 and fig04", progress)
    return pa.Table.from_pylist([record for result in results for record in result])


def _medians(data: pa.Table, column: str) -> FloatArray:
    """Medians (tilts, altitudes) over the trials."""
    shape = (len(TILTS_DEG), len(ALTITUDES), -1)
    return np.asarray(np.median(data[column].to_numpy().reshape(shape), axis=2))


def fig03(data: pa.Table) -> Reproduction:
    """Position error of eq. (10) over altitude and angle of incidence."""
    centres, by_edges = _medians(data, "centres_error_radii"), _medians(data, "edges_error_radii")
    rows = [
        Row(
            "fig03",
            "position error of (10), median",
            f"i = {tilt} deg, h = {altitude} r, no noise",
            "r",
            as_printed=float(centres[i, j]),
            corrected=float(by_edges[i, j]),
            verdict=verdict(None, None, None),
            headline=altitude in (50, 15, 5),
        )
        for i, tilt in enumerate(TILTS_DEG)
        for j, altitude in enumerate(ALTITUDES)
    ]
    steps = len(ALTITUDES) - 1
    least = int(np.sum(np.diff(centres, axis=1) > 0.0, axis=1).min())
    met = data["edges_error_radii"].to_numpy() < _MET_RADII
    rising = "every step" if least == steps else f"{least} or more of the {steps} steps"
    note = (
        "The paper's text prints no number of this figure. As it says, the error of the centres tends to "
        f"grow as the camera comes down (in {rising} of each "
        f"curve) and with the angle of incidence: from {centres[0, 0]:.3f} r at i = 5 deg, h = 50 r to "
        f"{centres[-1, -1]:.2f} r at i = 30 deg, h = 5 r, as the median over random triples of craters "
        "wholly in the image; single triples, near the critical cylinder, are off by up to "
        f"{data['centres_error_radii'].to_numpy().max():.3g} r. The three of a triple may overlap: from 5 r "
        "the image has no room for three that do not. Eq. (10) is started at the truth. "
        "Corrected is eq. (13) with its sign put right, started at the solution of (10): "
        f"from there it reaches the true position, without noise, in {np.mean(met):.1%} of the triples."
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
    """Position error of eq. (10) over the line of sight's deviation."""
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
            verdict=verdict(None, None, None),
            headline=tilt in (5, 30),
        )
        for j, altitude in enumerate(FIG04_ALTITUDES)
        for i, tilt in enumerate(TILTS_DEG)
    ]
    powers = [float(np.polyfit(np.log(deviation[:, j]), np.log(error[:, j]), 1)[0]) for j in range(len(keep))]
    note = (
        "The paper's text prints no number of this figure. At one altitude, over the angles of incidence, "
        "the error goes with the deviation to the power (fitted to the medians) "
        + ", ".join(f"{p:.2f} at {h} r" for p, h in zip(powers, FIG04_ALTITUDES, strict=True))
        + f": {'faster than' if min(powers) > 1.0 else 'not everywhere faster than'} in proportion. The "
        "deviation is the mean of the three craters', the median over the triples; eq. (10) is started at "
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
