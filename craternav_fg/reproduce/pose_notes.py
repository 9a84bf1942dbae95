"""What figs. 11 to 14 show of the paper's statements, what cannot be had, and why."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from craternav_fg.reproduce import static_pose as runs
from craternav_fg.reproduce.conditions import MEAN, Condition
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.rows import Row, number


def efficiency(conditions: Mapping[float, Condition]) -> str:
    """Say how near the efficient solver comes to the bound, and how often it has several poses or none."""
    error, bound, found, fitted = (
        np.concatenate([c.columns[name.format(c.unit)] for c in conditions.values()])
        for name in (f"{runs.EFFICIENT}_{{}}", "bound_rms_{}", "solutions", "fitted")
    )
    ratio = np.sqrt(np.nanmean((error / bound) ** 2)) if np.isfinite(error).any() else np.nan
    text = (
        f"The efficient solver, without a start, errs by {ratio:.2f} times the bound (rms over all "
        f"{len(found)} trials, each by its own bound)"
    )
    if (found > 1).any():
        text += (
            f"; in {np.mean(found > 1):.1%} of the trials it finds several poses, of which the nearest counts"
        )
    lost = (fitted > 0.0) & (found == 0)
    if lost.any():
        text += f"; in {np.mean(lost):.1%} it finds none"
    if not fitted.all():
        text += (
            f". In {np.mean(fitted == 0.0):.1%} of the trials the points of a rim determine no ellipse; "
            "these count for no method"
        )
    return text + "."


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
    off = [c.columns[f"{method}_m"] for c in conditions.values()]
    median = float(np.nanmedian(np.concatenate(off))) / 1e3
    far = f"{median:.2g} km off in the median" if median < 1e6 else "without end"
    return (
        "With n outward, as eq. (21) has it, eq. (11) is fulfilled by no pose as printed, P - L: the "
        f"minimisation runs away, {far}. Corrected is L - P, the same as n inward."
    )


def _note_fig11(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    low, high = min(conditions), max(conditions)
    ratio = {
        km: (conditions[km].statistic(runs.CENTRES, MEAN) or np.nan)
        / (conditions[km].statistic(runs.EDGES, MEAN) or np.nan)
        for km in (low, high)
    }
    arcs = {km: float(np.median(conditions[km].columns["arc_bound_rms_m"])) for km in (low, high)}
    medians = {km: float(np.median(conditions[km].values(runs.EDGES))) for km in (low, high)}
    text = (
        f"{_printed_sign(conditions, runs.EDGES_PRINTED)} Eq. (13) then has "
        f"{_values(conditions, runs.EDGES)} (medians {number(medians[low])} and "
        f"{number(medians[high])} m: a few weak triples make the mean). "
    )
    if {low, high} <= set(printed):
        slope = (conditions[high].statistic(runs.EDGES, MEAN) or np.nan) / (
            conditions[low].statistic(runs.EDGES, MEAN) or np.nan
        )
        text += (
            f"The paper prints {printed[low][0]:g} and {printed[high][0]:g} m. Its error grows by "
            f"{printed[high][0] / printed[low][0]:.2g} over these altitudes, ours by {slope:.2g} and the "
            f"bound by {conditions[high].bound(MEAN) / conditions[low].bound(MEAN):.2g}, as they must when "
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
    growth = conditions[high].bound(MEAN) / conditions[low].bound(MEAN)
    centres = [conditions[km].statistic(runs.CENTRES, MEAN) or np.nan for km in (low, high)]
    return (
        "The paper's text prints no number of this figure; it says that the attitude error falls as the "
        "altitude rises. With noise that is constant in pixels that cannot be of a good estimate: the "
        f"bound grows by {growth:.2g}, since from higher up the craters fill less of the image, and a turn "
        f"is told less well from a shift. Eq. (13) has {_values(conditions, runs.EDGES)}, the efficient "
        f"solver {_values(conditions, runs.EFFICIENT)}. The error of the centres (10), which comes from the "
        f"deviation of fig. 2, {'does fall' if centres[1] < centres[0] else 'does not fall either'}: "
        f"{_values(conditions, runs.CENTRES)}. "
    )


def _note_fig13(
    conditions: Mapping[float, Condition], options: ReproduceOptions,
    printed: Mapping[float, tuple[float, float]],
) -> str:  # fmt: skip
    high = max(conditions)
    text = (
        f"{_printed_sign(conditions, runs.TWO_PRINTED)} Eq. (23), in km and with |q| = 1 (its rows have "
        f"different units, and nothing weighs them), then has {_values(conditions, runs.TWO)}. "
    )
    if high in printed:
        bound = conditions[high].bound(MEAN)
        text += (
            f"The paper's largest mean, {printed[high][0]:g} m at {high:g} km, cannot be had: at "
            f"{options.noise_px:g} px an efficient estimator errs by {number(bound)} m, "
            f"{bound / printed[high][0]:.2g} times as much. "
        )
    return text


def fine_noise(row: Row, noise_px: float) -> str:
    """Say at which noise eq. (23) has the error of two craters that the paper prints."""
    return (
        f"It takes edge points of {noise_px:g} px for eq. (23) to have {number(row.corrected)} m there, the "
        f"paper's {number(row.paper)} m. "
    )


def compared_with_three(
    conditions: Mapping[float, Condition], three: pa.Table, options: ReproduceOptions
) -> str:
    """Compare two craters by (23) with three by their centres, as the paper does."""
    low, high = min(conditions), max(conditions)
    parts = []
    for km in (low, high):
        centres = Condition(three, 1e3 * km, options.noise_px, "m").statistic(runs.CENTRES, MEAN)
        two = conditions[km].statistic(runs.TWO, MEAN)
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
    text = f"Eq. (23) has {_values(conditions, runs.TWO)}. "
    for km, (mean, _) in printed.items():
        if km in conditions:
            bound = conditions[km].bound(MEAN)
            corrected = conditions[km].statistic(runs.TWO, MEAN) or np.nan
            text += (
                f"The paper's largest mean, {mean:g} deg at {km:g} km, cannot be had: at "
                f"{options.noise_px:g} px an efficient estimator errs by {bound:.3g} deg, "
                f"{bound / mean:.2g} times as much; for eq. (23), whose error goes with the noise, it would "
                f"take {options.noise_px * mean / corrected:.1g} px. "
            )
    return text


NOTES = {"fig11": _note_fig11, "fig12": _note_fig12, "fig13": _note_fig13, "fig14": _note_fig14}
