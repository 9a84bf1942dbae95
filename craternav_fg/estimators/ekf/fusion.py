"""Fusion of sub-filters, eq. (29), and its exact form, which counts a shared prior once.

Two cases. Sub-filters that run on their own are combined as estimates (`combine`, eq. (29) itself).
Sub-filters that updated one common prior are combined in that prior's whitened coordinates (`fuse_updates`):
with the prior's covariance L L' and errors L e, the prior's information is the identity, whatever the states'
units.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from craternav_fg.estimators import filter_kernel
from craternav_fg.estimators.linearisation import LinearMeasurement
from craternav_fg.linalg import whitening
from factors.arrays import FloatArray

Rule = Literal["paper-fed-back", "exact", "covariance-intersection"]


def fuse_updates(
    covariance: FloatArray, updates: Sequence[LinearMeasurement], rule: Rule
) -> tuple[FloatArray, FloatArray]:
    """Fuse sub-filters that each updated the same prior with their own measurement.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Covariance of the common prior.
    updates : sequence of LinearMeasurement
        One per sub-filter, at least one, all on the same k first states.
    rule : {"exact", "paper-fed-back", "covariance-intersection"}
        "exact": information sum Lambda_i - (N - 1) Lambda_prior, equal to one central update.
        "paper-fed-back": sum Lambda_i as eq. (29), the prior counted N times.
        "covariance-intersection": mean of the Lambda_i (weights 1/N), conservative for any correlation.

    Returns
    -------
    delta : ndarray, shape (n,)
        Correction of the prior's mean, in the units of the error state.
    covariance : ndarray, shape (n, n)
        Covariance of the fused estimate.

    Raises
    ------
    LinAlgError
        When the covariance is not positive definite.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (29); docs/equations.md.
    """
    return fuse_rows(covariance, stacked(updates), len(updates), rule)


def fuse_rows(
    covariance: FloatArray, rows: LinearMeasurement, count: int, rule: Rule
) -> tuple[FloatArray, FloatArray]:
    """Fuse sub-filters as `fuse_updates` does, given the rows of all their measurements.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Covariance of the common prior.
    rows : LinearMeasurement
        Of k first states.
    count : int
        Number of sub-filters.
    rule : {"exact", "paper-fed-back", "covariance-intersection"}
        As of `fuse_updates`.

    Returns
    -------
    delta : ndarray, shape (n,)
        Correction of the prior's mean, in the units of the error state.
    covariance : ndarray, shape (n, n)
        Covariance of the fused estimate.

    Raises
    ------
    LinAlgError
        When the covariance is not positive definite.
    """
    # Whitened information of sub-filter i: I + A_i' A_i.
    prior = float(count) if rule == "paper-fed-back" else 1.0
    share = 1.0 / count if rule == "covariance-intersection" else 1.0
    delta, out, sound = filter_kernel.fused(covariance, rows.A, rows.residual, prior, share)
    if not sound:
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return delta, out


def stacked(updates: Sequence[LinearMeasurement]) -> LinearMeasurement:
    """Stack the rows of measurements of the same states.

    Parameters
    ----------
    updates : sequence of LinearMeasurement
        At least one.

    Returns
    -------
    LinearMeasurement
    """
    if len(updates) == 1:
        return updates[0]
    A = np.concatenate([update.A for update in updates])
    return LinearMeasurement(A, np.concatenate([update.residual for update in updates]))


def combine(deltas: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Combine estimates as if their errors were independent: eq. (29).

    Parameters
    ----------
    deltas : ndarray, shape (N, n)
        The estimates, as error-state vectors from a common reference, in the units of the error state.
    covariances : ndarray, shape (N, n, n)

    Returns
    -------
    delta : ndarray, shape (n,)
        In the units of the error state.
    covariance : ndarray, shape (n, n)

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (29); docs/equations.md.
    """
    white = whitening(covariances)
    total = np.einsum("kij,kil->jl", white, white)
    vector = np.einsum("kij,ki->j", white, np.einsum("kij,kj->ki", white, deltas))
    inverse = whitening(total)
    return inverse.T @ (inverse @ vector), inverse.T @ inverse
