"""Memory over many factors, and one graph of a size at which crashes were reported upstream."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, X

from factors.conic_shape import conic_shape_factor
from factors.custom import pose_factor
from tests.factors.conftest import make_view
from tests.resident_memory import in_fresh_process, needs_statm, resident_kb


def quiet(gTb: np.ndarray, bTc: np.ndarray, linearise: bool, e: np.ndarray, J: np.ndarray) -> None:
    e[:] = 0.0


def sizes_over_factors(mounting: bool) -> list[int]:
    """Resident memory (kB) after each 5,000 of 30,000 factors, each linearised once."""
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3())
    values.insert(C(0), gtsam.Pose3())
    sizes_kb = []
    for _ in range(6):
        for _ in range(5_000):
            if mounting:
                factor = pose_factor(X(0), 30, quiet, None, C(0))
            else:
                factor = pose_factor(X(0), 30, quiet, np.eye(4))
            factor.linearize(values)
        del factor
        sizes_kb.append(resident_kb())
    return sizes_kb


@needs_statm
@pytest.mark.parametrize("mounting", [False, True])
def test_memory_is_flat_over_50_000_factors(mounting: bool) -> None:
    """25,000 of each kind after the first 5,000; kept, they would hold more than 50 MB."""
    sizes_kb = in_fresh_process(sizes_over_factors, mounting)
    assert sizes_kb[-1] - sizes_kb[0] < 5_000


@pytest.mark.slow
def test_60_000_factors_in_one_isam2() -> None:
    """Twenty rim factors on each of 3000 poses, in six updates."""
    view = make_view(0, n=1)
    c = view.catalog
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    isam = gtsam.ISAM2(params)
    pose = gtsam.Pose3(view.gTb)
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1e-3, 50.0], 3))
    hold = None
    number = 0
    for _ in range(6):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for _ in range(500):
            values.insert(X(number), pose.retract(np.array([1e-4, 0.0, 0.0, 10.0, 0.0, 0.0])))
            graph.push_back(gtsam.PriorFactorPose3(X(number), pose, sigmas))
            if number:
                graph.push_back(gtsam.BetweenFactorPose3(X(number - 1), X(number), gtsam.Pose3(), sigmas))
            for _ in range(20):
                graph.push_back(
                    conic_shape_factor(X(number), view.bTc, c.centres, c.axes, view.charts, view.covariances)
                )
            number += 1
        isam.update(graph, values)
        # Held, so that callbacks get this object instead of a copy.
        hold = hold or isam.getLinearizationPoint()
    isam.update()
    assert isam.getFactorsUnsafe().size() > 60_000
    estimate = isam.calculateEstimate()
    worst = max(
        np.abs(pose.localCoordinates(estimate.atPose3(X(k))) / [1, 1, 1, 5e4, 5e4, 5e4]).max()
        for k in range(0, number, 100)
    )
    assert worst < 1e-6
