"""What the ground of a region does to all its rims changes as the camera comes to another one."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.correlated_errors import (
    REGIONAL,
    SHARED_LETTER,
    RimErrorOptions,
    RimErrorStates,
    next_region,
)
from craternav_fg.measurements import SHARED_SIZE, RimSet


def rims(*craters: int) -> RimSet:
    """Rims with nothing but errors that all share."""
    n = len(craters)
    shared = np.zeros((n, 5, SHARED_SIZE))
    shared[:, 0, 2] = 1e-3
    return RimSet(np.array(craters), np.zeros((n, 5)), np.tile(np.eye(5), (n, 1, 1)), shared=shared)


def test_a_view_that_narrows_stays_in_its_region() -> None:
    options = RimErrorOptions(region_overlap=0.5)
    region = next_region(frozenset(), np.array([1, 2, 3, 4]), options)
    assert region == {1, 2, 3, 4}
    assert next_region(region, np.array([4]), options) is region
    assert next_region(region, np.array([3, 4, 5, 6]), options) is region
    assert next_region(region, np.array([4, 5, 6]), options) == {4, 5, 6}


@pytest.mark.parametrize("renewed", [False, True])
def test_errors_of_regions_are_correlated_and_others_the_same(renewed: bool) -> None:
    """The prior of both variables: of unit variance each."""
    options = RimErrorOptions(region_correlation=0.6)
    states = RimErrorStates(options, renewed=renewed)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    keys = [
        error.keys[0]
        for seen in ((1, 2), (1, 2), (3, 4), (5, 6))
        for error in states.enter(rims(*seen), graph, values)
    ]
    assert keys == [gtsam.symbol(SHARED_LETTER, k) for k in (0, 0, 1, 2)]
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(sorted(set(keys)))
    regional = np.isin(np.arange(SHARED_SIZE), REGIONAL)
    for k in range(3):
        for j in range(3):
            expected = np.where(regional, 0.6 ** abs(k - j), 1.0)
            found = joint.at(keys[k + 1], keys[j + 1])
            assert_allclose(found, np.diag(expected), atol=1e-5)


def test_a_frame_that_is_taken_back_began_no_region() -> None:
    states = RimErrorStates(RimErrorOptions())
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    states.enter(rims(1, 2), graph, values)
    states.mark()
    states.enter(rims(3, 4), gtsam.NonlinearFactorGraph(), gtsam.Values(values))
    states.take_back()
    (error,) = states.enter(rims(1, 2), graph, values)
    assert error.keys[0] == gtsam.symbol(SHARED_LETTER, 0)
    (error,) = states.enter(rims(3, 4), graph, values)
    assert error.keys[0] == gtsam.symbol(SHARED_LETTER, 1)


@pytest.mark.parametrize(
    ("name", "value"),
    [("region_overlap", 1.5), ("region_overlap", np.nan), ("region_correlation", 1.0)],
)
def test_options_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(EstimationError, match=f"{name}: expected 0 to .*, found {value}"):
        RimErrorOptions(**{name: value})
