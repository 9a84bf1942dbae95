"""A frame that a session cannot take leaves no variable of its rims' errors behind."""

import gtsam
import numpy as np

from craternav_fg.estimators.correlated_errors import RimErrorOptions, RimErrorStates
from craternav_fg.measurements import CORRELATED_SIZE, MAP_SIZE, SHARED_SIZE, RimSet


def test_a_frame_that_is_taken_back_has_left_nothing() -> None:
    def rims(sizes: dict[int, float]) -> RimSet:
        charts = np.array([[0.0, 0.0, size, 0.0, size] for size in sizes.values()])
        roots = np.tile(np.eye(5, CORRELATED_SIZE), (len(sizes), 1, 1))
        shared = np.zeros((len(sizes), 5, SHARED_SIZE))
        covariances = np.tile(2.0 * np.eye(5), (len(sizes), 1, 1))
        of_map = np.tile(0.1 * np.eye(5, MAP_SIZE), (len(sizes), 1, 1))
        craters = np.array(list(sizes))
        return RimSet(craters, charts, covariances, correlated=roots, of_map=of_map, shared=shared)

    def entered(*, failing: bool) -> tuple[list[tuple[list[int], list[float]]], list[int], int]:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        states = RimErrorStates(RimErrorOptions(), renewed=True)
        states.enter(rims({7: 0.0, 8: 0.0}), graph, values)
        if failing:
            states.mark()
            # A crater goes on, one changes beyond a step, another is new.
            states.enter(rims({7: 0.05, 8: 0.5, 9: 0.0}), gtsam.NonlinearFactorGraph(), gtsam.Values())
            states.take_back()
        terms = states.enter(rims({7: 0.05, 8: 0.5, 9: 0.0}), graph, values)
        terms += states.enter(rims({8: 0.6, 9: 0.3}), graph, values)
        told = [(list(term.keys), np.asarray(term.roots).ravel().tolist()) for term in terms]
        return told, list(values.keys()), graph.size()

    assert entered(failing=True) == entered(failing=False)
