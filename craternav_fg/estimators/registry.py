"""The estimators by name."""

import math
from collections.abc import Callable

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.ekf.filter import ekf, ekf_paper
from craternav_fg.estimators.gnc import GncSmoother
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother


def _centre_smoother() -> Estimator:
    return BatchSmoother(GraphOptions(rims="centre"), "centre_smoother")


def _calibrating_smoother() -> Estimator:
    """Estimate along what thermal distortion and a clock leave open."""
    calibration = Calibration(mounting_sigma_rad=math.radians(0.2), image_delay_sigma_s=0.02)
    return BatchSmoother(GraphOptions(calibration=calibration), "calibrating_smoother")


def _mapping_smoother() -> Estimator:
    """Estimate along what a good map leaves open."""
    calibration = Calibration(map_place_sigma=0.01, map_height_sigma=0.01, map_size_sigma=0.01)
    return BatchSmoother(GraphOptions(calibration=calibration), "mapping_smoother")


ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "smoother": BatchSmoother,
    "gnc_smoother": GncSmoother,
    "calibrating_smoother": _calibrating_smoother,
    "mapping_smoother": _mapping_smoother,
    "online": OnlineSmoother,
    "fixed_lag": FixedLagSmoother,
    "ekf": ekf,
    "ekf_paper": ekf_paper,
    "centre_smoother": _centre_smoother,
    "dead_reckoning": DeadReckoning,
}


# A freedom that is not needed costs accuracy: these are run when they are asked for.
ON_REQUEST = ("calibrating_smoother", "mapping_smoother")
DEFAULT = tuple(name for name in ESTIMATORS if name not in ON_REQUEST)
# Their estimate at a frame uses the data after it, too; those of the others only what came before.
RETROSPECTIVE = ("smoother", "gnc_smoother", "calibrating_smoother", "mapping_smoother", "centre_smoother")


def estimator(name: str) -> Estimator:
    """Make an estimator.

    Raises
    ------
    EstimationError
        When there is none of that name.
    """
    if name not in ESTIMATORS:
        raise EstimationError(f"unknown estimator {name!r}; expected one of {', '.join(ESTIMATORS)}")
    return ESTIMATORS[name]()
