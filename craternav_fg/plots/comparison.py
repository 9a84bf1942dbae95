"""Figure that compares runs."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from craternav_fg.plots.style import finish, line_styles, seconds_since_first
from craternav_fg.trajectory import Trajectory

# Markers on each line.
_MARKERS = 8
# White around the digits, so that they stand out from the lines.
_NUMBER = {"ms": 11.0, "mec": "w", "mew": 0.5}


def draw_comparison(
    runs: Mapping[str, Mapping[str, Trajectory]], truths: Mapping[str, Trajectory] | None
) -> Figure:
    """Draw the position errors of runs over time.

    Parameters
    ----------
    runs : mapping of str to mapping of str to Trajectory
        By run, then by estimator: an estimator has its line, a run its number on the lines.
    truths : mapping of str to Trajectory, or None
        By run, at the stamps of its trajectories. Without them the distances from the first run's first
        estimator are drawn; then all runs have the same stamps.

    Returns
    -------
    Figure
    """
    reference = next(iter(next(iter(runs.values())).values()))
    styles = line_styles(name for trajectories in runs.values() for name in trajectories)
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for k, (run, trajectories) in enumerate(runs.items()):
        true = reference if truths is None else truths[run]
        for name, one in trajectories.items():
            if one is reference and truths is None:
                continue
            off_m = np.linalg.norm(one.gP - true.gP, axis=1)
            step = max(len(one) // _MARKERS, 1)
            number = {"marker": f"${k + 1}$", "markevery": (k * step // len(runs), step), **_NUMBER}
            axes.semilogy(
                seconds_since_first(one.stamps_ns), off_m, label=f"{run}: {name}",
                **styles[name], **(number if len(runs) > 1 else {}),
            )  # fmt: skip
    axes.set_xlabel("time, s")
    first = next(iter(next(iter(runs.values()))))
    axes.set_ylabel("position error, m" if truths is not None else f"distance from the first {first}, m")
    finish(axes)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure
