"""Cholesky factorisation of linear graphs, in an order that GTSAM accepts.

GTSAM refuses to factorise a clique of the Bayes tree where a variable keeps less than 2^-24 of its
information once those before it are eliminated. The IMU ties each state to the next one to millimetres,
images place it to metres: the very last state, in one clique with its neighbour, always keeps less. Any other
state has a stiff neighbour left when it is eliminated.
"""

from collections.abc import Iterable
from typing import NamedTuple

import gtsam
import numpy as np

from craternav_fg.estimators.correlated_errors import ERROR_LETTER, MAP_LETTERS, SHARED_LETTER
from factors.arrays import FloatArray

# Of a key, behind the letter.
INDEX_BITS = 56
INDEX_MASK = (1 << INDEX_BITS) - 1
# Letters of variables that belong to one state; others, such as the mounting, belong to all of them.
STATE_LETTERS = ("x", "v", "b")
# A sensor's bias has its length for a letter.
SENSOR_BIASES = tuple("123456789")
# Errors of one rim, of one crater on the map, and of all rims.
_RIM_ERRORS = tuple(map(ord, (ERROR_LETTER, *MAP_LETTERS.values(), SHARED_LETTER)))
_BIASES = tuple(map(ord, SENSOR_BIASES))
# Letter of variables on which nothing depends: with one, a clique has one variable more than its child. A
# graph that is eliminated once needs one; a tree that goes on, one for each state that was the newest.
APART_LETTER = "z"
_APART = gtsam.symbol(APART_LETTER, 0)
_POSE, *_OTHERS = STATE_LETTERS
_POSE_SIZE = 6


def separating_factor(pose: int, apart: int) -> gtsam.JacobianFactor:
    """Make the factor that keeps a state in a clique of its own, and changes no solution.

    GTSAM merges a clique with its parent where both have the same variables: here the parent has one more.

    Parameters
    ----------
    pose : int
        Key of the state's pose, eliminated first of the state's variables.
    apart : int
        Key of a variable of one dimension that no other factor has, eliminated last of all.

    Returns
    -------
    gtsam.JacobianFactor
    """
    unit = gtsam.noiseModel.Unit.Create(1)
    return gtsam.JacobianFactor(pose, np.zeros((1, _POSE_SIZE)), apart, np.eye(1), np.zeros(1), unit)


class CholeskyOrder:
    """Order to eliminate graphs of the same factors: the newest state last, in a clique of its own.

    Parameters
    ----------
    linear : gtsam.GaussianFactorGraph
        One of the graphs.

    Attributes
    ----------
    ordering : gtsam.Ordering
        For graphs as `apart` returns them.
    """

    def __init__(self, linear: gtsam.GaussianFactorGraph) -> None:
        known = linear.keyVector()
        poses = [key for key in known if chr(gtsam.Symbol(key).chr()) == _POSE]
        newest = gtsam.Symbol(max(poses)).index()
        pose, *others = (gtsam.symbol(letter, newest) for letter in (_POSE, *_OTHERS))
        last = [pose, *(key for key in others if key in known), _APART]
        self._separating = separating_factor(pose, _APART)
        self.ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(
            self.apart(linear), last, forceOrder=True
        )

    def apart(self, linear: gtsam.GaussianFactorGraph) -> gtsam.GaussianFactorGraph:
        """Add to a graph what keeps the newest state in a clique of its own, and changes no solution."""
        graph = gtsam.GaussianFactorGraph()
        graph.push_back(linear)
        graph.push_back(self._separating)
        return graph


def rounding(information: FloatArray, covariance: FloatArray) -> float:
    """Estimate the relative error of variances that rounding leaves after a Cholesky factorisation.

    It works on squares: it loses the digits by which the information of a variable, given all others, exceeds
    that of its marginal density. GTSAM does not see it where a state has a clique of its own.

    Parameters
    ----------
    information : ndarray, shape (m,)
        Of each entry given all others: inverse squares of its unit.
    covariance : ndarray, shape (m, m)
        Of the entries, in their units.

    Returns
    -------
    float
        To an order of magnitude, mostly too small.
    """
    return float(np.finfo(np.float64).eps * np.max(information * np.diag(covariance)))


class Order(NamedTuple):
    """Groups of variables, which iSAM2 eliminates in the order of their numbers; all others are in group 0.

    GTSAM writes beyond its arrays where a number is not below that of the variables that it orders.

    Attributes
    ----------
    update : gtsam.KeyGroupMap
        Of an update with a new state: three numbers, and at least four variables are ordered.
    later : gtsam.KeyGroupMap
        Of the updates until the next state: two, and at least three.
    """

    update: gtsam.KeyGroupMap
    later: gtsam.KeyGroupMap


def newest_last(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, Order | None]:
    """Order an update of iSAM2: last what the next frame changes, the newest state in a clique of its own.

    Errors of the newest rims come before it. GTSAM's own order keeps at the root all that new factors
    involve, also the states between two frames and the errors that new variables continue: a quarter of an
    update's cost.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        New factors.
    values : gtsam.Values
        New variables.

    Returns
    -------
    graph, values
        With what sets the newest state apart.
    order : Order or None
        None where there is no new state, or nothing ties its pose to its velocity, as in a first image.
    """
    newest = _newest(values)
    pose, velocity, *others = (gtsam.symbol(letter, max(newest, 0)) for letter in STATE_LETTERS)
    involved = [keys for keys in (graph.at(n).keys() for n in range(graph.size())) if pose in keys]
    if newest < 0 or not any(velocity in keys for keys in involved):
        return graph, values, None
    apart = apart_key(values)
    known = {key for keys in involved for key in keys}
    biases = {key for key in known if key >> INDEX_BITS in _BIASES}
    last = {velocity, apart, *biases, *(key for key in others if values.exists(key))}
    errors = {key for key in known if key >> INDEX_BITS in _RIM_ERRORS}
    order = Order(_groups(errors, {pose}, last), _groups({pose}, last))
    point = gtsam.Values()
    point.insert(pose, values.atPose3(pose))
    point.insert(apart, np.zeros(1))
    graph, values = gtsam.NonlinearFactorGraph(graph), gtsam.Values(values)
    graph.push_back(gtsam.LinearContainerFactor(separating_factor(pose, apart), point))
    values.insert(apart, np.zeros(1))
    return graph, values, order


def _groups(*keys: Iterable[int]) -> gtsam.KeyGroupMap:
    """Give groups of keys the numbers from 1 on."""
    groups = gtsam.KeyGroupMap()
    for number, some in enumerate(keys, start=1):
        for key in some:
            groups.insert2(key, number)
    return groups


def has_rim_errors(values: gtsam.Values) -> bool:
    """Whether some variables are errors of rims."""
    return any(key >> INDEX_BITS in _RIM_ERRORS for key in values.keys())  # noqa: SIM118 (no mapping)


def apart_key(values: gtsam.Values) -> int:
    """Key of the variable that sets the newest of some states apart; one that is nowhere without any."""
    newest = _newest(values)
    return int(gtsam.symbol(APART_LETTER, newest if newest >= 0 else INDEX_MASK))


def _newest(values: gtsam.Values) -> int:
    """Index of the newest state; -1 without any."""
    poses = (key for key in values.keys() if key >> INDEX_BITS == ord(_POSE))  # noqa: SIM118 (no mapping)
    return max((key & INDEX_MASK for key in poses), default=-1)
