"""Figures of every estimator over the trials of a campaign."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from craternav_fg.campaign.read import Campaign
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.estimators.registry import RETROSPECTIVE
from craternav_fg.evaluation.consistency import over_altitude, rms
from craternav_fg.runs.columns import list_values

FloatArray = npt.NDArray[np.float64]

# A trial has converged when its final errors are within the limits of Tian et al. (2019), section 4.2.3:
# 1 deg, and 200 m at 10 km, which is taken as a share of the altitude.
CONVERGED_SHARE_OF_ALTITUDE = 0.02
CONVERGED_DEG = 1.0


def summarise(campaign: Campaign) -> dict[str, Any]:
    """Summarise a campaign.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    dict
        Contents of summary.json. For each estimator:

        trajectories : trials in which it gave a trajectory
        converged : trials whose final errors are below 2 % of the altitude and 1 deg
        position_final_mean_m, position_final_rms_m : of the final position error
        attitude_final_mean_deg : of the final attitude error
        rms_over_pcrb : RMS position error over the trials divided by the posterior Cramér-Rao bound, averaged
            over the altitude; the bound is the smoothing one for estimators that use later data
        anees : of the pose, 6 when the covariances are consistent
        time_per_trial_s : median wall time

        All but the two counts are over the trials with a trajectory; null without any. Estimators that fail
        on hard trials look better on the remaining ones.
    """
    names = campaign.identity["estimators"]
    return {
        "trials": len(campaign.failed) + len(campaign.failures),
        "failed": len(campaign.failed),
        "wall_s": campaign.wall_s,
        "estimators": {name: _estimator(campaign, name) for name in names},
    }


def of_estimator(table: pa.Table, name: str, column: str) -> FloatArray:
    """Give a column for one estimator, by trial and frame.

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


def _estimator(campaign: Campaign, name: str) -> dict[str, Any]:
    table = campaign.table
    position_m = np.linalg.norm(of_estimator(table, name, "position_error_m"), axis=-1)
    times = [parts[name] for parts in campaign.times_s.values() if name in parts]
    out: dict[str, Any] = {
        "trajectories": len(position_m),
        "converged": 0,
        "position_final_mean_m": None,
        "position_final_rms_m": None,
        "attitude_final_mean_deg": None,
        "rms_over_pcrb": None,
        "anees": None,
        "time_per_trial_s": float(np.median(times)) if times else None,
    }
    if not len(position_m):
        return out
    final_m = position_m[:, -1]
    attitude = of_estimator(table, name, "attitude_error_rad")[:, -1]
    final_deg = np.degrees(np.linalg.norm(attitude, axis=-1))
    altitude_m = of_estimator(table, name, "altitude_m")
    nees = of_estimator(table, name, "nees")
    near = (final_m <= CONVERGED_SHARE_OF_ALTITUDE * altitude_m[:, -1]) & (final_deg <= CONVERGED_DEG)
    out["converged"] = int(np.count_nonzero(near))
    out["position_final_mean_m"] = float(final_m.mean())
    out["position_final_rms_m"] = float(np.sqrt(np.mean(final_m**2)))
    out["attitude_final_mean_deg"] = float(final_deg.mean())
    out["rms_over_pcrb"] = _over_altitude(rms_over_bound(table, name), altitude_m[0])
    out["anees"] = float(nees.mean()) if np.isfinite(nees).all() else None
    return out


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
    bound = SMOOTHED_BOUND if name in RETROSPECTIVE else FILTERED_BOUND
    sigma = of_estimator(table.filter(of_trials), bound, "pose_sigma")[..., 3:]
    return rms(e) / rms(sigma)


def _over_altitude(values: FloatArray, altitude_m: FloatArray) -> float:
    """Average values (frames,) over the altitude, or over the frames of a level flight."""
    level = len(values) == 1 or np.ptp(altitude_m) == 0.0
    return float(values.mean()) if level else over_altitude(values, altitude_m)
