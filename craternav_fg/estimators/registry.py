"""The estimators by name."""

import difflib
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

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
    calibration = Calibration(
        map_place_sigma_share=0.01, map_height_sigma_share=0.01, map_size_sigma_share=0.01
    )
    return BatchSmoother(BatchOptions(calibration=calibration), "map_refining_smoother")


def _smoother_of(rims: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: BatchSmoother(BatchOptions(rims=rims, rim_errors=None, crater_freedom=None), name)


def _online_of(rims: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: OnlineSmoother(GraphOptions(rims=rims, rim_errors=None), name)


def _ekf_of(measurement: RimModel, name: str) -> Callable[[], Estimator]:
    return lambda: DistributedEkf(name, EkfOptions(measurement=measurement))


@dataclass(frozen=True)
class _Shipped:
    """An estimator of this package.

    Attributes
    ----------
    make : callable
    description : str
        What it is, for people who choose.
    retrospective : bool
        Whether its estimate at a frame uses later data as well.
    on_request : bool
        Whether it runs only when asked for: each extra parameter raises the variance.
    """

    make: Callable[[], Estimator]
    description: str
    retrospective: bool = False
    on_request: bool = False


_SHIPPED = {
    "smoother": _Shipped(
        BatchSmoother, "batch: all states from all data, Levenberg-Marquardt", retrospective=True
    ),
    "gnc_smoother": _Shipped(
        GncSmoother, "batch for many wrong matches: graduated non-convexity", retrospective=True
    ),
    "self_calibrating_smoother": _Shipped(
        _self_calibrating_smoother,
        "batch, with the camera's mounting and time offset estimated along",
        retrospective=True,
        on_request=True,
    ),
    "map_refining_smoother": _Shipped(
        _map_refining_smoother,
        "batch, with the craters' errors on the map estimated along",
        retrospective=True,
        on_request=True,
    ),
    "smoother_eq19": _Shipped(
        _smoother_of("eq19", "smoother_eq19"),
        "batch on eq. (19) of Tian et al. (2019)",
        retrospective=True,
        on_request=True,
    ),
    "smoother_los": _Shipped(
        _smoother_of("los", "smoother_los"),
        "batch on lines of sight, eq. (11) of Tian et al. (2019)",
        retrospective=True,
        on_request=True,
    ),
    "online": _Shipped(OnlineSmoother, "iSAM2: the estimate at a frame uses the data up to it"),
    "online_eq19": _Shipped(_online_of("eq19", "online_eq19"), "iSAM2 on eq. (19)", on_request=True),
    "online_los": _Shipped(_online_of("los", "online_los"), "iSAM2 on lines of sight", on_request=True),
    "fixed_lag": _Shipped(FixedLagSmoother, "iSAM2 over the last 30 s: bounded cost and memory"),
    "ekf": _Shipped(ekf, "extended Kalman filter, one sub-filter per crater, fused exactly"),
    "ekf_eq19": _Shipped(
        _ekf_of("eq19", "ekf_eq19"), "extended Kalman filter on eq. (19), whitened", on_request=True
    ),
    "ekf_los": _Shipped(
        _ekf_of("los", "ekf_los"), "extended Kalman filter on lines of sight", on_request=True
    ),
    "ekf_paper": _Shipped(ekf_paper, "distributed EKF as published by Tian et al. (2019)"),
    "centre_smoother": _Shipped(
        _smoother_of("centre", "centre_smoother"),
        "batch on the centres of image ellipses, taken for the craters'",
        retrospective=True,
    ),
    "dead_reckoning": _Shipped(DeadReckoning, "the IMU alone"),
}
ESTIMATORS: dict[str, Callable[[], Estimator]] = {name: one.make for name, one in _SHIPPED.items()}
DESCRIPTIONS = {name: one.description for name, one in _SHIPPED.items()}
ON_REQUEST = tuple(name for name, one in _SHIPPED.items() if one.on_request)
DEFAULT = tuple(name for name, one in _SHIPPED.items() if not one.on_request)
GROUP = "craternav_fg.estimators"
# Names of version 0.1, accepted until 0.3.
FORMER_NAMES = {
    "calibrating_smoother": "self_calibrating_smoother",
    "mapping_smoother": "map_refining_smoother",
}


def estimators() -> dict[str, Callable[[], Estimator]]:
    """Makers of all estimators by their names: those of this package, then those that others register.

    A package registers an estimator by an entry point: a class or function that makes one without arguments::

        [project.entry-points."craternav_fg.estimators"]
        my_estimator = "my_package:MyEstimator"

    If its estimates use later data as well, it has an attribute `retrospective` that is true.

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


def is_retrospective(name: str) -> bool:
    """Whether the estimates of an estimator use later data as well: the smoothing bound applies to it.

    Parameters
    ----------
    name : str

    Returns
    -------
    bool
        False of an estimator that is not installed here.

    Raises
    ------
    CraternavError
        As `estimators`.
    """
    if name in _SHIPPED:
        return _SHIPPED[name].retrospective
    return bool(getattr(estimators().get(name), "retrospective", False))


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
