"""Transition and noise of the strapdown kernel over one row, against symbolic derivatives.

The motion is written as eqs (26) and (27) say, as rates at the row's start: the transition is exact to the
first order of the row, so the kernel's, less the identity and divided by the duration, tends to the rates'
Jacobian as the row gets short.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.linalg import expm

from factors.kernels import strapdown
from tests.factors.test_oracle import skew, symbols

MU = 4.9028e12
SPIN = np.array([2e-3, -1e-3, 3e-3])
# Attitude, position, velocity, gyro bias, accelerometer bias: what a row propagates.
ROWS = np.r_[0:9, 12:18]
SIZES = np.repeat([1.0, 1e5, 10.0, 1e-2, 1.0], 3)


@cache
def rates() -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Jacobians (15, 15) and (15, 12) of the error state's rate in the error state and in the noise."""
    phi, dP, dV, dg, da = (symbols(name, 3) for name in ("phi", "dP", "dV", "dg", "da"))
    noise = symbols("n", 12)
    R, P, V = sp.Matrix(3, 3, symbols("R", 9)), sp.Matrix(symbols("P", 3)), sp.Matrix(symbols("V", 3))
    w, f, spin = sp.Matrix(symbols("w", 3)), sp.Matrix(symbols("f", 3)), sp.Matrix(symbols("s", 3))
    mu = sp.Symbol("mu")
    turn = sp.eye(3) + skew(phi)
    Pt, Vt = P + sp.Matrix(dP), V + sp.Matrix(dV)
    # Measured less bias less noise; R exp(phi) turns with w_true, R with w, in one and the same g.
    w_true = w - sp.Matrix(dg) - sp.Matrix(noise[:3])
    f_true = f - sp.Matrix(da) - sp.Matrix(noise[3:6])
    phi_rate = w_true - w + sp.Matrix(phi).cross(w)

    def acceleration(R: sp.Matrix, P: sp.Matrix, V: sp.Matrix, f: sp.Matrix) -> sp.Matrix:
        gravity = -mu * P / (P.dot(P)) ** sp.Rational(3, 2)
        return R * f + gravity - 2 * spin.cross(V) - spin.cross(spin.cross(P))

    V_rate = acceleration(R * turn, Pt, Vt, f_true) - acceleration(R, P, V, f)
    rate = sp.Matrix([*phi_rate, *dV, *V_rate, *noise[6:]])
    state = [*phi, *dP, *dV, *dg, *da]
    at_zero = dict.fromkeys([*state, *noise], 0)
    arguments = [list(R), list(P), list(V), list(w), list(f), list(spin), mu]
    return tuple(
        sp.lambdify(arguments, rate.jacobian(v).subs(at_zero), "numpy", cse=True) for v in (state, noise)
    )


def one_row(
    seed: int, dt_s: float, covariance: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Covariance (15, 15) after a row from a random state, and the arguments of `rates` there."""
    rng = np.random.default_rng(seed)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    gTb = np.eye(4)
    gTb[:3, :3] = R * np.linalg.det(R)
    gTb[:3, 3] = 1.8e6 * rng.normal(size=3)
    V, bias = 900.0 * rng.normal(size=3), 1e-3 * rng.normal(size=6)
    w, f = 0.1 * rng.normal(size=3), 3.0 * rng.normal(size=3)
    gyro, force = (w + bias[:3])[None], (f + bias[3:])[None]
    dt = np.array([dt_s])
    out = strapdown.propagate(gTb, V, bias, covariance, dt, gyro, force, MU, SPIN, noise, dt_s)[3]
    return out[np.ix_(ROWS, ROWS)], (gTb[:3, :3].ravel(), gTb[:3, 3], V, w, f, SPIN)


@pytest.mark.parametrize("seed", range(4))
def test_transition(seed: int) -> None:
    """F P F' of a row, in the first order of its length: A P + P A'."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(15, 15))
    P = SIZES[:, None] * (M @ M.T) * SIZES
    whole = np.zeros((18, 18))
    whole[np.ix_(ROWS, ROWS)] = P

    def slope(dt_s: float) -> np.ndarray:
        return (one_row(seed, dt_s, whole, np.zeros(4))[0] - P) / dt_s

    # Extrapolated to a row of no length.
    dt_s = 1e-2
    found = (slope(dt_s) - 6.0 * slope(0.5 * dt_s) + 8.0 * slope(0.25 * dt_s)) / 3.0
    A = rates()[0](*one_row(seed, dt_s, whole, np.zeros(4))[1], MU)
    expected = A @ P + P @ A.T
    assert_allclose(found / np.outer(SIZES, SIZES), expected / np.outer(SIZES, SIZES), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_noise(seed: int) -> None:
    """The growth from certainty, in the first order of the row's length: B Q B'."""
    density = np.array([2e-4, 3e-3, 1e-5, 2e-4])
    dt_s = 1e-6
    found, at = one_row(seed, dt_s, np.zeros((18, 18)), density)
    B = rates()[1](*at, MU)
    expected = B @ np.diag(np.repeat(density**2, 3)) @ B.T
    scale = np.repeat([density[0], density[1], density[1], density[2], density[3]], 3)
    assert_allclose(found / dt_s / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)


@pytest.mark.parametrize("turn_rad", [1e-6, 9e-5, 1.1e-4, 0.02, 1.5])
def test_attitude_of_one_row_is_exact(turn_rad: float) -> None:
    """However far a row turns: constant rates in b and of g are two exponentials."""
    w, spin = np.array([0.3, -0.8, 0.52]), np.array([-0.2, 0.5, 0.7])
    w *= turn_rad / np.linalg.norm(w)
    spin *= 0.6 * turn_rad
    gTb = np.eye(4)
    gTb[:3, :3] = expm(np.array(skew([0.4, 0.1, -1.2]), dtype=np.float64))
    gTb[:3, 3] = [1.8e6, 0.0, 0.0]
    bias = np.array([1e-3, 2e-3, -1e-3, 0.0, 0.0, 0.0])
    found = strapdown.propagate(
        gTb, np.zeros(3), bias, np.eye(18), np.ones(1), (w + bias[:3])[None], np.zeros((1, 3)), MU, spin,
        np.zeros(4), 1.0,
    )[0]  # fmt: skip
    before, after = (expm(np.array(skew(v), dtype=np.float64)) for v in (-spin, w))
    assert_allclose(found[:3, :3], before @ gTb[:3, :3] @ after, rtol=0.0, atol=1e-14)
