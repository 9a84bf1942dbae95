"""Ellipses in their several forms: round trips, and what others make of the same ellipse."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from craternav_fg import ellipse
from craternav_fg.camera import Camera

CAMERA = Camera(1024, 768, 1200.0, 900.0, 511.5, 380.0)


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def matrix(a: float, b: float, angle: float) -> np.ndarray:
    """S by its eigenvalues."""
    R = rotation(angle)
    return np.asarray(R @ np.diag([a**2, b**2]) @ R.T)


@st.composite
def axes(draw: st.DrawFn, thinnest: float = 1e-6) -> np.ndarray:
    major = draw(st.floats(1e-3, 1e3))
    minor = major * draw(st.floats(thinnest, 1.0))
    place = [draw(st.floats(-1e3, 1e3)) for _ in range(2)]
    return np.array([*place, major, minor, draw(st.floats(-1.57, 1.57))])


@settings(deadline=None)
@given(axes())
def test_axes_and_charts_are_turned_into_each_other(given_axes: np.ndarray) -> None:
    found = ellipse.axes_of_chart(ellipse.chart_of_axes(given_axes))
    # What rounds S_xx by a part of 1e-16 turns the long axis, and a thin ellipse's short one by more.
    thin = (given_axes[2] / given_axes[3]) ** 2
    assert_allclose(found[:2], given_axes[:2])
    assert_allclose(found[2:4], given_axes[2:4], rtol=1e-14 * thin + 1e-12)
    if given_axes[3] < 0.999 * given_axes[2]:
        off = 2.0 * (found[4] - given_axes[4])
        assert_allclose([np.cos(off), np.sin(off)], [1.0, 0.0], atol=1e-11)


@settings(deadline=None)
@given(axes(thinnest=1e-3))
def test_charts_are_those_of_the_matrix(given_axes: np.ndarray) -> None:
    chart = ellipse.chart_of_axes(given_axes)
    S = matrix(*given_axes[2:])
    assert_allclose(ellipse.matrix_of_chart(chart), S, atol=1e-12 * given_axes[2] ** 2)
    values = np.linalg.eigvalsh(S)
    assert_allclose(ellipse.semi_minor(chart), np.sqrt(values[0]), rtol=1e-8)
    assert_allclose(ellipse.mean_radius(chart) ** 4, values[0] * values[1], rtol=1e-8)
    assert ellipse.semi_minor_bound(chart) >= ellipse.semi_minor(chart) * (1.0 - 1e-12)


def test_a_very_thin_ellipse_keeps_its_digits() -> None:
    for angle in (0.0, 0.3, 1.2, np.pi / 2.0, -0.7):
        chart = ellipse.chart_of_axes([3.0, -4.0, 100.0, 1e-7, angle])
        assert_allclose(ellipse.axes_of_chart(chart)[2:4], [100.0, 1e-7], rtol=1e-7)
        assert_allclose(ellipse.semi_minor(chart), 1e-7, rtol=1e-7)


def test_axes_may_come_in_any_order() -> None:
    one, other = ellipse.chart_of_axes([[1.0, 2.0, 30.0, 20.0, 0.4], [1.0, 2.0, 20.0, 30.0, 0.4 + np.pi / 2]])
    assert_allclose(one, other, atol=1e-14)
    assert_allclose(ellipse.axes_of_chart(other), [1.0, 2.0, 30.0, 20.0, 0.4])


def test_any_conjugate_diameters_make_the_same_ellipse() -> None:
    centre = np.array([1.0, 2.0])
    p, q = rotation(0.4) @ np.diag([30.0, 20.0])
    for turn in (0.0, 0.7, 2.0):
        mixed = np.array([p, q]).T @ rotation(turn)
        chart = ellipse.chart_of_diameters(centre, mixed[:, 0], mixed[:, 1])
        assert_allclose(chart, ellipse.chart_of_diameters(centre, p, q), atol=1e-14)


@pytest.mark.parametrize("given_axes", [[50.0, 60.0, 30.0, 12.0, 0.5], [300.0, 90.0, 80.0, 79.0, -1.0]])
def test_opencv_draws_and_fits_the_same_ellipse(given_axes: list[float]) -> None:
    chart = ellipse.chart_of_axes(given_axes)
    x, y, a, b, angle = given_axes
    drawn = cv2.ellipse2Poly((round(x), round(y)), (round(a), round(b)), round(np.degrees(angle)), 0, 360, 5)
    # Whole pixels and degrees.
    assert_allclose(np.linalg.norm(ellipse.whitened_points(drawn, chart), axis=1), 1.0, atol=1.0 / b)
    points = ellipse.points_on(chart, 60)
    centre, diameters, degrees = cv2.fitEllipseDirect(points.astype(np.float32))
    fitted = ellipse.chart_of_axes([*centre, 0.5 * diameters[0], 0.5 * diameters[1], np.radians(degrees)])
    assert_allclose(fitted, chart, atol=2e-3)


def test_points_lie_on_the_ellipse_and_normals_across_it() -> None:
    chart = ellipse.chart_of_axes([3.0, -4.0, 10.0, 2.0, 0.6])
    t = np.linspace(0.0, 2.0 * np.pi, 41)
    points, normals = ellipse.points_and_normals(chart, t)
    S_inv = np.linalg.inv(matrix(10.0, 2.0, 0.6))
    off = points - [3.0, -4.0]
    assert_allclose(np.einsum("ni,ij,nj->n", off, S_inv, off), 1.0)
    ahead, behind = (ellipse.points_and_normals(chart, t + step)[0] for step in (1e-6, -1e-6))
    assert_allclose(np.sum((ahead - behind) * normals, axis=1), 0.0, atol=1e-12)
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.all(np.sum(off * normals, axis=1) > 0.0)
    assert_allclose(ellipse.points_on(chart, 40), points[:-1], atol=1e-13)


def test_points_become_the_unit_circle() -> None:
    chart = ellipse.chart_of_axes([3.0, -4.0, 10.0, 2.0, 0.6])
    t = np.linspace(0.1, 6.0, 7)
    points, _ = ellipse.points_and_normals(chart, t)
    expected = np.stack([np.cos(t), np.sin(t)], axis=-1)
    assert_allclose(ellipse.whitened_points(points, chart), expected, atol=1e-14)


def test_boxes_touch_the_ellipse() -> None:
    charts = ellipse.chart_of_axes([[5.0, 6.0, 30.0, 12.0, turn] for turn in np.linspace(-1.5, 1.5, 7)])
    points = ellipse.points_on(charts, 20_000)
    assert_allclose(ellipse.half_sides(charts), 0.5 * np.ptp(points, axis=1), rtol=1e-7)


def test_kernels_compute_what_arrays_do() -> None:
    chart = ellipse.chart_of_axes([3.0, -4.0, 10.0, 2.0, 0.6])
    S = ellipse.matrix_of_chart(chart)
    sxx, sxy, syy = ellipse.moments_kernel(*chart[2:])
    assert_allclose([sxx, sxy, syy], [S[0, 0], S[0, 1], S[1, 1]])
    assert_allclose(ellipse.semi_axes_kernel(sxx, sxy, syy, 20.0), [10.0, 2.0])
    assert_allclose(ellipse.half_sides_kernel(*chart[2:]), ellipse.half_sides(chart))
    x, y, gx, gy = ellipse.point_kernel(0.7, *chart)
    points, normals = ellipse.points_and_normals(chart, np.array([0.7]))
    assert_allclose([x, y], points[0])
    assert_allclose([gx, gy] / np.hypot(gx, gy), normals[0])
    assert_allclose(ellipse.whiten_kernel(x, y, *chart), [np.cos(0.7), np.sin(0.7)])


@settings(deadline=None)
@given(axes(thinnest=0.05))
def test_pixels_and_normalised_coordinates(given_axes: np.ndarray) -> None:
    """The chart in normalised coordinates is that of the normalised points."""
    chart_px = ellipse.chart_of_axes(given_axes)
    chart, scale = ellipse.normalised_chart(chart_px, CAMERA)
    points = CAMERA.normalised(ellipse.points_on(chart_px, 12))
    assert_allclose(ellipse.points_on(chart, 12), points, atol=1e-12)
    assert_allclose(ellipse.pixel_chart(chart, CAMERA), chart_px, atol=1e-9)
    step = 1e-3 * np.eye(5)
    moved = ellipse.normalised_chart(chart_px + step, CAMERA)[0] - chart
    assert_allclose(moved, 1e-3 * np.diag(scale), atol=1e-12)


def test_conics_vanish_on_the_ellipse() -> None:
    charts = ellipse.chart_of_axes([[0.1, 0.2, 0.05, 0.03, 0.4], [-0.3, 0.0, 0.01, 0.01, 0.0]])
    u, v = np.moveaxis(ellipse.points_on(charts, 9), -1, 0)
    conics, jacobians = ellipse.conics_of_charts(charts)
    A, B, C, D, E, F = conics.T[:, :, None]
    assert_allclose(A * u**2 + B * u * v + C * v**2 + D * u + E * v + F, 0.0, atol=1e-14)
    step = 1e-6
    for k, e in enumerate(step * np.eye(5)):
        change = ellipse.conics_of_charts(charts + e)[0] - ellipse.conics_of_charts(charts - e)[0]
        assert_allclose(jacobians[:, :, k], change / (2.0 * step), atol=1e-7)
    assert [a.shape for a in ellipse.conics_of_charts(charts[:0])] == [(0, 6), (0, 6, 5)]


def test_change_of_shape() -> None:
    round_one = ellipse.chart_of_axes([0.1, -0.2, 0.05, 0.05, 0.0])
    larger = round_one + np.array([0.3, 0.0, 0.1, 0.0, 0.1])
    assert ellipse.shape_change(round_one, larger) == pytest.approx(0.1)
    assert ellipse.shape_change(larger, round_one) == pytest.approx(0.1)
    # Squeezed by 20 % along an axis at 40 deg.
    slant = ellipse.chart_of_axes([0.0, 0.0, 0.05, 0.04, np.radians(130.0)])
    assert ellipse.shape_change(round_one, slant) == pytest.approx(np.log(1.25))


def test_covariance_is_that_of_fits_to_noisy_points() -> None:
    """Linear fits of the points' distances, by differences of the distances themselves."""
    camera = Camera(1024, 1024, 700.0, 1500.0, 511.5, 511.5)
    chart = np.array([0.05, -0.1, np.log(0.06), 0.4, np.log(0.03)])
    count, sigma_px = 40, 0.5
    t = 2.0 * np.pi * np.arange(count) / count
    points, normals = ellipse.points_and_normals(ellipse.pixel_chart(chart, camera), t)

    def nearest_px(y: np.ndarray) -> np.ndarray:
        """Signed distance of each point from a dense outline, along its normal."""
        outline = ellipse.points_on(ellipse.pixel_chart(y, camera), 50_000)
        at = [np.argmin(np.sum((outline - point) ** 2, axis=1)) for point in points]
        return np.sum((points - outline[at]) * normals, axis=1)

    step = 1e-5
    J = np.stack(
        [(nearest_px(chart + e) - nearest_px(chart - e)) / (2.0 * step) for e in step * np.eye(5)], 1
    )
    expected = sigma_px**2 * np.linalg.inv(J.T @ J)
    found = ellipse.chart_covariance(chart, camera, sigma_px, count)
    sigmas = np.sqrt(np.diag(expected))
    assert_allclose(found / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-3)
    both = ellipse.chart_covariance(np.stack([chart, chart + 0.1]), camera, sigma_px, count)
    assert_allclose(both[0], found, rtol=1e-12)


def test_covariance_of_errors_of_the_axes() -> None:
    """By differences in centre, semi-axes and rotation, none of which is singular for an ellipse."""
    given_axes, sigma = np.array([3.0, -4.0, 10.0, 4.0, 0.6]), 0.1
    step = 1e-6
    J = [
        (ellipse.chart_of_axes(given_axes + e) - ellipse.chart_of_axes(given_axes - e)) / (2.0 * step)
        for e in step * np.eye(5)
    ]
    # The element off the diagonal turns the ellipse by itself over a - b.
    sigmas = sigma * np.array([1.0, 1.0, 1.0, 1.0, np.sqrt(0.5) / 6.0])
    root = np.array(J).T * sigmas
    assert_allclose(
        ellipse.axes_covariance(ellipse.chart_of_axes(given_axes), sigma), root @ root.T, atol=1e-10
    )


def test_covariance_of_errors_in_proportion_to_the_size() -> None:
    charts = ellipse.chart_of_axes([[3.0, -4.0, 10.0, 4.0, 0.6], [30.0, -40.0, 100.0, 40.0, 0.6]])
    small, large = np.sqrt(np.diagonal(ellipse.relative_covariance(charts, 0.01), axis1=1, axis2=2))
    assert_allclose(large, small * [10.0, 10.0, 1.0, 1.0, 1.0])
    assert_allclose(small[:2], 0.01 * ellipse.half_sides(charts[0]))
    assert_allclose(small[[2, 4]], 0.01)
    # A change of the shear by that of 1 % of the half height at the end of the half width.
    assert_allclose(small[3] * np.exp(charts[0, 2]), 0.01 * np.exp(charts[0, 4]))
