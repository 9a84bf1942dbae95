"""Figures of a campaign, estimator by estimator."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from craternav_fg.campaign.store import Campaign
from craternav_fg.campaign.trial import FILTERED_BOUND, SMOOTHED_BOUND
from craternav_fg.estimators.registry import RETROSPECTIVE
from craternav_fg.evaluation.consistency import over_altitude, rms

FloatArray = npt.NDArray[np.float64]

# A trial has converged when its last estimate is within what Tian et al. (2019) ask for at 10 km, section
# 4.2.3: 200 m, which is taken as a part of the altitude, and 1 deg.
CONVERGED_OF_ALTITUDE = 0.02
CONVERGED_DEG = 1.0


def summarise(campaign: Campaign) -> dict[str, Any]:
    """Sum up a campaign.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    dict
        What summary.json holds. Of each estimator: `trajectories`, trials in which it gave one; `converged`,
        trials whose last error is below 2 % of the altitude and 1 deg; mean and RMS of the last position
        error; mean of the last attitude error; `rms_over_pcrb`, the ratio of the position's RMS over the
        trials to that of the posterior Cramér-Rao bound (the smoothed one for those that look back),
        averaged over the altitude; `anees` of the pose, 6 when the covariances are honest; median wall time
        of a trial. All but the two counts are over the trials with a trajectory, which may be the easier
        ones; null without any.
    """
    names = campaign.identity["estimators"]
    return {
        "trials": len(campaign.failed) + len(campaign.failures),
        "failed": len(campaign.failed),
        "wall_s": campaign.wall_s,
        "estimators": {name: _estimator(campaign, name) for name in names},
    }


def of_estimator(table: pa.Table, name: str, column: str) -> FloatArray:
    """Values of a column, shape (trials, frames) or (trials, frames, d), NaN where there is none.

    Parameters
    ----------
    table : pyarrow.Table
        Of a `Campaign`.
    name : str
        An estimator, or one of the bounds.
    column : str
        Of `craternav_fg.campaign.trial.SCHEMA`.
    """
    rows = table.filter(pc.equal(table["estimator"], name))
    trials = len(pc.unique(rows["trial"]))
    values = rows[column].combine_chunks()
    if pa.types.is_fixed_size_list(values.type):
        size = values.type.list_size
        if values.null_count:
            return np.full((trials, len(rows) // max(trials, 1), size), np.nan)
        flat = values.flatten().to_numpy(zero_copy_only=False)
        return np.asarray(flat, dtype=np.float64).reshape(trials, -1 if trials else 0, size)
    flat = values.to_numpy(zero_copy_only=False)
    return np.asarray(flat, dtype=np.float64).reshape(trials, -1 if trials else 0)


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
    near = (final_m <= CONVERGED_OF_ALTITUDE * altitude_m[:, -1]) & (final_deg <= CONVERGED_DEG)
    out["converged"] = int(np.count_nonzero(near))
    out["position_final_mean_m"] = float(final_m.mean())
    out["position_final_rms_m"] = float(np.sqrt(np.mean(final_m**2)))
    out["attitude_final_mean_deg"] = float(final_deg.mean())
    out["rms_over_pcrb"] = _over_altitude(rms_over_bound(table, name), altitude_m[0])
    out["anees"] = float(nees.mean()) if np.isfinite(nees).all() else None
    return out


def rms_over_bound(table: pa.Table, name: str) -> FloatArray:
    """Ratio of the position's RMS over the trials to the bound's, shape (frames,).

    Parameters
    ----------
    table : pyarrow.Table
        Of a `Campaign`.
    name : str
        Estimator.
    """
    mine = pc.equal(table["estimator"], name)
    of_trials = pc.is_in(table["trial"], value_set=pc.unique(table.filter(mine)["trial"]))
    e = of_estimator(table, name, "position_error_m")
    bound = SMOOTHED_BOUND if name in RETROSPECTIVE else FILTERED_BOUND
    sigma = of_estimator(table.filter(of_trials), bound, "pose_sigma")[..., 3:]
    return rms(e) / rms(sigma)


def _over_altitude(values: FloatArray, altitude_m: FloatArray) -> float:
    level = len(values) == 1 or np.ptp(altitude_m) == 0.0
    return float(values.mean()) if level else over_altitude(values, altitude_m)
