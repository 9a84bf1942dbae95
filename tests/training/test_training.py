"""Training of the judgement: derivatives, a problem it must solve, and the scenes it is trained on."""

import numpy as np
import pytest

from craternav_fg.training import network as training
from craternav_fg.training.examples import ERASED, MARKED, examples
from craternav_fg.training.scenes import SIDE_PX, scene
from craternav_fg.vision.judge import PATCH_SIDE, mirrored

INPUTS = PATCH_SIDE**2 + 4


def test_slopes_are_those_of_central_differences():
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((7, 5)).astype(np.float32)
    wanted = (rng.random(7) < 0.5).astype(np.float64)
    values = [rng.standard_normal(shape).astype(np.float64) for shape in ((5, 4), (4, 1), (4,), (1,))]
    _, slopes = training._slopes(values, 2, inputs.astype(np.float64), wanted)
    for value, slope in zip(values, slopes, strict=True):
        for at in np.ndindex(value.shape):
            losses = []
            for step in (1e-6, -1e-6):
                value[at] += step
                losses.append(training._slopes(values, 2, inputs.astype(np.float64), wanted)[0])
                value[at] -= step
            assert slope[at] == pytest.approx((losses[0] - losses[1]) / 2e-6, abs=1e-6)


def test_a_network_learns_what_one_sample_alone_does_not_tell():
    """Whether two inputs have one sign."""
    rng = np.random.default_rng(1)
    inputs = 0.01 * rng.standard_normal((4000, INPUTS)).astype(np.float32)
    inputs[:, -1], inputs[:, -2] = rng.choice([-1.0, 1.0], (2, 4000))
    wanted = (inputs[:, -1] * inputs[:, -2] > 0.0).astype(np.float64)
    options = training.TrainingOptions(hidden=(16, 8), epochs=20)
    made = training.train(inputs[:3000], wanted[:3000], rng, options)
    right = (made.log_odds(inputs[3000:]) > 0.0) == (wanted[3000:] > 0.5)
    assert right.mean() > 0.97
    np.testing.assert_array_equal(mirrored(mirrored(inputs)), inputs)


def test_scenes_are_determined_by_their_seed_and_show_their_craters():
    one, again = (scene(np.random.default_rng([3, 1])) for _ in range(2))
    np.testing.assert_array_equal(one.image, again.image)
    np.testing.assert_array_equal(one.freshness, again.freshness)
    assert one.image.shape == (SIDE_PX, SIDE_PX)
    assert np.ptp(one.image) > 100
    inside = np.all((one.circles_px[:, :2] > 30.0) & (one.circles_px[:, :2] < SIDE_PX - 30.0), axis=1)
    fresh = one.circles_px[inside & (one.freshness > 0.5) & (one.circles_px[:, 2] > 8.0)]
    # Along the direction towards the sun the near wall is dark, the far wall bright.
    towards = np.array([np.cos(one.sun_angle_rad), np.sin(one.sun_angle_rad)])
    walls = [
        one.image[tuple(np.rint(fresh[:, 1::-1] + side * 0.6 * fresh[:, 2:] * towards[::-1]).astype(int).T)]
        for side in (1.0, -1.0)
    ]
    assert np.mean(walls[0].astype(float) < walls[1]) > 0.9
    assert 0.0 <= ERASED < MARKED < one.freshness.max()
    found = examples(one)
    assert found is not None
    assert found.inputs.shape == (len(found.wanted), INPUTS)
    assert 0.05 < found.wanted.mean() < 0.8
