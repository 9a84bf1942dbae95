"""What the next tree of an online smoother takes over: a snapshot of a state, and the factors since."""

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from craternav_fg.estimators.elimination import INDEX_BITS, INDEX_MASK, SENSOR_BIASES, STATE_LETTERS
from craternav_fg.linalg import whitening
from factors.arrays import FloatArray

# Letter of tracked points.
POINT = "l"
# Letters of variables whose tree can be replaced. Errors of rims are not handed on: those of all rims that
# may be seen again would make one dense factor, dearer than the whole tree; without them the present state
# would seem not to rest on rims that they spoilt.
HANDED_ON = {*STATE_LETTERS, POINT, *SENSOR_BIASES}
# A snapshot is taken when the newest attitude is known to this, as larger errors are not Gaussian. It is used
# when the later estimate agrees with it to this chi-square per degree of freedom.
SNAPSHOT_ATTITUDE_RAD = 0.01
SNAPSHOT_CHI2_RATIO = 50.0 / 15.0
# A tracked point goes on in the next tree when so many of its observations do.
LEAST_OBSERVATIONS = 3


@dataclass(frozen=True)
class Snapshot:
    """What was known of a state when it was the newest, and of the sensors' biases.

    Attributes
    ----------
    index : int
        Index of the state.
    size, slots : int
        Number of variables, tracked points left out, and of factor slots of the tree at that time.
    prior : gtsam.LinearContainerFactor
        Gaussian of the state and of the biases, from all factors so far.
    """

    index: int
    size: int
    slots: int
    prior: gtsam.LinearContainerFactor

    def contradicts(self, now: gtsam.Values) -> bool:
        """Whether later estimates of its variables disagree with it."""
        return bool(2.0 * self.prior.error(now) > SNAPSHOT_CHI2_RATIO * self.prior.dim())


def photograph(tree: gtsam.ISAM2, size: int) -> Snapshot | None:
    """Take a snapshot of the newest state.

    Parameters
    ----------
    tree : gtsam.ISAM2
    size : int
        Number of its variables, tracked points left out.

    Returns
    -------
    Snapshot or None
        None when the state is uncertain.
    """
    known = tree.getLinearizationPoint().keys()
    symbols = [gtsam.Symbol(key) for key in known]
    last = max(symbol.index() for symbol in symbols if chr(symbol.chr()) in STATE_LETTERS)
    keys = [
        symbol.key()
        for symbol in symbols
        if chr(symbol.chr()) in SENSOR_BIASES
        or (chr(symbol.chr()) in STATE_LETTERS and symbol.index() == last)
    ]
    joint = tree.jointMarginalCovariance(keys)
    pose = gtsam.symbol("x", last)
    if pose in keys and not np.diag(joint.at(pose, pose))[:3].max() < SNAPSHOT_ATTITUDE_RAD**2:
        return None
    try:
        W = whitening(joint.fullMatrix())
    except np.linalg.LinAlgError:
        # Rounding: a larger tree is better than a wrong prior.
        return None
    blocks = np.split(W, np.cumsum([joint.at(key, key).shape[0] for key in keys])[:-1], axis=1)
    point = tree.calculateBestEstimate()
    for symbol in symbols:
        if symbol.key() not in keys:
            point.erase(symbol.key())
    prior = gtsam.LinearContainerFactor(_jacobian_factor(keys, blocks), point)
    slots = tree.getFactorsUnsafe().size()
    return Snapshot(last, size, slots, prior)


def since(
    snapshot: Snapshot,
    factors: gtsam.NonlinearFactorGraph,
    now: gtsam.Values,
    added: gtsam.NonlinearFactorGraph,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Give what the next tree begins with.

    For tracked points the observations since the snapshot count, without what earlier ones told of the point.
    Those to which factors are about to be added are kept in any case.

    Parameters
    ----------
    snapshot : Snapshot
    factors : gtsam.NonlinearFactorGraph
        Of the present tree.
    now : gtsam.Values
        Its estimates.
    added : gtsam.NonlinearFactorGraph
        Factors that are about to be added.

    Returns
    -------
    graph : gtsam.NonlinearFactorGraph
        The snapshot, and the factors since.
    values : gtsam.Values
        Of their variables.
    """
    needed = _keys(added)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(snapshot.prior)
    of_points: dict[int, list[gtsam.NonlinearFactor]] = {}
    alone: dict[int, gtsam.NonlinearFactor] = {}
    letters = {ord(letter) for letter in STATE_LETTERS}
    # Priors of points may be older than the snapshot.
    for slot in range(0 if POINT in letters_of(now) else snapshot.slots, factors.size()):
        if not factors.exists(slot):
            continue
        factor = factors.at(slot)
        keys = factor.keys()
        # A key's first byte is its letter, the rest its index; a `gtsam.Symbol` takes ten times as long.
        states = [key & INDEX_MASK for key in keys if key >> INDEX_BITS in letters]
        points = [key for key in keys if key >> INDEX_BITS == ord(POINT)]
        if points and not states:
            alone[points[0]] = factor
        elif slot < snapshot.slots or min(states, default=snapshot.index) < snapshot.index:
            continue
        elif points:
            of_points.setdefault(points[0], []).append(factor)
        else:
            graph.push_back(factor)
    for point, prior in alone.items():
        observations = of_points.get(point, [])
        if point in needed or len(observations) >= LEAST_OBSERVATIONS:
            for factor in (prior, *observations):
                graph.push_back(factor)
    kept = _keys(graph)
    values = gtsam.Values(now)
    for key in now.keys():  # noqa: SIM118 (Values is no mapping)
        if key not in kept:
            values.erase(key)
    return graph, values


def _keys(graph: gtsam.NonlinearFactorGraph) -> set[int]:
    """Keys of a graph's variables."""
    factors = [graph.at(number) for number in range(graph.size())]
    return {key for factor in factors for key in factor.keys()}  # noqa: SIM118 (KeyVector is no mapping)


def letters_of(values: gtsam.Values) -> list[str]:
    """Letters of the keys of values."""
    return [chr(key >> INDEX_BITS) for key in values.keys()]  # noqa: SIM118 (Values is no mapping)


def handed_on(values: gtsam.Values) -> bool:
    """Whether a snapshot can hand on all variables."""
    return HANDED_ON.issuperset(letters_of(values))


def without_points(values: gtsam.Values) -> gtsam.Values:
    """Values of all variables but tracked points."""
    if POINT not in letters_of(values):
        return values
    out = gtsam.Values(values)
    for key in values.keys():  # noqa: SIM118 (Values is no mapping)
        if key >> INDEX_BITS == ord(POINT):
            out.erase(key)
    return out


def _jacobian_factor(keys: list[int], blocks: list[FloatArray]) -> gtsam.JacobianFactor:
    """Linear factor |sum A_i x_i|^2 by blocks A_i of columns."""
    rows = len(blocks[0])
    terms: list[Any] = list(zip(keys, blocks, strict=True))
    # The only constructor that takes any number of variables.
    unit = gtsam.noiseModel.Unit.Create(rows)
    return gtsam.JacobianFactor(gtsam.GaussianConditional(terms, len(keys), np.zeros(rows), unit))
