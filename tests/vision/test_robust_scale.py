import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from craternav_fg.vision.robust_scale import MAD_TO_SIGMA, median, robust_sigma

ANY = st.floats(-1e6, 1e6, width=32) | st.just(float("nan"))


@given(arrays(np.float32, st.tuples(st.integers(0, 4), st.integers(1, 9)), elements=ANY))
def test_medians_are_those_of_numpy(values):
    found = median(values)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.array([np.median(row) for row in values], np.float32))


def test_the_robust_standard_deviation_is_that_of_normal_values_but_for_outliers():
    values = 3.0 * np.random.default_rng(1).standard_normal(20_000)
    values[:200] = 1e6
    assert robust_sigma(values) == pytest.approx(3.0, rel=0.03)
    assert robust_sigma(values.reshape(100, -1)) == robust_sigma(values)


@pytest.mark.parametrize("count", [1, 2, 9, 4095, 4096, 4097, 5000])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_robust_standard_deviation_is_the_median_absolute_deviation(count, kind):
    values = np.random.default_rng(count).normal(size=count).astype(kind)
    assert robust_sigma(values) == MAD_TO_SIGMA * float(np.median(np.abs(values).astype(np.float64)))
    values[count // 2] = np.nan
    assert np.isnan(robust_sigma(values))
