"""The estimators by name."""

import difflib
import math
import warnings
from collections.abc import Callable

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.ekf.filter import DistributedEkf, EkfOptions, ekf, ekf_paper
from craternav_fg.estimators.gnc import GncSmoother
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.estimators.rim_models import RimModel
from craternav_fg.sensors.plugins import plugins


def _self_calibrating_smoother() -> Estimator:
    """Estimate the camera's mounting and time offset: what thermal distortion and a clock leave uncertain."""
    calibration = Calibration(mounting_sigma_rad=math.radians(0.2), time_offset_sigma_s=0.02)
    return BatchSmoother(BatchOptions(calibration=calibration), "self_calibrating_smoother")


def _map_refining_smoother() -> Estimator:
    """Estimate the craters' errors on the map, as large as those of a good catalogue."""
    calibration = Calibration(map_place_sigma=0.01, map_height_sigma=0.01, map_size_sigma=0.01)
    return BatchSmoother(BatchOptions(calibration=calibration), "map_refining_smoother")


def _smoother_of(rims: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: BatchSmoother(BatchOptions(rims=rims, rim_errors=None, crater_freedom=None), name)


def _online_of(rims: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: OnlineSmoother(GraphOptions(rims=rims, rim_errors=None), name)


def _ekf_of(measurement: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: DistributedEkf(name, EkfOptions(measurement=measurement))


ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "smoother": BatchSmoother,
    "gnc_smoother": GncSmoother,
    "self_calibrating_smoother": _self_calibrating_smoother,
    "map_refining_smoother": _map_refining_smoother,
    "smoother_eq19": _smoother_of("eq19", "smoother_eq19"),
    "smoother_los": _smoother_of("los", "smoother_los"),
    "online": OnlineSmoother,
    "online_eq19": _online_of("eq19", "online_eq19"),
    "online_los": _online_of("los", "online_los"),
    "fixed_lag": FixedLagSmoother,
    "ekf": ekf,
    "ekf_eq19": _ekf_of("eq19", "ekf_eq19"),
    "ekf_los": _ekf_of("los", "ekf_los"),
    "ekf_paper": ekf_paper,
    "centre_smoother": _smoother_of("centre", "centre_smoother"),
    "dead_reckoning": DeadReckoning,
}
# What each is, for people who choose.
DESCRIPTIONS = {
    "smoother": "batch: all states from all data, Levenberg-Marquardt",
    "gnc_smoother": "batch for many wrong matches: graduated non-convexity",
    "self_calibrating_smoother": "batch, with the camera's mounting and time offset estimated along",
    "map_refining_smoother": "batch, with the craters' errors on the map estimated along",
    "smoother_eq19": "batch on eq. (19) of Tian et al. (2019)",
    "smoother_los": "batch on lines of sight, eq. (11) of Tian et al. (2019)",
    "online": "iSAM2: the estimate at a frame uses the data up to it",
    "online_eq19": "iSAM2 on eq. (19)",
    "online_los": "iSAM2 on lines of sight",
    "fixed_lag": "iSAM2 over the last 30 s: bounded cost and memory",
    "ekf": "extended Kalman filter, one sub-filter per crater, fused exactly",
    "ekf_eq19": "extended Kalman filter on eq. (19), whitened",
    "ekf_los": "extended Kalman filter on lines of sight",
    "ekf_paper": "distributed EKF as published by Tian et al. (2019)",
    "centre_smoother": "batch on the centres of image ellipses, taken for the craters'",
    "dead_reckoning": "the IMU alone",
}
GROUP = "craternav_fg.estimators"
# Names of version 0.1, accepted until 0.3.
FORMER_NAMES = {
    "calibrating_smoother": "self_calibrating_smoother",
    "mapping_smoother": "map_refining_smoother",
}
# Run only when asked for: each extra parameter raises the variance.
ON_REQUEST = (
    "self_calibrating_smoother",
    "map_refining_smoother",
    "smoother_eq19",
    "smoother_los",
    "online_eq19",
    "online_los",
    "ekf_eq19",
    "ekf_los",
)
DEFAULT = tuple(name for name in ESTIMATORS if name not in ON_REQUEST)
# Their estimate at a frame uses later data as well; that of the others only the data up to it.
RETROSPECTIVE = (
    "smoother",
    "gnc_smoother",
    "self_calibrating_smoother",
    "map_refining_smoother",
    "smoother_eq19",
    "smoother_los",
    "centre_smoother",
)


def estimators() -> dict[str, Callable[[], Estimator]]:
    """Makers of all estimators by their names: those of this package, then those that others register.

    A package registers an estimator by an entry point: a class or function that makes one without arguments::

        [project.entry-points."craternav_fg.estimators"]
        my_estimator = "my_package:MyEstimator"

    Returns
    -------
    dict of str to callable

    Raises
    ------
    CraternavError
        When an entry point cannot be loaded, cannot be called, or takes a name that is taken.
    """
    found = dict(ESTIMATORS)
    for plugin in plugins(GROUP):
        if not callable(plugin.value):
            raise plugin.refused("expected a class or function that makes an estimator")
        if plugin.name in found:
            raise plugin.refused("there is an estimator of this name already")
        found[plugin.name] = plugin.value
    return found


def estimator(name: str) -> Estimator:
    """Make an estimator.

    Parameters
    ----------
    name : str
        One of `estimators`. A former name gives a `FutureWarning`, and the estimator under its present name.

    Returns
    -------
    Estimator

    Raises
    ------
    EstimationError
        When there is none of that name.
    """
    if name in FORMER_NAMES:
        present = FORMER_NAMES[name]
        warnings.warn(
            f"estimator {name!r} is now called {present!r}; the former name will be removed in version 0.3",
            FutureWarning,
            stacklevel=2,
        )
        name = present
    known = estimators()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise EstimationError(f"unknown estimator {name!r}{hint}; expected one of {', '.join(known)}")
    return known[name]()


def present_name(name: str) -> str:
    """Return the current name of an estimator that a file of an earlier version names.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        The same name where it is no former one.
    """
    return FORMER_NAMES.get(name, name)
