"""Weights at the predicted measurement rest on the prediction alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from tests.descents import problem, scenario


def test_weights_do_not_know_what_was_measured(tmp_path: Path) -> None:
    p, truth = problem(tmp_path, scenario(duration_s=4.0), 0)
    frame, gTb = p.frames[1], truth.gTb[1]
    rims = frame.rims
    # Fits of the same rims that came out larger: they state other covariances.
    chart = rims.chart + np.array([0.0, 0.0, 4e-3, 1e-3, 3e-3])
    larger = replace(frame, rims=replace(rims.expected_at(chart), chart=chart))
    scale = np.sqrt(np.einsum("nii->ni", rims.covariance))
    scale = scale[:, :, None] * scale[:, None, :]
    assert np.abs((larger.rims.covariance - rims.covariance) / scale).max() > 5e-3
    one, other = (with_predicted_covariances(each, gTb, p.camera, p.catalog) for each in (frame, larger))
    assert_allclose(other.rims.covariance / scale, one.rims.covariance / scale, atol=1e-9)
    # And at the truth they are about those of good fits.
    assert_allclose(one.rims.covariance / scale, rims.covariance / scale, atol=0.05)
    for found, given in ((one, frame), (other, larger)):
        assert_array_equal(found.rims.chart, given.rims.chart)
        assert found.stamp_ns == given.stamp_ns
        assert found.sun is given.sun
        assert found.arcs is given.arcs
