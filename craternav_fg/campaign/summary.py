"""Figures of every estimator over the trials of a campaign."""

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from craternav_fg.campaign.read import Campaign, each_trial, read_identity, read_wall_times
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.estimators.registry import is_retrospective
from craternav_fg.evaluation.consistency import over_altitude, rms
from craternav_fg.runs.columns import list_values
from factors.arrays import FloatArray

# A trial has converged when its final errors are within the limits of Tian et al. (2019), section 4.2.3:
# 1 deg, and 200 m at 10 km, which is taken as a share of the altitude.
CONVERGED_SHARE_OF_ALTITUDE = 0.02
CONVERGED_DEG = 1.0
# Altitudes are above the mean sphere, and low ground is below it: a final altitude counts as this share of
# the largest one at least.
LEAST_SHARE_OF_LARGEST_ALTITUDE = 0.01


def summarise(campaign: Campaign) -> dict[str, Any]:
    """Summarise a campaign.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    dict
        Contents of summary.json. For each estimator:

        trajectories : trials in which it produced a trajectory
        converged : trials whose final errors are below 2 % of the altitude (of a hundredth of the largest
            altitude at least, as ground may be below the mean sphere) and 1 deg
        position_final_mean_m, position_final_rms_m : of the final position error
        attitude_final_mean_deg : of the final attitude error
        rms_over_pcrb : RMS position error over the trials divided by the posterior Cramér-Rao bound, averaged
            over the altitude, or over the frames where that neither only falls nor only rises; the bound is
            the smoothing one for estimators that use later data
        anees : of the pose, 6 when the covariances are consistent, over the trials in which none is singular
        anees_trials : the number of these
        time_per_trial_s : median wall time

        All but the counts are over the trials with a trajectory; null without any. Estimators that fail
        on hard trials look better on the remaining ones.
    """
    sums = {name: _Sums(name) for name in campaign.identity["estimators"]}
    for number in campaign.failures:
        table = campaign.table.filter(pc.equal(campaign.table["trial"], number))
        for one in sums.values():
            one.add(table)
    return {
        "trials": len(campaign.failed) + len(campaign.failures),
        "failed": len(campaign.failed),
        "wall_s": campaign.wall_s,
        "estimators": {name: one.figures(campaign.times_s) for name, one in sums.items()},
    }


def summarise_folder(folder: Path) -> dict[str, Any]:
    """Summarise a campaign of any size: one trial is in memory at a time.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict
        See `summarise`.

    Raises
    ------
    InputError
        When a file of the campaign is damaged.
    """
    sums = {name: _Sums(name) for name in read_identity(folder)["estimators"]}
    trials = failed = 0
    for trial in each_trial(folder):
        trials += 1
        if trial.table is None:
            failed += 1
            continue
        for one in sums.values():
            one.add(trial.table)
    times_s, wall_s = read_wall_times(folder)
    figures = {name: one.figures(times_s) for name, one in sums.items()}
    return {"trials": trials, "failed": failed, "wall_s": wall_s, "estimators": figures}


def with_nees(nees: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which trials count for the ANEES: those in which every frame has a regular covariance.

    Parameters
    ----------
    nees : ndarray, shape (trials, k)
        NaN without a covariance, inf where it is singular.

    Returns
    -------
    ndarray of bool, shape (trials,)
    """
    return np.asarray(np.isfinite(nees).all(axis=1))


def of_estimator(table: pa.Table, name: str, column: str) -> FloatArray:
    """Return a column for one estimator, by trial and frame.

    Parameters
    ----------
    table : pyarrow.Table
        Table of a `Campaign`.
    name : str
        An estimator, or one of the bounds.
    column : str
        Column of `craternav_fg.campaign.trial.SCHEMA`.

    Returns
    -------
    ndarray, shape (trials, frames) or (trials, frames, d)
        NaN where the table has no value.
    """
    rows = table.filter(pc.equal(table["estimator"], name))
    trials = len(pc.unique(rows["trial"]))
    if pa.types.is_fixed_size_list(rows[column].type):
        lists = list_values(rows[column])
        size = rows[column].type.list_size
        values = np.full((len(rows), size), np.nan) if lists is None else lists
        return values.reshape(trials, len(rows) // max(trials, 1), size)
    values = np.asarray(rows[column].to_numpy(), dtype=np.float64)
    return values.reshape(trials, len(rows) // max(trials, 1))


def rms_over_bound(table: pa.Table, name: str) -> FloatArray:
    """Divide the RMS position error over the trials by the posterior Cramér-Rao bound, frame by frame.

    Parameters
    ----------
    table : pyarrow.Table
        Table of a `Campaign`.
    name : str
        Estimator.

    Returns
    -------
    ndarray, shape (frames,)
    """
    mine = pc.equal(table["estimator"], name)
    of_trials = pc.is_in(table["trial"], value_set=pc.unique(table.filter(mine)["trial"]))
    e = of_estimator(table, name, "position_error_m")
    sigma = of_estimator(table.filter(of_trials), _bound(name), "pose_sigma")[..., 3:]
    return rms(e) / rms(sigma)


def _bound(name: str) -> str:
    """Name of the bound of an estimator."""
    return SMOOTHED_BOUND if is_retrospective(name) else FILTERED_BOUND


class _Sums:
    """What the figures of an estimator need of all trials.

    Parameters
    ----------
    name : str
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._bound = _bound(name)
        self._final_m, self._final_deg, self._nees = (array("d") for _ in range(3))
        self._converged = 0
        # By frame: squares of the errors, and variances of the bound, m^2.
        self._squares: FloatArray = np.zeros(0)
        self._variances: FloatArray = np.zeros(0)
        self._altitude_m: FloatArray = np.zeros(0)

    def add(self, table: pa.Table) -> None:
        """Add a trial; nothing when it has no trajectory of the estimator."""
        errors = of_estimator(table, self._name, "position_error_m")
        if not len(errors):
            return
        altitude_m = of_estimator(table, self._name, "altitude_m")[0]
        attitude = of_estimator(table, self._name, "attitude_error_rad")[0, -1]
        squares: FloatArray = np.sum(errors[0] ** 2, axis=-1)
        sigma = of_estimator(table, self._bound, "pose_sigma")[0, :, 3:]
        if not self._final_m:
            self._squares, self._variances = np.zeros((2, len(squares)))
            self._altitude_m = altitude_m
        self._squares += squares
        self._variances += np.sum(sigma**2, axis=-1)
        self._final_m.append(float(np.sqrt(squares[-1])))
        self._final_deg.append(float(np.degrees(np.linalg.norm(attitude))))
        nees = of_estimator(table, self._name, "nees")
        self._nees.extend(nees[with_nees(nees)].mean(axis=1).tolist())
        least_m = LEAST_SHARE_OF_LARGEST_ALTITUDE * np.abs(altitude_m).max()
        near = self._final_m[-1] <= CONVERGED_SHARE_OF_ALTITUDE * max(altitude_m[-1], least_m)
        self._converged += bool(near and self._final_deg[-1] <= CONVERGED_DEG)

    def figures(self, times_s: Mapping[int, Mapping[str, float]]) -> dict[str, Any]:
        """Figures of the estimator; `times_s` are wall times by trial and step."""
        times = [parts[self._name] for parts in times_s.values() if self._name in parts]
        out: dict[str, Any] = {
            "trajectories": len(self._final_m),
            "converged": self._converged,
            "position_final_mean_m": None,
            "position_final_rms_m": None,
            "attitude_final_mean_deg": None,
            "rms_over_pcrb": None,
            "anees": float(np.mean(self._nees)) if self._nees else None,
            "anees_trials": len(self._nees),
            "time_per_trial_s": float(np.median(times)) if times else None,
        }
        if not self._final_m:
            return out
        final_m = np.array(self._final_m)
        out["position_final_mean_m"] = float(final_m.mean())
        out["position_final_rms_m"] = float(np.sqrt(np.mean(final_m**2)))
        out["attitude_final_mean_deg"] = float(np.mean(self._final_deg))
        out["rms_over_pcrb"] = over_altitude(np.sqrt(self._squares / self._variances), self._altitude_m)
        return out
