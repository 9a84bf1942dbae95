"""Marginal covariances of some variables of a graph, by square roots of information.

A graph is eliminated once: by QR, or by Cholesky factorisation where that keeps enough digits. From the root
of its Bayes tree down, each clique gets the joint density of its variables: its own conditional density
beside the marginal density of those that its parent has too. Both are triangular square roots of information,
which rotations keep accurate. Covariances in their place would lose all digits: a state follows from the next
one by the IMU alone, and errors grow along the descent.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import accumulate

import gtsam
import numpy as np

from craternav_fg.estimators.elimination import rounding
from craternav_fg.estimators.graph import cholesky_order
from factors.arrays import BoolArray, FloatArray
from factors.kernels.compiled import njit


class Marginals:
    """Marginal covariances of a graph that is linearised where its variables are.

    `gtsam.Marginals` offers Cholesky factorisation only, and `gtsam.ISAM2` takes twice the time.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Without constrained noise models, which have no square root of information.
    values : gtsam.Values
    cholesky : bool
        Eliminate by Cholesky factorisation, where it does not refuse: a fifth of the cost where rims have
        errors of their own, but see `rounding`.

    Attributes
    ----------
    cholesky : bool
        Whether it did not refuse.
    step : gtsam.VectorValues
        Step to the minimum of the linear graph's error.
    predicted_decrease : float
        By how much this error, half a sum of squares, falls with the step: 0 at an optimum.

    Raises
    ------
    RuntimeError
        When the elimination meets a variable that nothing determines. One that is almost undetermined gets a
        large covariance instead.
    """

    def __init__(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *, cholesky: bool = False
    ) -> None:
        linear = graph.linearize(values)
        self.cholesky = False
        if cholesky:
            order = cholesky_order(graph, linear)
            apart = order.apart(linear)
            with suppress(RuntimeError):
                self._tree = apart.eliminateMultifrontal(order.ordering)
                self.cholesky, linear = True, apart
        if not self.cholesky:
            ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
            self._tree = linear.eliminateMultifrontal(ordering, gtsam.EliminateQR)
        self._linear = linear
        self.step = self._tree.optimize()
        here = gtsam.VectorValues.Zero(self.step)
        self.predicted_decrease = float(linear.error(here) - linear.error(self.step))
        self._sizes = {key: len(self.step.at(key)) for key in linear.keyVector()}

    def rounding(self, covariances: Mapping[int, FloatArray]) -> float:
        """Estimate the relative error of variances that rounding leaves, see `elimination.rounding`.

        Parameters
        ----------
        covariances : mapping of int to ndarray, shape (m, m)
            Covariances of some variables, as `covariances` gives them.

        Returns
        -------
        float
            To an order of magnitude; 0 after an elimination by QR.
        """
        if not self.cholesky:
            return 0.0
        index = gtsam.VariableIndex(self._linear)
        largest = 0.0
        for key, covariance in covariances.items():
            information = np.zeros(len(covariance))
            for number in index.at(key):
                factor = self._linear.at(number)
                keys = list(factor.keys())
                place = _places(keys, self._sizes)[key]
                information += np.sum(factor.jacobian()[0][:, place] ** 2, axis=0)
            largest = max(largest, rounding(information, covariance))
        return largest

    def covariances(self, keys: Sequence[int]) -> dict[int, FloatArray]:
        """Compute the covariances of some variables.

        Parameters
        ----------
        keys : sequence of int

        Returns
        -------
        dict of int to ndarray, shape (m, m)
            Covariance of each variable, in the units of its steps.
        """
        wanted: defaultdict[int, list[int]] = defaultdict(list)
        children: defaultdict[int, list[gtsam.GaussianBayesTreeClique]] = defaultdict(list)
        # A clique, its variables that the parent has too, and the root of their marginal information.
        pending: list[tuple[gtsam.GaussianBayesTreeClique, list[int], FloatArray]] = []
        # Cliques between the root and the wanted variables, by their first variables.
        visited: set[int] = set()
        for key in keys:
            clique = self._tree[key]
            first = clique.conditional().firstFrontalKey()
            wanted[first].append(key)
            while first not in visited:
                visited.add(first)
                if clique.isRoot():
                    pending.append((clique, [], np.empty((0, 0))))
                    break
                below, clique = clique, clique.parent()
                first = clique.conditional().firstFrontalKey()
                children[first].append(below)
        out: dict[int, FloatArray] = {}
        while pending:
            clique, shared, root = pending.pop()
            conditional = clique.conditional()
            first = conditional.firstFrontalKey()
            order, joint = _joint(conditional, shared, root, self._sizes)
            ends = list(accumulate(map(self._sizes.__getitem__, order)))
            for key in wanted[first]:
                place = order.index(key)
                rows = inverse_rows(joint, ends[place] - self._sizes[key], ends[place])
                out[key] = rows @ rows.T
            for child in children[first]:
                theirs = set(child.conditional().keys())
                kept = np.zeros(len(joint), dtype=np.bool_)
                common = []
                for key, end in zip(order, ends, strict=True):
                    if key in theirs:
                        common.append(key)
                        kept[end - self._sizes[key] : end] = True
                pending.append((child, common, marginal_root(joint, kept)))
        return out


def _joint(
    conditional: gtsam.GaussianConditional, shared: list[int], root: FloatArray, sizes: Mapping[int, int]
) -> tuple[list[int], FloatArray]:
    """Return a clique's variables and the root of their joint information: R S above 0 root."""
    R, keys = conditional.R(), list(conditional.keys())
    n, own = len(R), keys[: len(keys) - len(shared)]
    joint = np.zeros((n + len(root), n + len(root)))
    joint[:n, :n] = R
    if shared:
        S, columns = conditional.S(), _places(keys[len(own) :], sizes)
        if keys[len(own) :] == shared:
            joint[:n, n:] = S
        else:
            for key, place in _places(shared, sizes, n).items():
                joint[:n, place] = S[:, columns[key]]
        joint[n:, n:] = root
    return [*own, *shared], joint


def _places(keys: Sequence[int], sizes: Mapping[int, int], begin: int = 0) -> dict[int, slice]:
    """Places of variables that follow each other."""
    out = {}
    for key in keys:
        end = begin + sizes[key]
        out[key] = slice(begin, end)
        begin = end
    return out


@njit(cache=True, error_model="numpy")
def marginal_root(joint: FloatArray, kept: BoolArray) -> FloatArray:
    """Marginalise variables out of a Gaussian given by a square root of its information.

    Parameters
    ----------
    joint : ndarray, shape (n, n)
        Upper triangular R, with R' R the information; its lower half must be zero. In the variables' units.
    kept : ndarray of bool, shape (n,)
        The k variables that are kept.

    Returns
    -------
    ndarray, shape (k, k)
        Upper triangular root of their marginal information, in their order and units.
    """
    n = joint.shape[0]
    R = joint.copy()
    # Columns that begin in the rows from `top` on. A variable that goes is rotated into the row `top`.
    staying = np.empty(n, dtype=np.int64)
    top = count = 0
    for c in range(n):
        if kept[c]:
            staying[count] = c
            count += 1
            continue
        for i in range(c - 1, top - 1, -1):
            a, b = R[i, c], R[i + 1, c]
            length = np.sqrt(a * a + b * b)
            if length == 0.0:
                continue
            cos, sin = a / length, b / length
            for j in range(staying[i - top], n):
                upper, lower = R[i, j], R[i + 1, j]
                R[i, j] = cos * upper + sin * lower
                R[i + 1, j] = cos * lower - sin * upper
        top += 1
    out = np.zeros((count, count))
    for i in range(count):
        for j in range(i, count):
            out[i, j] = R[top + i, staying[j]]
    return out


@njit(cache=True, error_model="numpy")
def inverse_rows(R: FloatArray, begin: int, end: int) -> FloatArray:
    """Compute rows of the inverse of an upper triangular matrix.

    Parameters
    ----------
    R : ndarray, shape (n, n)
        Upper triangular, in any units.
    begin, end : int
        The rows.

    Returns
    -------
    ndarray, shape (end - begin, n)
        Rows of the inverse, in the inverse units.
    """
    n = R.shape[0]
    out = np.zeros((end - begin, n))
    for k in range(begin, end):
        y = out[k - begin]
        y[k] = 1.0
        for i in range(k, n):
            y[i] /= R[i, i]
            for j in range(i + 1, n):
                y[j] -= R[i, j] * y[i]
    return out
