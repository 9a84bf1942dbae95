"""Figs. 15 to 18: errors over whole descents, of one trial and of thirty."""

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.evaluation.consistency import Anees, anees_by_altitude, over_altitude
from craternav_fg.plots.style import COLOURS
from craternav_fg.reproduce import fig15_18_trials, line_plots
from craternav_fg.reproduce.fig15_18_notes import MIDDLE_KM, one_trial_note, trials_note, without
from craternav_fg.reproduce.fig15_18_trials import (
    CENTRES,
    FILTER,
    ONLINE,
    PAPERS,
    SMOOTHER,
    Descents,
    rms_ratio,
)
from craternav_fg.reproduce.results import NO_NUMBER, Reproduction, Row, known, number
from craternav_fg.reproduce.sentences import compared
from factors.arrays import FloatArray

# The paper's printed errors: of one trial at 26 km; of thirty trials at 10 km, "less than".
ONE_TRIAL_KM, LAST_KM = 26.0, 10.0
PRINTED = {"fig15": 40.0, "fig16": 0.05, "fig17": 200.0, "fig18": 1.0}
ALTITUDES_KM = (90.0, 50.0, 30.0, 26.0, 15.0, 10.0)
# Edges of the bins of ANEES; the first lies just above the first frames.
BINS_KM = (100.5, 80.0, 60.0, 40.0, 30.0, 20.0, 0.0)

_NO_SMOOTHER = "the paper has no smoother"
LABELS = {
    PAPERS: "paper's EKF",
    CENTRES: "smoother, centres",
    FILTER: "EKF, ellipse chart",
    ONLINE: "smoother, online",
    SMOOTHER: "smoother, in retrospect",
}


def draw_up(name: str, data: pa.Table) -> Reproduction:
    """Make rows, paragraph and drawing of one of figs. 15 to 18.

    Parameters
    ----------
    name : str
        fig15 to fig18.
    data : pyarrow.Table
        See `fig15_18_trials.simulate`.

    Returns
    -------
    Reproduction
    """
    unit, quantity = ("m", "position") if name in ("fig15", "fig17") else ("deg", "attitude")
    every = Descents(data, unit)
    if name in ("fig15", "fig16"):
        one = every.first()
        title = f"{quantity.capitalize()} error over one descent"
        rows = _errors(name, f"{quantity} error, one trial", one, "mean")
        return Reproduction(name, title, rows, one_trial_note(one), _draw(name, one, quantity), one.data)
    trials = len(every.numbers)
    rows = _errors(name, f"{quantity} error, mean", every, "mean")
    rows += _errors(name, f"{quantity} error, RMS", every, "rms")
    rows += _ratios(name, quantity, every)
    if name == "fig17":
        rows += _consistency(name, every)
    return Reproduction(
        name, f"{quantity.capitalize()} error over {trials} descents", rows,
        trials_note(every), _draw(name, every, quantity), data,
    )  # fmt: skip


def _errors(name: str, quantity: str, trials: Descents, kind: str) -> list[Row]:
    """Errors at some altitudes, by the filters and in retrospect."""
    found = {one: trials.of(one) for one in fig15_18_trials.ESTIMATORS}
    rows = []
    for km in ALTITUDES_KM:
        k = trials.at(km)
        value = {one: known(getattr(found[one], kind)[k]) for one in found}
        bounded = kind == "rms" or len(trials.numbers) == 1
        where = f"{km:g} km, craters in view: {trials.craters[:, k].mean():.2g}"
        printed = None
        if km == (ONE_TRIAL_KM if len(trials.numbers) == 1 else LAST_KM) and kind == "mean":
            printed = PRINTED[name]
        rows.append(
            Row(
                name, quantity, where, trials.unit, printed, value[PAPERS], value[FILTER], value[ONLINE],
                known(found[ONLINE].bound[k]) if bounded else None,
                _told(
                    NO_NUMBER if printed is None else _verdict(printed, value, trials.unit),
                    trials, PAPERS, FILTER, ONLINE,
                ),
            )
        )  # fmt: skip
        rows.append(
            Row(
                name, f"{quantity}, in retrospect", where, trials.unit, efficient=value[SMOOTHER],
                bound=known(found[SMOOTHER].bound[k]) if bounded else None,
                verdict=_told(_NO_SMOOTHER, trials, SMOOTHER), headline=kind == "mean",
            )
        )  # fmt: skip
        rows.append(
            Row(
                name, f"{quantity}, in retrospect by centres", where, trials.unit, corrected=value[CENTRES],
                verdict=_told(_NO_SMOOTHER, trials, CENTRES), headline=False,
            )
        )  # fmt: skip
    return rows


def _verdict(printed: float, value: dict[str, float | None], unit: str) -> str:
    """Return whether the paper's filter and the corrected one are within the paper's number."""
    words = []
    for name, who in ((PAPERS, "the paper's filter"), (FILTER, "the chart EKF")):
        found = value[name]
        if found is not None:
            met = "met" if found <= printed else "not met"
            words.append(f"{met} by {who}: {number(found)} {unit}")
    return "; ".join(words)


def _told(verdict: str, trials: Descents, *names: str) -> str:
    """Add to a verdict which of the row's estimators produced no trajectory in some trials."""
    return "; ".join(part for part in (verdict, without(trials, names)) if part)


def _ratios(name: str, quantity: str, trials: Descents) -> list[Row]:
    """Compare the estimators' RMS errors with each other and with the bound."""
    found = {one: trials.of(one) for one in fig15_18_trials.ESTIMATORS}
    count = f"{len(trials.numbers)} trials"
    ratio = {
        one: known(over_altitude(found[one].rms / found[one].bound, trials.altitude_km)) for one in found
    }
    middle = (trials.altitude_km <= MIDDLE_KM[0]) & (trials.altitude_km >= MIDDLE_KM[1])
    gain = known(_mean(rms_ratio(found[SMOOTHER], found[FILTER])[middle]))
    last = {one: known(rms_ratio(found[one], found[SMOOTHER])[-1]) for one in found}
    over = f"{quantity} RMS over the bound, mean over the altitude"
    rows = [
        Row(
            name, over, count, "1", None, ratio[PAPERS], ratio[FILTER], ratio[ONLINE], 1.0,
            _told("1: the bound is attained", trials, PAPERS, FILTER, ONLINE),
        ),
        Row(
            name, f"{over}, in retrospect", count, "1", None, None, ratio[CENTRES], ratio[SMOOTHER], 1.0,
            _told("1: the bound is attained; corrected: by centres", trials, CENTRES, SMOOTHER),
        ),
        Row(
            name, f"{quantity} RMS, smoother in retrospect over chart EKF",
            f"{MIDDLE_KM[0]:g} to {MIDDLE_KM[1]:g} km", "1", efficient=gain,
            verdict=_told(_than("smoother", gain, "the chart EKF's"), trials, SMOOTHER, FILTER),
        ),
        Row(
            name, f"{quantity} RMS over that of the smoother", f"end, {count}", "1",
            as_printed=last[PAPERS], corrected=last[FILTER], efficient=last[ONLINE],
            verdict=_told(
                _than("chart EKF", last[FILTER], "the smoother's"), trials, PAPERS, FILTER, ONLINE, SMOOTHER
            ),
        ),
        Row(
            name, f"{quantity} RMS by centres over that of the smoother", f"end, {count}", "1",
            corrected=last[CENTRES],
            verdict=_told(_than("centres", last[CENTRES], "the smoother's"), trials, CENTRES, SMOOTHER),
        ),
    ]  # fmt: skip
    if quantity == "position":
        ended = trials.converged
        rows.append(
            Row(
                name, "trials that end within 200 m and 1 deg", count, "1", None,
                ended[PAPERS], ended[FILTER], ended[ONLINE], None,
                _told(f"smoother {ended[SMOOTHER]}, by centres {ended[CENTRES]}", trials, *found),
            )
        )  # fmt: skip
    return rows


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _than(who: str, ratio: float | None, whose: str) -> str:
    """Say how an RMS compares with another, by their ratio."""
    return f"{who}: {compared(float('nan') if ratio is None else ratio, 1.0)} {whose}"


def _consistency(name: str, trials: Descents) -> list[Row]:
    """Return the ANEES over all altitudes, and bin by bin."""
    found = {one: trials.of(one) for one in fig15_18_trials.ESTIMATORS}
    edges = [1e3 * km for km in BINS_KM]
    altitude_m = 1e3 * trials.altitude_km
    bins = {
        one: anees_by_altitude(each.nees, altitude_m, edges)
        for one, each in found.items()
        if len(each.trials)
    }
    if not bins:
        return []
    rows = []
    for kind, (printed, corrected, efficient) in {
        "": (PAPERS, FILTER, ONLINE), ", in retrospect": (None, CENTRES, SMOOTHER)
    }.items():  # fmt: skip
        expected = "expected 6" if printed is not None else "expected 6; corrected: by centres"
        names = [of for of in (printed, corrected, efficient) if of is not None]
        rows.append(
            Row(
                name, f"pose ANEES{kind}", "all altitudes", "1", None,
                None if printed is None else known(found[printed].anees),
                known(found[corrected].anees), known(found[efficient].anees), 6.0,
                _told(expected, trials, *names),
            )
        )  # fmt: skip
        for k, one in enumerate(next(iter(bins.values()))):
            mean = {of: bins[of][k].mean if of in bins else None for of in names}
            verdict = _interval(bins[efficient][k]) if efficient in bins else ""
            where = f"{one.highest_m / 1e3:.3g} to {one.lowest_m / 1e3:.3g} km"
            rows.append(
                Row(
                    name, f"pose ANEES{kind}", where, "1",
                    None, None if printed is None else mean[printed], mean[corrected], mean[efficient], 6.0,
                    _told(verdict, trials, *names), headline=False,
                )
            )  # fmt: skip
    return rows


def _interval(one: Anees) -> str:
    inside = "inside" if one.consistent else "outside"
    return f"{inside} its 95 % interval of {one.trials} trials, {one.low:.2f} to {one.high:.2f}"


def _draw(name: str, trials: Descents, quantity: str) -> Figure:
    lines = {}
    for one, label in LABELS.items():
        found = trials.of(one)
        if len(found.trials):
            lines[label] = line_plots.Line(COLOURS[one], "-", found.rms)
    lines["bound (PCRB), online"] = line_plots.Line("k", "--", trials.bound(FILTERED_BOUND))
    lines["bound (PCRB), in retrospect"] = line_plots.Line("k", ":", trials.bound(SMOOTHED_BOUND))
    single = len(trials.numbers) == 1
    kind = "error" if single else "error, RMS"
    paper = (ONE_TRIAL_KM, PRINTED[name], "paper") if single else (LAST_KM, PRINTED[name], "paper: below")
    title = "one descent" if single else f"{len(trials.numbers)} descents, each with its own terrain"
    return line_plots.draw_descent(
        trials.altitude_km, lines, np.asarray(trials.craters.mean(axis=0)),
        f"{quantity} {kind}, {trials.unit}", title, paper,
    )  # fmt: skip
