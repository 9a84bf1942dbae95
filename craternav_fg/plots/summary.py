"""The figures of a reconstruction or a run by what they show."""

from collections.abc import Sequence
from typing import Literal

from matplotlib.figure import Figure

from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.plots.trajectories import (
    draw_bounds,
    draw_consistency,
    draw_descent,
    draw_errors,
    draw_sigmas,
)
from craternav_fg.runs.read import Run

Kind = Literal["errors", "bounds", "consistency", "sigmas", "descent"]
_WITH_TRUTH = ("errors", "bounds", "consistency")


def plot(
    result: Reconstruction | Run,
    dataset: Dataset | None = None,
    kind: Kind | None = None,
    *,
    estimators: Sequence[str] = (),
) -> Figure:
    """Draw the trajectories of a reconstruction or a run.

    Parameters
    ----------
    result : Reconstruction or Run
        Result of `reconstruct`, or a run read by `read_run`.
    dataset : Dataset, optional
        Provides the truth for the errors and the craters of the map. A run contains its own truth.
    kind : str, optional
        `"errors"`: norm of the errors over time; `"bounds"`: each component with its 3 sigma;
        `"consistency"`: NEES of the pose; `"sigmas"`: stated standard deviations; `"descent"`: altitude and
        ground track of the first estimator. By default the errors, without truth the sigmas.
    estimators : sequence of str
        Estimators to draw, all by default.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        When errors are to be drawn without truth, a map without a data set, or there is no such estimator.
    """
    truth = None if dataset is None else dataset.truth
    if isinstance(result, Run):
        truth, rims = result.truth, result.metrics["craters_per_frame"]
    else:
        rims = [len(frame.rims) for frame in result.frames]
    missing = [name for name in estimators if name not in result.trajectories]
    if missing:
        raise InputError(
            "plot", f"expected estimators of {', '.join(result.trajectories)}, found {missing[0]!r}"
        )
    drawn = {name: result.trajectories[name] for name in estimators or result.trajectories}
    shown = kind or ("sigmas" if truth is None else "errors")
    if shown == "sigmas":
        return draw_sigmas(drawn, rims)
    if shown == "descent":
        if dataset is None:
            raise InputError("plot", "expected the data set, whose craters are on the map")
        return draw_descent(next(iter(drawn.values())), truth, dataset.catalog, dataset.body)
    if shown not in _WITH_TRUTH:
        raise InputError(
            "plot", f"expected one of {', '.join(_WITH_TRUTH)}, sigmas, descent, found {shown!r}"
        )
    if truth is None:
        raise InputError("plot", f"expected a data set with truth for {shown!r}")
    if shown == "errors":
        return draw_errors(drawn, truth, rims)
    return draw_bounds(drawn, truth) if shown == "bounds" else draw_consistency(drawn, truth)
