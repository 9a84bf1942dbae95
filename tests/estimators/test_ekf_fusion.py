"""Fusion rules on linear sub-filters: which of them is consistent."""

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.estimators.ekf.fusion import combine, fuse_updates
from craternav_fg.estimators.linearisation import LinearMeasurement


def linear_toy(rule, runs=100, steps=15, filters=3, seed=0):
    """NEES per step of three sub-filters on one linear, observable system of 6 states."""
    rng = np.random.default_rng(seed)
    F = np.eye(6)
    F[:3, 3:] = 0.1 * np.eye(3)
    Q = np.diag(np.repeat([1e-4, 1e-2], 3))
    H = [rng.normal(size=(2, 6)) * np.repeat([1.0, 0.2], 3) for _ in range(filters)]
    out = np.zeros((runs, steps))
    for run in range(runs):
        x, P = np.zeros(6), np.eye(6)
        truth = rng.normal(size=6)
        own = [(x, P)] * filters
        for step in range(steps):
            truth = F @ truth + np.sqrt(np.diag(Q)) * rng.normal(size=6)
            z = [h @ truth + rng.normal(size=2) for h in H]
            if rule == "paper":
                own = [(F @ a, F @ p @ F.T + Q) for a, p in own]
                updated = []
                for (a, p), h, zi in zip(own, H, z, strict=True):
                    d, p1 = fuse_updates(p, [LinearMeasurement(h, zi - h @ a)], "exact")
                    updated.append((a + d, p1))
                own = updated
                x, P = combine(np.array([a for a, _ in own]), np.array([p for _, p in own]))
            else:
                x, P = F @ x, F @ P @ F.T + Q
                d, P = fuse_updates(
                    P, [LinearMeasurement(h, zi - h @ x) for h, zi in zip(H, z, strict=True)], rule
                )
                x = x + d
            e = truth - x
            out[run, step] = e @ np.linalg.solve(P, e)
    return out.mean(axis=0)


def test_only_the_exact_rule_is_consistent_on_a_linear_system():
    anees = {
        rule: linear_toy(rule) for rule in ("exact", "paper", "paper-fed-back", "covariance-intersection")
    }
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * 100) / 100
    assert low < anees["exact"][0] < high
    assert low < anees["exact"][-1] < high
    # Eq. (29) on the output counts three priors in every step, and stays there.
    assert 8.0 < anees["paper"][0] < 20.0
    assert 8.0 < anees["paper"][-1] < 20.0
    # Fed back, it trusts itself more in every step.
    assert anees["paper-fed-back"][0] > high
    assert anees["paper-fed-back"][-1] > 5 * anees["paper-fed-back"][0]
    assert anees["covariance-intersection"][0] < anees["exact"][0]
    assert anees["covariance-intersection"][-1] < low


def test_equation_29_weighs_by_information():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 5, 5))
    covariances = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(5)
    x = rng.normal(size=(4, 5))
    units = 10.0 ** np.array([-6, -3, 0, 3, 6])
    delta, covariance = combine(x * units, covariances * np.outer(units, units))
    # Least squares on the stacked estimates, by another road.
    rows = np.vstack([np.linalg.inv(np.linalg.cholesky(c)) for c in covariances])
    values = np.concatenate(
        [np.linalg.inv(np.linalg.cholesky(c)) @ v for c, v in zip(covariances, x, strict=True)]
    )
    expected, *_ = np.linalg.lstsq(rows, values, rcond=None)
    np.testing.assert_allclose(delta / units, expected, rtol=1e-9)
    np.testing.assert_allclose(
        covariance / np.outer(units, units), np.linalg.inv(rows.T @ rows), rtol=1e-9, atol=1e-12
    )


def test_a_covariance_that_is_not_positive_definite_is_refused():
    update = LinearMeasurement(np.eye(2), np.ones(2))
    with pytest.raises(np.linalg.LinAlgError):
        fuse_updates(np.array([[1.0, 2.0], [2.0, 1.0]]), [update], "exact")
    with pytest.raises(np.linalg.LinAlgError):
        fuse_updates(np.eye(2), [LinearMeasurement(np.full((1, 2), np.nan), np.ones(1))], "exact")
