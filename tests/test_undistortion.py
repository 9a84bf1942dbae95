import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes, normalised_chart, pixel_chart, points_on
from craternav_fg.undistortion import seen_through_lens
from factors.arrays import FloatArray

PLAIN = Camera(1024, 768, 900.0, 890.0, 511.5, 383.5)
LENSES = {
    "radial": ((-0.1, 0.02, 0.001, -0.0005, 0.0), "radial-tangential"),
    "strong": ((-0.25, 0.06, 0.0, 0.0, 0.0), "radial-tangential"),
    "fisheye": ((0.02, -0.01, 0.0, 0.0), "fisheye"),
}


def bent(name: str) -> Camera:
    distortion, model = LENSES[name]
    return Camera(1024, 768, 900.0, 890.0, 511.5, 383.5, distortion=distortion, lens_model=model)


def measured(points_px: FloatArray, start_px: FloatArray) -> FloatArray:
    """Fit the ellipse that is nearest to points along its normals, as those who measure rims do."""

    def distances(chart: FloatArray) -> FloatArray:
        du, dv = (points_px - chart[:2]).T
        u = du / np.exp(chart[2])
        v = (dv - chart[3] * du) / np.exp(chart[4])
        ny = v / np.exp(chart[4])
        nx = u / np.exp(chart[2]) - chart[3] * ny
        r = np.hypot(u, v)
        return np.asarray((r - 1.0) * r / np.hypot(nx, ny))

    scale = np.array([1.0, 1.0, 0.01, 0.01, 0.01])
    return np.asarray(least_squares(distances, start_px, x_scale=scale, xtol=1e-14, ftol=1e-14).x)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("axes", [(12.0, 9.0), (60.0, 35.0), (95.0, 90.0)])
def test_an_ellipse_seen_through_a_lens_is_found_again(lens: str, axes: tuple[float, float]) -> None:
    camera = bent(lens)
    truth_px = chart_of_axes([[760.0, 520.0, *axes, 0.5]])
    truth = normalised_chart(truth_px, PLAIN)[0]
    outline_px = camera.pixels(points_on(truth, 120)[0])
    seen_px = measured(outline_px, np.array([*outline_px.mean(axis=0), *truth_px[0, 2:]]))
    assert np.abs(seen_px[:2] - truth_px[0, :2]).max() > 2.0
    found_px = pixel_chart(seen_through_lens(seen_px[None], camera), PLAIN)[0]
    assert_allclose(found_px[:2], truth_px[0, :2], atol=0.01)
    assert_allclose(found_px[2:], truth_px[0, 2:], atol=5e-4)


def test_without_distortion_it_is_another_form_of_the_same_ellipse() -> None:
    chart_px = chart_of_axes([[760.0, 520.0, 60.0, 4.0, 0.5]])
    assert_allclose(seen_through_lens(chart_px, PLAIN), normalised_chart(chart_px, PLAIN)[0], atol=1e-12)


def test_there_may_be_none() -> None:
    assert seen_through_lens(np.empty((0, 5)), bent("radial")).shape == (0, 5)
