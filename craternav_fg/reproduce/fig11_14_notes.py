"""What figs. 11 to 14 show of the paper's statements, what cannot be had, and why."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from craternav_fg.reproduce import fig11_14_trials as trials
from craternav_fg.reproduce.fig11_14_statistics import (
    CENTRES,
    EDGES,
    MEAN,
    SHAPES,
    TWO,
    Condition,
)
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import number


def efficiency(conditions: Mapping[float, Condition]) -> str:
    """Say how near the efficient solver comes to the bound, and which trials count."""
    found, fitted = (
        np.concatenate([c.columns[name] for c in conditions.values()]) for name in ("solutions", "fitted")
    )
    counted = int(np.sum(found > 0.0))
    text = ""
    ratios = [_ratios(km, c) for km, c in conditions.items() if c.counted.sum() > 1]
    if ratios:
        text = (
            "The efficient solver, without a start, errs by these multiples of the bound, rms over rms (in "
            "brackets each trial by its own bound; +- one standard error): " + ", ".join(ratios) + ". "
        )
    text += f"Every method and the bound are averaged over the same {counted} of {len(found)} trials"
    if not fitted.all():
        text += f"; in {np.mean(fitted == 0.0):.1%} the points of a rim determine no ellipse"
    lost = (fitted > 0.0) & (found == 0.0)
    if lost.any():
        text += f"; in {np.mean(lost):.1%} the efficient solver gives no pose"
    if (found > 1).any():
        text += f"; in {np.mean(found > 1):.1%} it gives several, of which the nearest to the truth counts"
    return text + "." + _stopped(conditions)


def _ratios(km: float, condition: Condition) -> str:
    """Efficient solver's rms by the bound's at an altitude, over the trials and each by its own."""
    error, bound = condition.values(trials.EFFICIENT) ** 2, condition.bounds() ** 2
    parts = []
    for e, b in ((error, bound), (error / bound, np.ones(len(bound)))):
        square = e.mean() / b.mean()
        sampling = (e - square * b).std() / (b.mean() * 2.0 * np.sqrt(square * len(e)))
        parts.append(f"{np.sqrt(square):.2f} +- {sampling:.2f}")
    return f"{parts[0]} ({parts[1]}) at {km:g} km"


def _stopped(conditions: Mapping[float, Condition]) -> str:
    """Say in which share of the counted trials each method of the paper did not converge."""
    parts = []
    for equation in (CENTRES, EDGES, TWO, SHAPES):
        name = f"{equation.corrected}_converged"
        stopped = {km: c.columns[name][c.counted] == 0.0 for km, c in conditions.items()}
        shares = {km: float(s.mean()) for km, s in stopped.items() if s.any()}
        if shares:
            overall = np.concatenate(list(stopped.values())).mean()
            share, worst = max((share, km) for km, share in shares.items())
            parts.append(f"{equation.name} in {overall:.1%} ({share:.1%} of those from {worst:g} km)")
    if not parts:
        return ""
    return f" Even from the truth some did not converge, {', '.join(parts)}; the pose reached counts."


def _mean(condition: Condition, method: str | None = None) -> float:
    """Mean error of a method, or of the bound, of a condition of which some trial counts."""
    value = condition.bound(MEAN) if method is None else condition.statistic(method, MEAN)
    return np.nan if value is None else value


def _values(conditions: Mapping[float, Condition], method: str) -> str:
    """Mean at the lowest and at the highest altitude."""
    low, high = min(conditions), max(conditions)
    a, b = (conditions[km].statistic(method, MEAN) for km in (low, high))
    unit = conditions[low].unit
    if a is None or b is None:
        return "no pose"
    return f"{number(a)} {unit} at {low:g} km and {number(b)} {unit} at {high:g} km"


def _printed_sign(conditions: Mapping[float, Condition], method: str) -> str:
    """Say what becomes of eq. (11) with its printed sign."""
    off = np.concatenate([c.values(method) for c in conditions.values()])
    where = "."
    if len(off):
        median = float(np.median(off)) / 1e3
        far = f"{median:.2g} km off" if median < 1e6 else "without end"
        where = (
            f", {far} in the median of the first {trials.PRINTED_TRIALS} trials of each altitude, which are "
            "all that the column as printed holds."
        )
    return (
        "With n outward, as eq. (21) has it, no pose that sees the craters from outside fulfils eq. (11) as "
        "printed, P - L (two craters on one plane fulfil it from beneath, half a turn about the line through "
        f"their centres). Started at the truth, the minimisation runs away{where} Corrected is L - P, the "
        "same as n inward, started at the truth too. "
    )


def _note_fig11(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    low, high = min(conditions), max(conditions)
    ratio = {
        km: _mean(conditions[km], trials.CENTRES) / _mean(conditions[km], trials.EDGES) for km in (low, high)
    }
    arcs = {km: float(np.median(conditions[km].columns["arc_bound_rms_m"])) for km in (low, high)}
    medians = {km: float(np.median(conditions[km].values(trials.EDGES))) for km in (low, high)}
    text = (
        f"{_printed_sign(conditions, trials.EDGES_PRINTED)}Eq. (13) then has "
        f"{_values(conditions, trials.EDGES)} (medians {number(medians[low])} and "
        f"{number(medians[high])} m: a few weak triples make the mean). "
    )
    if {low, high} <= set(printed):
        slope = _mean(conditions[high], trials.EDGES) / _mean(conditions[low], trials.EDGES)
        text += (
            f"The paper prints {printed[low][0]:g} and {printed[high][0]:g} m. Its error grows by "
            f"{printed[high][0] / printed[low][0]:.2g} over these altitudes, ours by {slope:.2g} and the "
            f"bound by {_mean(conditions[high]) / _mean(conditions[low]):.2g}, as they must when "
            "the noise is constant in pixels: one set-up does not give both of the paper's numbers. "
        )
    return text + (
        f"The error of the centres (10) is {ratio[low]:.2g} times that of the edges at {low:g} km and "
        f"{ratio[high]:.2g} times at {high:g} km: the paper's advantage of the edges is there where craters "
        "are large in the image, and gone where their eccentricity drowns in the noise. Edge points are "
        f"spread over {'the whole rim' if options.arc == 1.0 else f'{options.arc:.0%} of the rim'}; were "
        f"the paper's {options.points[0]} to {options.points[1]} px arcs of that length with a point per "
        f"pixel, the bound alone would be {number(arcs[low])} m at {low:g} km and "
        f"{number(arcs[high])} m at {high:g} km (median rms). "
    )


def _note_fig12(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    low, high = min(conditions), max(conditions)
    growth = _mean(conditions[high]) / _mean(conditions[low])
    centres = [_mean(conditions[km], trials.CENTRES) for km in (low, high)]
    return (
        "The paper's text prints no number of this figure; it says that the attitude error falls as the "
        "altitude rises. With noise that is constant in pixels that cannot be of a good estimate: the "
        f"bound grows by {growth:.2g}, since from higher up the craters fill less of the image, and a turn "
        f"is told less well from a shift. Eq. (13) has {_values(conditions, trials.EDGES)}, the efficient "
        f"solver {_values(conditions, trials.EFFICIENT)}. The error of the centres (10), which comes from "
        f"the deviation of fig. 2, {'does fall' if centres[1] < centres[0] else 'does not fall either'}: "
        f"{_values(conditions, trials.CENTRES)}. "
    )


def _note_fig13(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    high = max(conditions)
    text = (
        f"{_printed_sign(conditions, trials.TWO_PRINTED)}Eq. (23), in km and with |q| = 1 (its rows have "
        f"different units, and nothing weighs them), then has {_values(conditions, trials.TWO)}. "
    )
    if high in printed:
        bound = _mean(conditions[high])
        text += (
            f"The paper's largest mean, {printed[high][0]:g} m at {high:g} km, cannot be had: at "
            f"{options.noise_px:g} px an efficient estimator errs by {number(bound)} m, "
            f"{bound / printed[high][0]:.2g} times as much. "
        )
    return text


def fine_noise(corrected: float, paper: float, noise_px: float) -> str:
    """Say at which noise, not the paper's, eq. (23) has about the error of two craters that it prints."""
    return (
        f"Only with edge points of {noise_px:g} px, which is not the paper's set-up, does eq. (23) come to "
        f"{number(corrected)} m there, about the paper's {number(paper)} m. "
    )


def compared_with_three(
    conditions: Mapping[float, Condition], three: pa.Table, options: ReproduceOptions
) -> str:
    """Compare two craters by (23) with three by their centres, as the paper does."""
    low, high = min(conditions), max(conditions)
    parts = []
    for km in (low, high):
        centres = Condition(three, 1e3 * km, options.noise_px, "m").statistic(trials.CENTRES, MEAN)
        two = conditions[km].statistic(trials.TWO, MEAN)
        if centres is not None and two is not None:
            word = "smaller" if two < centres else "larger"
            parts.append(f"{word} at {km:g} km ({number(two)} and {number(centres)} m)")
    return (
        "The paper finds the error of two craters by (23) smaller than that of three by their centres "
        f"(10); here it is {' and '.join(parts)}. "
    )


def _note_fig14(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    text = f"Eq. (23) has {_values(conditions, trials.TWO)}. "
    for km, (mean, _) in printed.items():
        if km in conditions and conditions[km].counted.any():
            bound, corrected = _mean(conditions[km]), _mean(conditions[km], trials.TWO)
            text += (
                f"The paper's largest mean, {mean:g} deg at {km:g} km, cannot be had: at "
                f"{options.noise_px:g} px an efficient estimator errs by {bound:.3g} deg, "
                f"{bound / mean:.2g} times as much; for eq. (23), whose error goes with the noise, it would "
                f"take {options.noise_px * mean / corrected:.1g} px. "
            )
    return text


_NOTES = {"fig11": _note_fig11, "fig12": _note_fig12, "fig13": _note_fig13, "fig14": _note_fig14}


def note(
    figure: str, conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    """Say what one of figs. 11 to 14 shows of the paper's statements, and what cannot be had."""
    empty = [
        f"{km:g}" for km in sorted({min(conditions), max(conditions)}) if not conditions[km].counted.any()
    ]
    if empty:
        return f"No trial counts at {' and '.join(empty)} km: nothing to compare over the altitude. "
    return _NOTES[figure](conditions, options, printed)
