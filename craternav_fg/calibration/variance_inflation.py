"""Variance inflation for estimators that treat correlated errors as white.

The filter is run on simulated descents whose rims err as the error model says: white, time-correlated and
shared. The inflation sought is that with which its mean squared normalised error is what it should be.

It is kept a little larger: covariances that are too small mislead, those that are too large do not.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import pixel_chart, shape_change
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.correlated_errors import (
    STATE_SIZE,
    VARIANCE_INFLATION,
    RimErrorOptions,
    transition,
)
from craternav_fg.estimators.ekf.filter import DistributedEkf, EkfOptions
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.linalg import square_root
from craternav_fg.measurements import CORRELATED_SIZE, SHARED_SIZE, FrameMeasurement
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, correlated_roots
from craternav_fg.vision.error_model.systematic import RimErrors, floor_covariance
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Trials that no test uses.
_FIRST_TRIAL, _TRIALS = 700, 30
# White error of an edge point, px: as the scatter of rendered rims has it.
_EDGE_SIGMA_PX = 0.15
_IMU_RATE_HZ = 20.0
# ANEES is interpolated between these, whose logarithms are evenly spaced.
_INFLATIONS = np.array([2.0, 3.0, 4.5, 6.75])
# What the data give.
_KNOWN = 3.3
# ANEES of a consistent pose.
_CONSISTENT = 6.0


def variance_inflation() -> list[Regenerated]:
    """Regenerate `estimators.correlated_errors.VARIANCE_INFLATION`.

    Returns
    -------
    list of Regenerated
    """
    by_trial = np.array([_anees(trial) for trial in range(_FIRST_TRIAL, _FIRST_TRIAL + _TRIALS)])
    every = [_consistent(np.delete(by_trial, k, axis=0).mean(axis=0)) for k in range(_TRIALS)]
    # Jackknife.
    error = np.sqrt((_TRIALS - 1.0) * np.var(every))
    value = _consistent(by_trial.mean(axis=0))
    name = "correlated_errors.VARIANCE_INFLATION"
    return [Regenerated(name, VARIANCE_INFLATION, value, float(error), Relation.KEPT, _KNOWN)]


def _consistent(anees: FloatArray) -> float:
    """Inflation at which ANEES (4,) is consistent, by a quadratic in the logarithms."""
    x, y = np.log(_INFLATIONS), np.log(anees / _CONSISTENT)
    fit = np.polynomial.Polynomial.fit(y, x, 2)
    return float(np.exp(fit(0.0)))


def _anees(trial: int) -> FloatArray:
    """Mean squared normalised pose error (4,) of the filter in a trial, with each inflation."""
    scenario = load_scenario("measured_descent")
    assert scenario.measurements is not None
    assert scenario.imu is not None
    changed = {
        "measurements": scenario.measurements.model_copy(update={"edge_sigma_px": _EDGE_SIGMA_PX}),
        "imu": scenario.imu.model_copy(update={"rate_hz": _IMU_RATE_HZ}),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = simulate(scenario.model_copy(update=changed), Path(folder) / "dataset", trial=trial)
        dataset = Dataset.open(path)
    assert dataset.truth is not None
    measured = _with_correlated_errors(dataset, np.random.default_rng(trial))
    descent = Descent.of(dataset)
    problem = Problem(**vars(descent), start=find_start(descent, measured), frames=measured)
    out = []
    for inflation in _INFLATIONS:
        ekf = DistributedEkf(options=EkfOptions(variance_inflation=float(inflation)))
        estimate = ekf.estimate(problem)
        assert estimate.pose_covariance is not None
        out.append(nees(errors(estimate, dataset.truth).pose, estimate.pose_covariance).mean())
    return np.array(out)


def _with_correlated_errors(dataset: Dataset, rng: np.random.Generator) -> list[FrameMeasurement]:
    """Return the frames of a data set with systematic errors of rims beside the white ones that they have."""
    assert dataset.measurements is not None
    assert dataset.truth is not None
    camera, catalog, options = dataset.camera, dataset.catalog, CorrelatedErrorOptions()
    common = rng.standard_normal(SHARED_SIZE)
    states: dict[int, tuple[FloatArray, FloatArray]] = {}
    out = []
    for frame, gTb in zip(dataset.measurements, dataset.truth.gTb, strict=True):
        rims = frame.rims
        rows = rims.craters
        charts = project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[0]
        floors = _floors(charts, camera)
        level = RimErrors(rims.covariance + floors, floors, np.zeros((len(rows), 5)))
        sun_g = dataset.sun.at(frame.stamp_ns)
        kept, shared = correlated_roots(level, rows, gTb, sun_g, camera, catalog, options)
        new = np.sqrt(1.0 - options.crater_share) * np.linalg.cholesky(floors)
        error = shared @ common + np.einsum("nij,nj->ni", new, rng.standard_normal((len(rows), 5)))
        for i, crater in enumerate(rows.tolist()):
            state = np.asarray(rng.standard_normal(STATE_SIZE))
            if crater in states:
                before, chart = states[crater]
                F = transition(float(shape_change(chart, charts[i])), RimErrorOptions().decay_shape_change)
                state = F @ before + square_root(np.eye(STATE_SIZE) - F @ F.T) @ state
            states[crater] = state, charts[i]
            error[i] += kept[i] @ state[:CORRELATED_SIZE]
        covariance = level.covariance + shared @ np.swapaxes(shared, 1, 2)
        told = replace(
            rims, chart=rims.chart + error, covariance=covariance, correlated=kept, shared=shared
        )  # fmt: skip
        out.append(replace(frame, rims=told))
    return out


def _floors(charts: FloatArray, camera: Camera) -> FloatArray:
    """Systematic covariances (n, 5, 5) of charts (n, 5) of elliptic rims."""
    fit = FitOptions()
    floors = [floor_covariance(y, fit.floor_px, fit.floor_share) for y in pixel_chart(charts, camera)]
    scale = np.array([1.0 / camera.fx_px, 1.0 / camera.fy_px, 1.0, 1.0, 1.0])
    return np.array(floors).reshape(-1, 5, 5) * np.outer(scale, scale)
