"""Cholesky factorisation of linear graphs, in an order that GTSAM accepts.

GTSAM refuses to factorise a clique of the Bayes tree where a variable keeps less than 2^-24 of its
information once those before it are eliminated. The IMU ties each state to the next one to millimetres,
images place it to metres: the very last state, in one clique with its neighbour, always keeps less. Any other
state has a stiff neighbour left when it is eliminated.
"""

import gtsam
import numpy as np

# A variable that no graph of ours has.
_APART = gtsam.symbol("z", 0)
_POSE, _OTHERS = "x", ("v", "b")
_POSE_SIZE = 6


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
        # GTSAM merges a clique with its parent where both have the same variables: here the parent has one
        # more, on which nothing depends.
        unit = gtsam.noiseModel.Unit.Create(1)
        nothing = np.zeros((1, _POSE_SIZE))
        self._separating = gtsam.JacobianFactor(pose, nothing, _APART, np.eye(1), np.zeros(1), unit)
        self.ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(
            self.apart(linear), last, forceOrder=True
        )

    def apart(self, linear: gtsam.GaussianFactorGraph) -> gtsam.GaussianFactorGraph:
        """Add to a graph what keeps the newest state in a clique of its own, and changes no solution."""
        graph = gtsam.GaussianFactorGraph()
        graph.push_back(linear)
        graph.push_back(self._separating)
        return graph
