"""Trials of a campaign: the final errors of all, and one trial in full, the worst first."""

import html
from typing import Any, Literal

import numpy as np
import pyarrow.compute as pc

from craternav_fg.campaign.read import Campaign
from craternav_fg.campaign.summary import of_estimator
from craternav_fg.plots.style import colour
from craternav_fg.reports.charts import line, panels, short
from craternav_fg.reports.page import Block, Chart, Picker
from factors.arrays import IntArray

# Trials that can be picked: the worst ones of larger campaigns.
_MAX_TRIALS = 60


def trial_blocks(campaign: Campaign, names: list[str]) -> list[Block]:
    """Draw the final error of every trial, and the errors of the one that is picked.

    Parameters
    ----------
    campaign : Campaign
    names : list of str
        Names of the estimators; the trials are ordered by the errors of the first one.

    Returns
    -------
    list of Block
    """
    numbers = {name: trial_numbers(campaign, name) for name in names}
    position_m = {
        name: np.linalg.norm(of_estimator(campaign.table, name, "position_error_m"), axis=-1)
        for name in names
    }
    first = names[0]
    order = numbers[first][np.argsort(-position_m[first][:, -1], kind="stable")][:_MAX_TRIALS].tolist()
    final_m = dict(zip(numbers[first].tolist(), position_m[first][:, -1].tolist(), strict=True))
    labels = [f"trial {trial}: {final_m[trial]:.3g} m" for trial in order]
    traces, picked = [], []
    for name in names:
        altitude_km = 1e-3 * of_estimator(campaign.table, name, "altitude_m").mean(axis=0)
        rows = {trial: row for row, trial in enumerate(numbers[name].tolist())}
        # A trial without a trajectory of this estimator has no line.
        curves = [short(position_m[name][rows[trial]], 4) if trial in rows else [] for trial in order]
        hover = "%{x:.4g} km: %{y:.3g} m"
        traces.append(line(altitude_km, [], name, hovertemplate=hover))
        traces[-1]["y"] = curves[0]
        picked.append(curves)
    layout = panels(["position error, m"], [1], logarithmic=True)
    layout["xaxis"] |= {
        "title": {"text": "altitude, km"},
        "type": altitude_scale(campaign),
        "autorange": "reversed",
    }
    caption = f"Position error of the chosen trial. The list begins with the worst final error of {first}."
    spec = {"data": traces, "layout": layout, "picked": picked}
    chart = Chart("trial", spec, 360, caption)
    return [_all_trials(numbers, position_m), Picker("trial", "Trial", labels), chart]


def _all_trials(numbers: dict[str, Any], position_m: dict[str, Any]) -> Chart:
    """Draw the final position error of each trial and estimator."""
    traces = []
    for name, trials in numbers.items():
        marker = {"color": colour(name), "size": 6}
        hover = f"{html.escape(name)}, trial %{{x}}: %{{y:.3g}} m"
        more: dict[str, Any] = {
            "mode": "markers",
            "marker": marker,
            "hovertemplate": hover + "<extra></extra>",
        }
        traces.append(line(trials, position_m[name][:, -1], name, **more))
    layout = panels(["final position error, m"], [1], logarithmic=True)
    layout["xaxis"]["title"] = {"text": "trial"}
    caption = "Final position error of every trial and estimator."
    return Chart("trials-chart", {"data": traces, "layout": layout}, 340, caption)


def trial_numbers(campaign: Campaign, name: str) -> IntArray:
    """Find the trials with a trajectory of an estimator.

    Parameters
    ----------
    campaign : Campaign
    name : str

    Returns
    -------
    ndarray of int, shape (trials,)
        Numbers, in the order of `of_estimator`.
    """
    table = campaign.table
    mine = np.array(table["estimator"].to_pylist(), dtype=object) == name
    return np.asarray(np.unique(table["trial"].to_numpy()[mine]))


def altitude_scale(campaign: Campaign) -> Literal["log", "linear"]:
    """Choose the scale of the axes of altitude: a lander may end below the mean sphere, on low ground.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    {"log", "linear"}
    """
    return "log" if pc.min(campaign.table["altitude_m"]).as_py() > 0.0 else "linear"
