"""What figs. 15 to 18 show of the paper's statements, and why the estimators differ."""

from collections.abc import Iterable

import numpy as np

from craternav_fg.campaign.trial import FILTERED_BOUND
from craternav_fg.reproduce.fig15_18_trials import (
    CENTRES,
    CONVERGED_DEG,
    CONVERGED_M,
    ESTIMATORS,
    FILTER,
    ONLINE,
    PAPERS,
    SMOOTHER,
    Descents,
    rms_ratio,
)
from craternav_fg.reproduce.results import known, number

_SET_UP = (
    "Initial errors of 4 km, 5 m/s, 25 deg and 5 deg/s, sun tilt of 10 deg, edges of 1 px, as the paper has "
    "them; it prints neither its craters nor its IMU nor times: those of the scenario paper_case3 are "
    "assumed. "
    "Rims are drawn from their Gaussians at the true pose, without images: their errors are white from "
    "frame to "
    "frame, which errors of images are not. As printed: the paper's EKF, eqs. (19), (24), (25) with its "
    "fixed Qn "
    "and (29) on the output (fed back, (29) counts what its sub-filters share again in every frame and "
    "diverges); corrected: the same filter with the ellipse chart, each rim's own noise and the prior "
    "counted "
    "once; efficient: iSAM2, whose estimate at a frame uses the data up to it. All begin at the same "
    "maximum a "
    "posteriori pose of the first frame; without it, at the prior's mean, no filter here finds its way. "
)


def without(trials: Descents, names: Iterable[str] = ESTIMATORS) -> str:
    """Tell which estimators gave no trajectory, in how many trials; empty when all gave one in each."""
    count = len(trials.numbers)
    many = f" in {{}} of {count} trials" if count > 1 else ""
    lost = [f"{name}{many.format(trials.lost[name])}" for name in names if trials.lost[name]]
    return f"no trajectory of {', of '.join(lost)}" if lost else ""


def one_trial_note(trials: Descents) -> str:
    """Paragraph of figs. 15 and 16."""
    k = trials.at(26.0)
    unit = trials.unit
    parts = ", ".join(
        f"{number(known(trials.of(name).mean[k]))} {unit} {words}"
        for name, words in (
            (PAPERS, "by the paper's EKF"), (FILTER, "by the chart EKF"), (ONLINE, "by iSAM2"),
            (SMOOTHER, "in retrospect"),
        )
    )  # fmt: skip
    return (
        f"{_SET_UP}At 26 km, in the first trial, the error is {parts}; the bound is "
        f"{number(float(trials.bound(FILTERED_BOUND)[k]))} {unit} RMS. One trial's error is one draw: what "
        f"the estimators are worth is in figs. 17 and 18.{_sentence(without(trials))}"
    )


def trials_note(trials: Descents) -> str:
    """Paragraph of figs. 17 and 18."""
    unit, count = trials.unit, len(trials.numbers)
    printed = CONVERGED_M if unit == "m" else CONVERGED_DEG
    found = {name: trials.of(name) for name in (PAPERS, FILTER, ONLINE, SMOOTHER, CENTRES)}
    last = {name: known(one.mean[-1]) for name, one in found.items()}
    ended = trials.converged
    paper = found[PAPERS]
    beyond = len(paper.trials) - ended[PAPERS]
    middle_one = float(np.median(paper.error[:, -1])) if len(paper.trials) else None
    holds = "holds" if max(found[FILTER].mean[-1], found[ONLINE].mean[-1]) < printed else "does not hold"
    if trials.lost[FILTER] == count or trials.lost[ONLINE] == count:
        holds = "cannot be judged"
    text = (
        f"{_SET_UP}At 10 km the mean error over {count} trials is {number(last[FILTER])} {unit} by the "
        "chart EKF "
        f"and {number(last[ONLINE])} {unit} by iSAM2: the paper's statement, below {number(printed)} {unit}, "
        f"{holds}. The "
        f"paper's own EKF ends at {number(last[PAPERS])} {unit} in the mean, "
        f"{number(middle_one)} {unit} in the median, and {beyond} of its {len(paper.trials)} "
        "trials "
        "end beyond 200 m or 1 deg. "
    )
    middle = (trials.altitude_km <= 50.0) & (trials.altitude_km >= 30.0)
    gain = rms_ratio(found[SMOOTHER], found[FILTER])[middle]
    final = {name: rms_ratio(one, found[SMOOTHER])[-1] for name, one in found.items()}
    text += (
        "What decides is the start and the measurement, not smoothing: begun well, a filter of ellipse "
        "charts "
        f"is as good online as a factor graph ({_times(final[FILTER], 2)} times the smoother's RMS at the "
        "end). "
        "Smoothing wins in retrospect"
    )
    if np.isfinite(gain).any():
        text += f" ({gain.min():.2f} to {gain.max():.2f} of the EKF's RMS between 50 and 30 km)"
    return text + (
        ", in the start, and in what a filter cannot revisit: late outliers, biases, time offsets. "
        f"The paper's EKF ends with {_times(final[PAPERS], 1)} times the smoother's RMS: the same noisy "
        "conic is in the residual and in the derivative of eq. (19), which biases every update; one Qn for "
        "all rims takes no account of their size; and sub-filters of one crater each, which (29) only "
        "combines, drift on their own, as is seen when the others leave the view. "
        f"Centres end with {_times(final[CENTRES], 1)} times it: an ellipse's centre is not the image of the "
        "crater's centre, by pixels when the crater is large in the image, and the same in every frame; and "
        f"they leave out size and shape, which tell the range. {ended[CENTRES]} of {count} trials by centres "
        "end within 200 m and 1 deg. "
        "What each of these choices costs is measured by `craternav reproduce ablation`."
        f"{_sentence(without(trials), ': errors are over the other trials, ratios over those of both')}"
    )


def _times(ratio: float, digits: int) -> str:
    return "-" if np.isnan(ratio) else f"{ratio:.{digits}f}"


def _sentence(text: str, more: str = "") -> str:
    return f" {text[0].upper()}{text[1:]}{more}." if text else ""
