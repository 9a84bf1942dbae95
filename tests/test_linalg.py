"""Covariances of radians and metres, and triads."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from craternav_fg.linalg import (
    bisecting_triads,
    scaled_inverse,
    square_root,
    squared_distance,
    triads,
    whitening,
)

# Radians, and metres from afar: standard deviations of 1e-6 to 1e6.
SIGMAS = np.array([1e-6, 3e-6, 1e-5, 2e3, 1e5, 1e6])


def covariances(count: int = 4) -> np.ndarray:
    """Correlated, each with its unknowns in another order."""
    rng = np.random.default_rng(4)
    out = []
    for _ in range(count):
        root = np.eye(6) + 0.3 * rng.standard_normal((6, 6))
        sigmas = rng.permutation(SIGMAS)[:, None]
        out.append((sigmas * root) @ (sigmas * root).T)
    return np.array(out)


def exact_inverse(matrix: np.ndarray) -> np.ndarray:
    """By Gauss and Jordan in fractions."""
    n = len(matrix)
    rows = [
        [Fraction(float(v)) for v in row] + [Fraction(int(i == j)) for j in range(n)]
        for i, row in enumerate(matrix)
    ]
    for i in range(n):
        pivot = rows[i][i]
        rows[i] = [v / pivot for v in rows[i]]
        for k in range(n):
            if k != i:
                factor = rows[k][i]
                rows[k] = [v - factor * w for v, w in zip(rows[k], rows[i], strict=True)]
    return np.array([[float(v) for v in row[n:]] for row in rows])


def test_inverses_keep_their_digits_whatever_the_units() -> None:
    found = scaled_inverse(covariances())
    for one, C in zip(found, covariances(), strict=True):
        expected = exact_inverse(C)
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert_allclose(one / size, expected / size, atol=1e-12)


def test_results_do_not_depend_on_units() -> None:
    """Units that differ by powers of two change no digit."""
    C = covariances()
    units = 2.0 ** np.array([30, -20, 7, 0, -41, 12])
    scale = units[:, None] * units
    r = np.random.default_rng(7).standard_normal((4, 6))
    assert_array_equal(scaled_inverse(C * scale) * scale, scaled_inverse(C))
    assert_array_equal(square_root(C * scale) / units[:, None], square_root(C))
    assert_array_equal(whitening(C * scale) * units, whitening(C))
    assert_array_equal(squared_distance(r * units, C * scale), squared_distance(r, C))


def test_roots_and_whitening() -> None:
    C = covariances()
    L, W = square_root(C), whitening(C)
    sigmas = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    assert_allclose(L, np.tril(L), atol=0.0)
    assert_allclose(W * sigmas[:, None, :], np.tril(W * sigmas[:, None, :]), atol=1e-14)
    correlation = sigmas[:, :, None] * sigmas[:, None, :]
    assert_allclose(L @ np.swapaxes(L, 1, 2) / correlation, C / correlation, atol=1e-14)
    assert_allclose(W @ L, np.broadcast_to(np.eye(6), C.shape), atol=1e-12)
    assert_allclose(square_root(C[1]), L[1])
    assert_allclose(whitening(C[1]), W[1])


def test_what_is_no_covariance_is_refused() -> None:
    C = np.diag(SIGMAS**2)
    C[0, 1] = C[1, 0] = 1.01 * SIGMAS[0] * SIGMAS[1]
    for function in (square_root, whitening):
        with pytest.raises(np.linalg.LinAlgError):
            function(C)


def test_squared_distances() -> None:
    C, rng = covariances(), np.random.default_rng(5)
    z = rng.standard_normal((4, 6))
    r = np.einsum("nij,nj->ni", np.linalg.cholesky(C), z)
    assert_allclose(squared_distance(r, C), np.sum(z**2, axis=1), rtol=1e-6)
    assert float(squared_distance(r[2], C[2])) == pytest.approx(float(squared_distance(r, C)[2]))
    # One covariance for several residuals.
    several = squared_distance(np.stack([r[0], 2.0 * r[0]]), C[0])
    assert_allclose(several, float(squared_distance(r[0], C[0])) * np.array([1.0, 4.0]))


def test_triads_turn_as_the_directions_do() -> None:
    rng = np.random.default_rng(6)
    along, aside = rng.standard_normal((2, 5, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    unit = aside / np.linalg.norm(aside, axis=1, keepdims=True)
    turn = Rotation.random(5, rng=rng).as_matrix()

    def turned(v: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", turn, v)

    for function, first, second in ((triads, along, aside), (bisecting_triads, along, unit)):
        R = function(first, second)
        assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
        assert_allclose(np.linalg.det(R), 1.0)
        assert_allclose(function(turned(first), turned(second)), turn @ R, atol=1e-13)
    assert_allclose(triads(along, aside)[:, :, 0], along)
    assert np.all(np.einsum("ni,ni->n", triads(along, aside)[:, :, 1], aside) > 0.0)
    middle = bisecting_triads(along, unit)[:, :, 0]
    assert_allclose(np.sum(middle * along, axis=1), np.sum(middle * unit, axis=1))


def test_parallel_directions_make_no_nan() -> None:
    R = triads(np.array([1.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0]))
    assert_allclose(R[:, 1:], 0.0)


def test_nothing_is_near_by_a_singular_covariance() -> None:
    C = np.stack([np.eye(3), np.ones((3, 3)), 4.0 * np.eye(3)])
    assert_array_equal(squared_distance(np.ones((3, 3)), C), [3.0, np.inf, 0.75])
    assert_array_equal(squared_distance(np.ones(3), C[1]), np.inf)
