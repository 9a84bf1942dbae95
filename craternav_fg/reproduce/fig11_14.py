"""Figs. 11 to 14: errors of position and attitude over the altitude, three craters and two."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from craternav_fg.reproduce import fig11_14_trials as trials
from craternav_fg.reproduce import line_plots
from craternav_fg.reproduce.fig11_14_notes import compared_with_three, efficiency, fine_noise
from craternav_fg.reproduce.fig11_14_notes import note as note_of
from craternav_fg.reproduce.fig11_14_statistics import (
    CENTRES,
    EDGES,
    MEAN,
    RMS,
    SHAPES,
    STD,
    TWO,
    Condition,
    Equation,
)
from craternav_fg.reproduce.fig11_14_trials import altitudes_km
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import Reproduction, Row

# Noise at which eq. (23) is tried beside the paper's: its error of two craters is then about the printed one.
FINE_NOISE_PX = 0.01
# Options that must be the default for the paper's numbers to be comparable.
_SET_UP = ("noise_px", "points", "arc", "semi_axes_m")

_STYLE = {
    trials.CENTRES: ("centres (10)", "#D55E00", "s"),
    trials.EDGES: ("edges (13)", "#E69F00", "o"),
    trials.TWO: ("two craters (23)", "#CC79A7", "D"),
    trials.SHAPES: ("(19), unweighted", "#009E73", "^"),
    trials.EFFICIENT: ("efficient", "#0072B2", "v"),
}


# The paper's printed mean and standard deviation, m or deg, by figure and altitude, km.
PRINTED: dict[str, dict[float, tuple[float, float]]] = {
    "fig11": {10.0: (258.0, 227.0), 100.0: (945.0, 593.0)},
    "fig12": {},
    "fig13": {100.0: (107.0, 203.0)},
    "fig14": {80.0: (0.173, 0.35)},
}


def draw_up(
    name: str, data: pa.Table, options: ReproduceOptions, three: pa.Table | None = None
) -> Reproduction:
    """Make rows, paragraph and drawing of one of figs. 11 to 14.

    Parameters
    ----------
    name : str
        fig11 to fig14.
    data : pyarrow.Table
        Trials of `fig11_14_trials.simulate`: of two craters for fig13 and fig14.
    options : ReproduceOptions
    three : pyarrow.Table, optional
        Trials of three craters, with which fig13 compares.

    Returns
    -------
    Reproduction
    """
    unit = "m" if name in ("fig11", "fig13") else "deg"
    quantity = "position" if unit == "m" else "attitude"
    craters = int(data["craters"][0].as_py())
    heights = altitudes_km(options)
    conditions = {km: Condition(data, 1e3 * km, options.noise_px, unit) for km in heights}
    main = (CENTRES, EDGES) if name in ("fig11", "fig12") else (TWO,)
    others = (TWO, SHAPES) if name in ("fig11", "fig12") else (SHAPES,)
    printed = PRINTED[name] if papers_set_up(options, craters) else {}
    rows = []
    for equation in (*main, *others):
        for kind in (MEAN, STD, RMS):
            for km, condition in conditions.items():
                paper = printed.get(km) if equation is main[-1] and kind in (MEAN, STD) else None
                headline = paper is not None or (kind == MEAN and equation in main)
                where = f"{km:g} km, {craters} craters, {options.noise_px:g} px"
                rows.append(condition.row(name, quantity, equation, kind, where, paper, headline))
    extra = _fine_rows(name, quantity, data, craters, options)
    note = note_of(name, conditions, options, printed)
    if name == "fig13":
        for row in extra:
            if row.corrected is not None:
                note += fine_noise(row.corrected, printed[100.0][0], FINE_NOISE_PX)
        note += "" if three is None else compared_with_three(conditions, three, options)
    note += efficiency(conditions)
    return Reproduction(
        name,
        f"{quantity.capitalize()} error over the altitude, {craters} craters",
        rows + extra,
        note,
        _draw(conditions, printed, f"{quantity} error (mean), {unit}", main, others),
        data,
    )


def papers_set_up(options: ReproduceOptions, craters: int) -> bool:
    """Whether noise, edges, sizes and number of craters are the paper's, so that its numbers compare."""
    default = ReproduceOptions()
    return craters <= 3 and all(getattr(options, name) == getattr(default, name) for name in _SET_UP)


def fine_conditions(options: ReproduceOptions) -> list[tuple[float, float]]:
    """Return altitude, m, and noise, px, at which the paper's two craters are tried with less noise."""
    if options.altitudes_km[1] != 100.0 or not papers_set_up(options, 2):
        return []
    return [(1e5, FINE_NOISE_PX)]


def _fine_rows(
    name: str, quantity: str, data: pa.Table, craters: int, options: ReproduceOptions
) -> list[Row]:
    if name != "fig13":
        return []
    out = []
    for altitude, noise in fine_conditions(options):
        km = altitude / 1e3
        where = f"{km:g} km, {craters} craters, {noise:g} px"
        condition = Condition(data, altitude, noise, "m")
        row = condition.row(name, quantity, TWO, MEAN, where, None, True)
        out.append(replace(row, verdict="not the paper's set-up: it prints no number"))
    return out


def _draw(
    conditions: Mapping[float, Condition], printed: Mapping[float, tuple[float, float]],
    label: str, main: Sequence[Equation], others: Sequence[Equation],
) -> Figure:  # fmt: skip
    series = {}
    methods = [e.corrected for e in (*main, *others)]
    for method in (*methods, trials.EFFICIENT):
        legend, colour, marker = _STYLE[method]
        shown = method == trials.EFFICIENT or method in methods[: len(main)]
        values = [c.values(method) for c in conditions.values()]
        mean = np.array([v.mean() if len(v) else np.nan for v in values])
        low, high = (
            np.array([np.quantile(v, q) if len(v) else np.nan for v in values]) for q in (0.16, 0.84)
        )
        series[legend] = line_plots.Series(
            colour, marker, "-" if shown else ":", mean, low if shown else None, high if shown else None
        )
    bound = np.array([c.bound(MEAN) for c in conditions.values()], dtype=np.float64)
    series["bound"] = line_plots.Series("k", "", "--", bound)
    paper = [(km, *values) for km, values in printed.items() if km in conditions]
    first = next(iter(conditions.values())).columns
    title = (
        f"{first['craters'][0]:g} craters, {first['noise_px'][0]:g} px, {len(first['trial'])} trials an "
        "altitude; bars: 16 to 84 %"
    )
    return line_plots.draw_errors(np.array(list(conditions)), series, label, title, paper)
