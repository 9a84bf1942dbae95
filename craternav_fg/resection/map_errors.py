"""Errors that the catalogue states, in the pose of one image: each crater's counts once, as its rim's do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import relative_covariance
from craternav_fg.resection.problem import ResectionProblem, ResectionResult
from factors.arrays import FloatArray
from factors.kernels.rim_errors import ground_slopes

Solver = Callable[[ResectionProblem], ResectionResult]


def solve_with_map_errors(
    problem: ResectionProblem, catalog: Catalog, solver: Solver
) -> tuple[ResectionProblem, ResectionResult]:
    """Solve a problem with the errors of its craters in the covariances of the rims.

    What they do to the image depends on the pose, which is found with larger errors first.

    Parameters
    ----------
    problem : ResectionProblem
        With the errors of the measurement alone.
    catalog : Catalog
        The craters of the rims, in their order.
    solver : callable
        `solve_all`, for example.

    Returns
    -------
    problem : ResectionProblem
        What was solved.
    result : ResectionResult
    """
    if catalog.errors is None:
        return problem, solver(problem)
    variances = catalog.errors.variances(np.sqrt(catalog.semi_major_m * catalog.semi_minor_m))
    rims = problem.rims
    largest = variances.max(axis=1)[:, None, None] * relative_covariance(rims.chart, 1.0)
    wider = _with_covariance(problem, largest)
    result = solver(wider)
    if not result.poses:
        return wider, result
    slopes = ground_slopes(result.poses[0].gTb, problem.bTc, rims.centres, rims.axes)
    wider = _with_covariance(problem, (slopes * variances[:, None]) @ np.swapaxes(slopes, 1, 2))
    return wider, solver(wider)


def _with_covariance(problem: ResectionProblem, added: FloatArray) -> ResectionProblem:
    """Add covariances (n, 5, 5) to those of the rims."""
    return replace(problem, rims=replace(problem.rims, covariance=problem.rims.covariance + added))
