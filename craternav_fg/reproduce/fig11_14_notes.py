"""Paragraphs of figs. 11 to 14: the paper's statements beside the numbers found here."""

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
from craternav_fg.reproduce.sentences import changed, compared, listed

# Errors beyond this are told as such: they only say that the minimisation diverged.
_FAR_KM = 1e6


def efficiency(conditions: Mapping[float, Condition]) -> str:
    """Compare the efficient solver with the bound, and say which trials count.

    Parameters
    ----------
    conditions : mapping of float to Condition
        By altitude, km.

    Returns
    -------
    str
    """
    found, fitted = (
        np.concatenate([c.columns[name] for c in conditions.values()]) for name in ("solutions", "fitted")
    )
    counted = int(np.sum(found > 0.0))
    text = ""
    ratios = [_ratios(km, c) for km, c in conditions.items() if c.counted.sum() > 1]
    if ratios:
        text = (
            "The efficient solver, without a start, has these errors over the bound, RMS over RMS (in "
            "brackets "
            "each trial over its own bound; +- one standard error): " + ", ".join(ratios) + ". "
        )
    text += f"Every method and the bound are averaged over the same {counted} of {len(found)} trials"
    if not fitted.all():
        text += f"; in {np.mean(fitted == 0.0):.1%} the points of a rim determine no ellipse"
    lost = (fitted > 0.0) & (found == 0.0)
    if lost.any():
        text += f"; in {np.mean(lost):.1%} the efficient solver finds no pose"
    if (found > 1).any():
        text += f"; in {np.mean(found > 1):.1%} it gives several, of which the nearest to the truth counts"
    return text + "." + _not_converged(conditions)


def _ratios(km: float, condition: Condition) -> str:
    """Efficient solver's RMS over the bound's at an altitude, over the trials and each over its own."""
    error, bound = condition.values(trials.EFFICIENT) ** 2, condition.bounds() ** 2
    parts = []
    for e, b in ((error, bound), (error / bound, np.ones(len(bound)))):
        square = e.mean() / b.mean()
        sampling = (e - square * b).std() / (b.mean() * 2.0 * np.sqrt(square * len(e)))
        parts.append(f"{np.sqrt(square):.2f} +- {sampling:.2f}")
    return f"{parts[0]} ({parts[1]}) at {km:g} km"


def _not_converged(conditions: Mapping[float, Condition]) -> str:
    """Return the share of counted trials in which each method of the paper did not converge."""
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
    return (
        f" From the true pose some did not converge: {', '.join(parts)}; the pose at which they stopped "
        "counts."
    )


def _mean(condition: Condition, method: str | None = None) -> float:
    """Mean error of a method, or of the bound, of a condition of which some trial counts."""
    value = condition.bound(MEAN) if method is None else condition.statistic(method, MEAN)
    return np.nan if value is None else value


def _ends(conditions: Mapping[float, Condition]) -> list[float]:
    """Lowest and highest altitude, km; one if they are the same."""
    return sorted({min(conditions), max(conditions)})


def _values(conditions: Mapping[float, Condition], method: str) -> str:
    """Mean at the lowest and at the highest altitude."""
    means = {km: _mean(conditions[km], method) for km in _ends(conditions)}
    if np.isnan(list(means.values())).any():
        return "no pose"
    return listed([f"{number(mean)} {conditions[km].unit} at {km:g} km" for km, mean in means.items()])


def _printed_sign(conditions: Mapping[float, Condition], method: str) -> str:
    """Describe where the minimisation of eq. (11) with its printed sign ends."""
    off = np.concatenate([c.values(method) for c in conditions.values()])
    where = "the minimisation finds no pose. "
    if len(off):
        median = float(np.median(off)) / 1e3
        far = f"{median:.2g} km" if median < _FAR_KM else "more than a million km"
        where = (
            f"the minimisation ends {far} from the true position in the median of the first "
            f"{trials.PRINTED_TRIALS} trials of each altitude, which are all that the column as printed "
            "holds. "
        )
    return (
        "With n outward, as in eq. (21), no pose that sees the craters from outside fulfils eq. (11) as "
        "printed, P - L (two craters on one plane fulfil it from beneath, rotated by 180 deg about the line "
        f"through their centres). Started at the truth, {where}Corrected is L - P, which is the same as n "
        "inward, also started at the truth. "
    )


def _note_fig11(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    ends = _ends(conditions)
    centres, edges = ([_mean(conditions[km], name) for km in ends] for name in (trials.CENTRES, trials.EDGES))
    arcs = [
        f"{number(float(np.median(conditions[km].columns['arc_bound_rms_m'])))} m at {km:g} km" for km in ends
    ]
    medians = [conditions[km].values(trials.EDGES) for km in ends]
    text = (
        f"{_printed_sign(conditions, trials.EDGES_PRINTED)}The mean error of eq. (13) is "
        f"{_values(conditions, trials.EDGES)}, the median "
        f"{listed([number(float(np.median(v)) if len(v) else None) for v in medians])} m. "
    )
    if len(ends) > 1 and set(ends) <= set(printed):
        low, high = ends
        text += (
            f"The paper prints means of {printed[low][0]:g} and {printed[high][0]:g} m. From {low:g} to "
            f"{high:g} km the paper's error {changed(printed[low][0], printed[high][0])}, that of eq. (13) "
            f"{changed(*edges)} and the bound {changed(_mean(conditions[low]), _mean(conditions[high]))}. "
        )
    beside: list[str] = []
    for km, a, b in zip(ends, centres, edges, strict=True):
        ratio = f" ({a / b:.2g} times)" if np.isfinite(a / b) else ""
        beside.append(f"{compared(a, b)} {'it' if beside else 'that of the edges (13)'} at {km:g} km{ratio}")
    return text + (
        f"The mean error of the centres (10) is {listed(beside)}. Edge points cover "
        f"{'the whole rim' if options.arc == 1.0 else f'{options.arc:.0%} of the rim'}. If the paper's "
        f"{options.points[0]} to {options.points[1]} px are lengths of arcs with a point per pixel, the "
        f"bound is {listed(arcs)} (median RMS). "
    )


def _note_fig12(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    ends = _ends(conditions)
    methods = {
        "the bound": None,
        "eq. (13)": trials.EDGES,
        "the efficient solver": trials.EFFICIENT,
        "the centres (10)": trials.CENTRES,
    }
    words = {"smaller than": "falls", "larger than": "rises", "about equal to": "stays about the same"}
    names: dict[str, list[str]] = {word: [] for word in words.values()}
    values = []
    for name, method in methods.items():
        means = [_mean(conditions[km], method) for km in ends]
        if np.isnan(means).any():
            continue
        names[words[compared(means[-1], means[0])]].append(name)
        values.append(f"{listed([number(mean) for mean in means])} deg for {name}")
    text = (
        "The paper's text prints no number of this figure; it says that the attitude error falls as the "
        "altitude rises. "
    )
    if len(ends) == 1:
        return f"{text}At {ends[0]:g} km the means are {', '.join(values)}. "
    parts = [f"{word} for {listed(group)}" for word, group in names.items() if group]
    return f"{text}From {ends[0]:g} to {ends[1]:g} km it {listed(parts)}: the means are {', '.join(values)}. "


def _note_fig13(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    return (
        f"{_printed_sign(conditions, trials.TWO_PRINTED)}The mean error of eq. (23), in km and with |q| = 1 "
        f"(its rows have different units and no weights), is {_values(conditions, trials.TWO)}. "
        f"{_beside_bound(conditions, options, printed)}"
    )


def _beside_bound(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    """Compare the paper's printed means with the bound."""
    text = ""
    for km, (mean, _) in printed.items():
        if km in conditions and conditions[km].counted.any():
            bound, unit = _mean(conditions[km]), conditions[km].unit
            text += (
                f"The paper's largest mean is {mean:g} {unit} at {km:g} km. At {options.noise_px:g} px an "
                f"efficient estimator has {number(bound)} {unit}, {bound / mean:.2g} times as much: the "
                f"paper's number is {compared(mean, bound)} the bound. "
            )
    return text


def fine_noise(corrected: float, paper: float, noise_px: float) -> str:
    """Return the error of eq. (23) at a noise that is not the paper's beside the paper's printed error.

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eq. (23).
    """
    return (
        f"With edge points of {noise_px:g} px, which is not the paper's set-up, eq. (23) has "
        f"{number(corrected)} m there, {compared(corrected, paper)} the paper's {number(paper)} m. "
    )


def compared_with_three(
    conditions: Mapping[float, Condition], three: pa.Table, options: ReproduceOptions
) -> str:
    """Compare two craters by (23) with three by their centres, as the paper does.

    Parameters
    ----------
    conditions : mapping of float to Condition
        Conditions of two craters, by altitude, km.
    three : pyarrow.Table
        Trials of three craters.
    options : ReproduceOptions

    Returns
    -------
    str
    """
    parts = []
    for km in _ends(conditions):
        centres = Condition(three, 1e3 * km, options.noise_px, "m").statistic(trials.CENTRES, MEAN)
        two = conditions[km].statistic(trials.TWO, MEAN)
        if centres is not None and two is not None:
            word = compared(two, centres).removesuffix(" than").removesuffix(" to")
            parts.append(f"{word} at {km:g} km ({number(two)} and {number(centres)} m)")
    if not parts:
        return ""
    return (
        "The paper finds the error of two craters by (23) smaller than that of three by their centres "
        f"(10); here it is {listed(parts)}. "
    )


def _note_fig14(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    text = (
        f"The mean error of eq. (23) is {_values(conditions, trials.TWO)}. "
        f"{_beside_bound(conditions, options, printed)}"
    )
    for km, (mean, _) in printed.items():
        if km in conditions and conditions[km].counted.any():
            noise_px = options.noise_px * mean / _mean(conditions[km], trials.TWO)
            text += (
                "If the error of eq. (23) is proportional to the noise, it has the paper's mean at "
                f"{noise_px:.1g} px. "
            )
    return text


_NOTES = {"fig11": _note_fig11, "fig12": _note_fig12, "fig13": _note_fig13, "fig14": _note_fig14}


def note(
    figure: str, conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    """Paragraph of one of figs. 11 to 14.

    Parameters
    ----------
    figure : str
    conditions : mapping of float to Condition
        By altitude, km.
    options : ReproduceOptions
    printed : mapping of float to tuple of float
        The paper's mean and standard deviation, by altitude, km.

    Returns
    -------
    str
    """
    empty = [f"{km:g}" for km in _ends(conditions) if not conditions[km].counted.any()]
    if empty:
        return f"No trial counts at {' and '.join(empty)} km: nothing to compare over the altitude. "
    return _NOTES[figure](conditions, options, printed)
