"""A run: reconstruct a data set and write all that comes out of it."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.reconstruct import Progress, Reconstruction, reconstruct
from craternav_fg.plots import figures
from craternav_fg.plots.overlays import FOLDER, contact_sheet, write_overlays
from craternav_fg.runs.store import write_run

OVERVIEW_FRAMES = 3


def write_reconstruction(
    dataset: Dataset,
    folder: Path,
    names: Sequence[str],
    *,
    label: str,
    began_s: float,
    earlier_s: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    overlay_every: int = 0,
) -> dict[str, Any]:
    """Reconstruct a data set into an existing folder: results, metrics, figures.

    Parameters
    ----------
    dataset : Dataset
    folder : Path
        See `craternav_fg.runs.store` for what is written.
    names : sequence of str
        Estimators.
    label : str
        Where the data set is, as run.toml tells it.
    began_s : float
        `time.perf_counter()` at the beginning of the whole command.
    earlier_s : mapping of str to float, optional
        Wall times of what the command did before.
    progress : callable, optional
    overlay_every : int
        Frames with their rims drawn on them are written, each of so many; 0: none.

    Returns
    -------
    dict
        What metrics.json holds.
    """
    result = reconstruct(dataset, names, progress=progress)
    _draw(dataset, result, folder / "figures")
    if overlay_every and dataset.measurements is None:
        write_overlays(dataset, result, folder / FOLDER, overlay_every, progress)
    return write_run(
        folder,
        result,
        dataset=label,
        camera=dataset.camera,
        catalog=dataset.catalog,
        truth=dataset.truth,
        times_s={**(earlier_s or {}), **result.times_s},
        wall_s=time.perf_counter() - began_s,
    )


def _draw(dataset: Dataset, result: Reconstruction, folder: Path) -> None:
    best = next(iter(result.trajectories))
    trajectory = result.trajectories[best]
    drawn = {"descent": figures.draw_descent(trajectory, dataset.truth, dataset.catalog, dataset.body)}
    rims = [len(frame.rims) for frame in result.frames]
    if dataset.truth is None:
        drawn["sigmas"] = figures.draw_sigmas(result.trajectories, rims)
    else:
        drawn["errors"] = figures.draw_errors(result.trajectories, dataset.truth, rims)
        drawn["consistency"] = figures.draw_consistency(result.trajectories, dataset.truth)
        drawn[f"bounds_{best}"] = figures.draw_bounds(best, trajectory, dataset.truth)
    if dataset.measurements is None:
        rows = np.linspace(0, len(dataset) - 1, min(OVERVIEW_FRAMES, len(dataset))).astype(int)
        images = [(dataset.image(int(k)), result.frames[k]) for k in rows]
        drawn["overview"] = figures.draw_overview(
            images, result.trajectories, dataset.truth, dataset.camera, dataset.body
        )
        drawn["contact_sheet"] = contact_sheet(dataset, result)
    for name, figure in drawn.items():
        figures.save(figure, folder / f"{name}.png")
