"""Figure that compares runs."""

import itertools
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from craternav_fg.plots.style import colour, finish, seconds_since_first
from craternav_fg.trajectory import Trajectory

_DASHES = ("-", "--", ":", "-.")


def draw_comparison(runs: Mapping[str, Mapping[str, Trajectory]], truth: Trajectory | None) -> Figure:
    """Draw the position errors of runs of one data set over time.

    Parameters
    ----------
    runs : mapping of str to mapping of str to Trajectory
        By run, then by estimator: an estimator has its colour, a run its dash.
    truth : Trajectory or None
        At the same stamps. Without it the distances from the first run's first estimator are drawn.

    Returns
    -------
    Figure
    """
    reference = truth or next(iter(next(iter(runs.values())).values()))
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for (run, trajectories), dash in zip(runs.items(), itertools.cycle(_DASHES), strict=False):
        for name, one in trajectories.items():
            if one is reference:
                continue
            off_m = np.linalg.norm(one.gP - reference.gP, axis=1)
            t = seconds_since_first(one.stamps_ns)
            axes.semilogy(t, off_m, ls=dash, color=colour(name), label=f"{run}: {name}")
    axes.set_xlabel("time, s")
    first = next(iter(next(iter(runs.values()))))
    axes.set_ylabel("position error, m" if truth is not None else f"distance from the first {first}, m")
    finish(axes)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure
