"""Paragraphs of figs. 15 to 18: the paper's statements beside the numbers found here."""

from collections.abc import Iterable, Mapping

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
from craternav_fg.reproduce.sentences import compared, listed

# Altitudes, km, between which smoothing in retrospect is compared with filtering.
MIDDLE_KM = (50.0, 30.0)
_SET_UP = (
    "As in the paper, the initial errors are 4 km, 5 m/s, 25 deg and 5 deg/s, the sun tilt has 10 deg and "
    "the edges 1 px; the paper prints neither its craters nor its IMU nor times: those of the scenario "
    "paper_case3 are assumed. Rims are simulated measurements without images: their errors are white from "
    "frame to frame, unlike those of images. As printed: the paper's EKF, eqs. (19), (24), (25) with its "
    "fixed Qn, and (29) applied to the output only; corrected: the same filter with the ellipse chart, each "
    "rim's own covariance and the prior counted once; efficient: iSAM2, whose estimate at a frame uses the "
    "data up to it. All start at the same maximum a posteriori pose of the first frame. "
)
_NAMES = {
    PAPERS: "the paper's EKF",
    FILTER: "the chart EKF",
    ONLINE: "iSAM2",
    SMOOTHER: "the smoother in retrospect",
    CENTRES: "the smoother of centres",
}


def without(trials: Descents, names: Iterable[str] = ESTIMATORS) -> str:
    """Name the estimators without a trajectory, and in how many trials; empty if there are none."""
    count = len(trials.numbers)
    many = f" in {{}} of {count} trials" if count > 1 else ""
    lost = [f"{name}{many.format(trials.lost[name])}" for name in names if trials.lost[name]]
    return f"no trajectory of {', of '.join(lost)}" if lost else ""


def one_trial_note(trials: Descents) -> str:
    """Paragraph of figs. 15 and 16."""
    k = trials.at(26.0)
    unit = trials.unit
    parts = ", ".join(
        f"{number(known(trials.of(name).mean[k]))} {unit} by {_NAMES[name]}"
        for name in (PAPERS, FILTER, ONLINE, SMOOTHER)
    )
    return (
        f"{_SET_UP}At 26 km, in the first trial, the error is {parts}; the bound is "
        f"{number(float(trials.bound(FILTERED_BOUND)[k]))} {unit} RMS. This is one sample of the error; "
        f"figs. 17 and 18 show its statistics.{_sentence(without(trials))}"
    )


def trials_note(trials: Descents) -> str:
    """Paragraph of figs. 17 and 18."""
    return (
        f"{_SET_UP}{_final_errors(trials)}{_comparison(trials)}"
        f"{_sentence(without(trials), ': errors are over the other trials, ratios over those of both')}"
    )


def _final_errors(trials: Descents) -> str:
    """Compare the errors at the end with the paper's statement."""
    unit, count = trials.unit, len(trials.numbers)
    printed = CONVERGED_M if unit == "m" else CONVERGED_DEG
    last = {name: known(trials.of(name).mean[-1]) for name in (PAPERS, FILTER, ONLINE)}
    paper = trials.of(PAPERS)
    beyond = len(paper.trials) - trials.converged[PAPERS]
    median = known(float(np.median(paper.error[:, -1]))) if len(paper.trials) else None
    judged = {name: last[name] for name in (PAPERS, FILTER, ONLINE)}
    below = [_NAMES[name] for name, value in judged.items() if value is not None and value < printed]
    above = [_NAMES[name] for name, value in judged.items() if value is not None and value >= printed]
    parts = [
        f"{word} for {listed(names)}" for word, names in (("holds", below), ("does not hold", above)) if names
    ]
    holds = " and ".join(parts) or "cannot be judged"
    return (
        f"At 10 km the mean error over {count} trials is {number(last[FILTER])} {unit} by the chart EKF, "
        f"{number(last[ONLINE])} {unit} by iSAM2 and {number(last[PAPERS])} {unit} by the paper's EKF "
        f"(median {number(median)} {unit}): the paper's statement, below {number(printed)} {unit}, {holds}. "
        f"Beyond 200 m or 1 deg end {beyond} of the {len(paper.trials)} trials of the paper's EKF and "
        f"{len(trials.of(CENTRES).trials) - trials.converged[CENTRES]} of the "
        f"{len(trials.of(CENTRES).trials)} of the smoother of centres. "
    )


def _comparison(trials: Descents) -> str:
    """Compare the estimators' RMS errors: at the end with the smoother's, and in retrospect."""
    smoother = trials.of(SMOOTHER)
    final = {name: rms_ratio(trials.of(name), smoother)[-1] for name in (PAPERS, FILTER, ONLINE, CENTRES)}
    finite = {name: ratio for name, ratio in final.items() if np.isfinite(ratio)}
    text = ""
    if finite:
        ratios = ", ".join(f"{ratio:.2f} for {_NAMES[name]}" for name, ratio in finite.items())
        text = f"At the end the RMS over that of the smoother is {ratios}: {_grouped(finite)}. "
    measurement = rms_ratio(trials.of(PAPERS), trials.of(FILTER))[-1]
    if np.isfinite([measurement, final[FILTER]]).all():
        text += (
            "The corrected measurement and fusion of the chart EKF divide the final RMS of the paper's EKF "
            f"by {measurement:.2f}, smoothing divides that of the chart EKF by {final[FILTER]:.2f}: the "
            f"effect of the first is {compared(abs(np.log(measurement)), abs(np.log(final[FILTER])))} that "
            "of the second, by the logarithm of the factor. "
        )
    middle = (trials.altitude_km <= MIDDLE_KM[0]) & (trials.altitude_km >= MIDDLE_KM[1])
    gain = rms_ratio(smoother, trials.of(FILTER))[middle]
    if np.isfinite(gain).any():
        text += (
            f"Between {MIDDLE_KM[0]:g} and {MIDDLE_KM[1]:g} km the smoother in retrospect has "
            f"{gain.min():.2f} to {gain.max():.2f} of the RMS of the chart EKF, {gain.mean():.2f} in the "
            f"mean: {compared(float(gain.mean()), 1.0)} that of the filter. "
        )
    return f"{text}The effect of each choice is measured by `craternav reproduce ablation`."


def _grouped(ratios: Mapping[str, float]) -> str:
    """Name the estimators whose RMS is larger than the smoother's, about equal to it, and smaller."""
    words: dict[str, list[str]] = {}
    for name, ratio in ratios.items():
        words.setdefault(compared(ratio, 1.0), []).append(_NAMES[name])
    return ", ".join(f"{word} the smoother's for {listed(names)}" for word, names in words.items())


def _sentence(text: str, more: str = "") -> str:
    return f" {text[0].upper()}{text[1:]}{more}." if text else ""
