"""Fit of what a quarter's odds tell of a proposal."""

import numpy as np

from craternav_fg.training.sparse import samples, weights
from craternav_fg.training.terrain import SIDE_PX, sparse_terrain


def test_weights_are_found_again():
    rng = np.random.default_rng(3)
    log_odds, doubt = rng.normal(1.0, 3.0, 20000), rng.uniform(0.0, 1.0, 20000)
    right = rng.random(20000) < 1.0 / (1.0 + np.exp(-log_odds - doubt * (0.5 * log_odds - 2.0)))
    np.testing.assert_allclose(weights(log_odds, doubt, right), [0.5, -2.0], atol=0.25)


def test_sparse_ground_has_few_craters_or_none():
    grounds = [sparse_terrain(np.random.default_rng([5, k])) for k in range(6)]
    counts = [len(ground.circles_px) for ground in grounds]
    assert min(counts) == 0
    assert 0 < max(counts) < 32
    for ground in grounds:
        assert ground.heights.shape == (SIDE_PX, SIDE_PX)
        assert len(ground.depth_radii) == len(ground.buried) == len(ground.circles_px)


def test_both_quarters_give_proposals():
    """Ground without craters, whose light nothing shows."""
    log_odds, doubt, right = samples(np.random.default_rng([78, 12]))
    assert len(log_odds) == len(doubt) == len(right) > 20
    assert not right.any()
    assert set(doubt) == {1.0}
    # The likeliest first, of each quarter.
    assert np.sum(np.diff(log_odds) > 2.0) >= 1
