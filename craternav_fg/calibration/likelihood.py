"""Maximum-likelihood estimates from independent groups of data, and their standard errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.optimize import minimize

from craternav_fg.errors import EstimationError
from factors.arrays import FloatArray

# Step of the differences, in units of the unknowns: far above rounding, far below where costs bend.
_DIFFERENCE = 0.02
# The search ends where Newton's step would change the cost by less: a tenth of a standard error. So many
# steps follow the quasi-Newton search at most.
_COST_TOLERANCE, _NEWTON_STEPS = 5e-3, 10
# Gradient of the cost, per unit of the unknowns, with which the quasi-Newton search ends.
_MAX_GRADIENT = 0.1
_CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
_SIGNS = (1.0, -1.0, -1.0, 1.0)


class Scale(Enum):
    """On which scale a parameter is estimated."""

    LINEAR = "linear"
    LOGARITHM = "logarithm"
    LOGIT = "logit"


@dataclass(frozen=True)
class Parameter:
    """A parameter to estimate.

    Attributes
    ----------
    start : float
        Where the search begins.
    scale : Scale
        Logarithm: positive. Logit: a share, 0 to 1.
    unit : float
        Unit of a linear scale: about the standard error that is expected.
    """

    start: float
    scale: Scale = Scale.LOGARITHM
    unit: float = 1.0

    @property
    def unknown(self) -> float:
        """The start as the search's unknown."""
        if self.scale is Scale.LINEAR:
            return self.start / self.unit
        return float(np.log(self.start / (1.0 - self.start if self.scale is Scale.LOGIT else 1.0)))

    def value(self, unknown: float) -> float:
        """Value for an unknown of the search."""
        if self.scale is Scale.LINEAR:
            return unknown * self.unit
        return float(1.0 / (1.0 + np.exp(-unknown)) if self.scale is Scale.LOGIT else np.exp(unknown))

    def slope(self, unknown: float) -> float:
        """Differentiate `value`."""
        if self.scale is Scale.LINEAR:
            return self.unit
        value = self.value(unknown)
        return value * (1.0 - value) if self.scale is Scale.LOGIT else value


def estimate(
    costs: Callable[[FloatArray], FloatArray], parameters: Sequence[Parameter]
) -> tuple[FloatArray, FloatArray]:
    """Estimate parameters, and their standard errors from the scatter between groups.

    The standard errors are those of the sandwich estimator: right also where the data are not distributed
    as the likelihood says, as long as the groups are independent.

    Parameters
    ----------
    costs : callable
        Takes the parameters' values, ndarray (p,), and gives the negative log-likelihood of each group,
        ndarray (groups,).
    parameters : sequence of Parameter, length p

    Returns
    -------
    values, errors : ndarray, shape (p,)
        In the parameters' own units.

    Raises
    ------
    EstimationError
        When the data do not determine the parameters.
    """

    def of(unknowns: FloatArray) -> FloatArray:
        return costs(np.array([p.value(u) for p, u in zip(parameters, unknowns, strict=True)]))

    start = np.array([p.unknown for p in parameters])

    def total(unknowns: FloatArray) -> float:
        return float(of(unknowns).sum())

    found = minimize(total, start, method="BFGS", options={"gtol": _MAX_GRADIENT})
    best = np.asarray(found.x, dtype=np.float64)
    for _ in range(_NEWTON_STEPS):
        gradients, hessian = _derivatives(of, best)
        if not np.linalg.eigvalsh(hessian)[0] > 0.0:
            break
        step = np.linalg.solve(hessian, gradients.sum(axis=1))
        if 0.5 * step @ gradients.sum(axis=1) < _COST_TOLERANCE:
            inverse, groups = np.linalg.inv(hessian), gradients.shape[1]
            covariance = inverse @ (gradients @ gradients.T) @ inverse * groups / (groups - 1)
            slopes = np.array([p.slope(u) for p, u in zip(parameters, best, strict=True)])
            values = np.array([p.value(u) for p, u in zip(parameters, best, strict=True)])
            return values, np.abs(slopes) * np.sqrt(np.diag(covariance))
        best = best - step
    raise EstimationError("the likelihood has no maximum near the start")


def _derivatives(
    costs: Callable[[FloatArray], FloatArray], unknowns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Differentiate each group's cost, (p, groups), and the sum of the costs twice, (p, p)."""
    steps = _DIFFERENCE * np.eye(len(unknowns))
    gradients = [(costs(unknowns + step) - costs(unknowns - step)) / (2.0 * _DIFFERENCE) for step in steps]
    hessian = np.empty((len(unknowns), len(unknowns)))
    for i, one in enumerate(steps):
        for j, other in enumerate(steps[: i + 1]):
            corners = [costs(unknowns + a * one + b * other).sum() for a, b in _CORNERS]
            hessian[i, j] = hessian[j, i] = np.dot(_SIGNS, corners) / (4.0 * _DIFFERENCE**2)
    return np.array(gradients), hessian


def gaussian_cost(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Negative log-likelihoods of Gaussian errors, but for a constant.

    Parameters
    ----------
    error : ndarray, shape (..., n)
        In any unit.
    covariance : ndarray, shape (..., n, n)
        In its square.

    Returns
    -------
    ndarray, shape (...,)
        Dimensionless.
    """
    _, log_determinant = np.linalg.slogdet(covariance)
    weighed = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray(0.5 * (log_determinant + np.sum(error * weighed, axis=-1)))
