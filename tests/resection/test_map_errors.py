"""Errors that the catalogue states are in the covariance of an image's pose."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.resection.files import as_plain_data
from craternav_fg.resection.map_errors import Solver, solve_with_map_errors
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.resection.robust import solve_all, solve_robustly
from tests.resection.matched_files import CAMERA, make_files

PLACE_M, SIZE_SHARE, HEIGHT_M, TRIALS = 25.0, 0.004, 15.0, 40


def mapped(true: Catalog, rng: np.random.Generator) -> Catalog:
    """Draw a map of the craters that is wrong by what it states."""
    n = len(true)
    north, east = PLACE_M / true.body.radius_m * rng.normal(size=(2, n))
    return replace(
        true,
        latitude_rad=true.latitude_rad + north,
        longitude_rad=true.longitude_rad + east / np.cos(true.latitude_rad),
        semi_major_m=true.semi_major_m * (1.0 + SIZE_SHARE * rng.normal(size=n)),
        semi_minor_m=true.semi_minor_m * (1.0 + SIZE_SHARE * rng.normal(size=n)),
        height_m=true.height_m + HEIGHT_M * rng.normal(size=n),
        errors=MapErrors(np.full(n, PLACE_M), np.full(n, SIZE_SHARE), np.full(n, HEIGHT_M)),
    )


@pytest.mark.parametrize("solver", [solve_all, solve_robustly])
def test_errors_of_the_map_are_in_the_covariance(tmp_path: Path, solver: Solver) -> None:
    """Unknown to the solver, they gave an ANEES of 50, and no pose in two of these trials."""
    files, rng = make_files(tmp_path), np.random.default_rng(11)
    measured, true = files.read(files.rims())
    L = np.linalg.cholesky(measured.covariance)
    stated, unstated = [], []
    for _ in range(TRIALS):
        catalog = mapped(true, rng)
        chart = measured.chart + (L @ rng.standard_normal((len(L), 5, 1)))[:, :, 0]
        rims = MatchedRims(catalog.identifiers, catalog.centres, catalog.axes, chart, measured.covariance)
        for one, out in ((catalog, stated), (replace(catalog, errors=None), unstated)):
            problem = ResectionProblem(rims, CAMERA.bTc)
            solved, result = solve_with_map_errors(problem, one, solver)
            if one.errors is None and not result.poses:
                continue
            assert result.poses, result.reason
            (pose, *_) = as_plain_data(solved, result, one)["poses"]
            gRb = frames.from_quaternion_wxyz(np.array(pose["attitude_wxyz"]))
            turned = frames.rotation_log(gRb.T @ files.gTb[:3, :3])
            off = np.concatenate([turned, files.gTb[:3, 3] - pose["position_m"]])
            out.append(float(off @ np.linalg.solve(np.array(pose["covariance"]), off)))
    low, high = chi2.ppf([0.001, 0.999], 6 * TRIALS) / TRIALS
    assert low < np.mean(stated) < high
    assert np.mean(unstated) > 2.0 * high
