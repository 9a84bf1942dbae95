"""Reconstruct a data set and write the results into a run's folder."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Estimator
from craternav_fg.pipeline.measuring import Progress
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.plots.overlays import contact_sheet, write_overlays
from craternav_fg.plots.style import save
from craternav_fg.plots.trajectories import (
    draw_bounds,
    draw_consistency,
    draw_descent,
    draw_errors,
    draw_overview,
    draw_sigmas,
)
from craternav_fg.runs import store
from craternav_fg.runs.write import write_run
from craternav_fg.vision.guided_options import GuidedOptions

# Frames beside one another in the overview.
OVERVIEW_FRAMES = 3


def execute_run(
    dataset: Dataset,
    folder: Path,
    estimators: Sequence[str | Estimator],
    *,
    label: str,
    began_s: float,
    earlier_s: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    overlay_every: int = 0,
    front_end: GuidedOptions | None = None,
    without: Sequence[str] = (),
) -> dict[str, Any]:
    """Reconstruct a data set into an existing folder: results, metrics, figures.

    Parameters
    ----------
    dataset : Dataset
    folder : Path
        See `craternav_fg.runs.store` for what is written.
    estimators : sequence of str or Estimator
        Or their names, the first of which the figures of a single trajectory show.
    label : str
        Path of the data set that run.toml names, absolute or relative to `folder`.
    began_s : float
        `time.perf_counter()` at the beginning of the whole command.
    earlier_s : mapping of str to float, optional
        Wall times of earlier steps of the command.
    progress : callable, optional
    overlay_every : int
        Write an overlay of every Nth frame; 0 writes none.
    front_end : GuidedOptions, optional
        How rims are measured in images.
    without : sequence of str, optional
        See `reconstruct`.

    Returns
    -------
    dict
        Contents of metrics.json.

    Raises
    ------
    EstimationError
        When a name is unknown, or every estimator fails.
    InputError
        When an image cannot be read.
    """
    result = reconstruct(dataset, estimators, without=without, front_end=front_end, progress=progress)
    for name, figure in _figures(dataset, result).items():
        save(figure, folder / store.FIGURES / f"{name}.png")
    if overlay_every and dataset.measurements is None:
        write_overlays(dataset, result, folder / store.OVERLAYS, overlay_every, progress)
    return write_run(
        folder,
        result,
        dataset=label,
        truth=dataset.truth,
        times_s={**(earlier_s or {}), **result.times_s},
        wall_s=time.perf_counter() - began_s,
    )


def _figures(dataset: Dataset, result: Reconstruction) -> dict[str, Figure]:
    """Draw the figures that the data set allows, by the names of their files."""
    first, trajectory = next(iter(result.trajectories.items()))
    drawn = {"descent": draw_descent(trajectory, dataset.truth, dataset.catalog, dataset.body)}
    rims = [len(frame.rims) for frame in result.frames]
    if dataset.truth is None:
        drawn["sigmas"] = draw_sigmas(result.trajectories, rims)
    else:
        drawn["errors"] = draw_errors(result.trajectories, dataset.truth, rims)
        drawn["consistency"] = draw_consistency(result.trajectories, dataset.truth)
        drawn[f"bounds_{first}"] = draw_bounds({first: trajectory}, dataset.truth)
    if dataset.measurements is None:
        rows = np.linspace(0, len(dataset) - 1, min(OVERVIEW_FRAMES, len(dataset))).astype(int)
        images = [(dataset.image(int(k)), result.frames[k]) for k in rows]
        drawn["overview"] = draw_overview(
            images, result.trajectories, dataset.truth, dataset.camera, dataset.body
        )
        drawn["contact_sheet"] = contact_sheet(dataset, result)
    return drawn
