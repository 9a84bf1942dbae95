"""Ellipses: the chart that everything is estimated in, and the other ways to write one.

The chart of an ellipse (u - m)' S^-1 (u - m) = 1 is

    y = [m_x, m_y, ln(S_xx)/2, S_xy/S_xx, ln(S_yy - S_xy^2/S_xx)/2],

a global parametrisation without singularities. With S = L L', L = [[e^y3, 0], [y4 e^y3, e^y5]], a point of
the ellipse is m + L [cos t, sin t]. Axes are [x, y, a, b, angle]: centre, semi-axes a >= b, and the direction
of a from x towards y, rad. Charts are in normalised image coordinates unless a name ends in `_px`.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera

FloatArray = npt.NDArray[np.float64]


def normalised_chart(chart_px: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Turn charts in pixels into charts in normalised image coordinates.

    Parameters
    ----------
    chart_px : ndarray, shape (..., 5)
        In the pixels of `camera.pinhole`.
    camera : Camera

    Returns
    -------
    chart : ndarray, shape (..., 5)
    scale : ndarray, shape (5,)
        Diagonal of the derivative of `chart` in `chart_px`.
    """
    scale = np.array([1.0 / camera.fx_px, 1.0 / camera.fy_px, 1.0, camera.fx_px / camera.fy_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return (chart_px - offset) * scale, scale


def pixel_chart(chart: FloatArray, camera: Camera) -> FloatArray:
    """Turn charts (..., 5) in normalised image coordinates into charts in the pixels of `camera.pinhole`."""
    scale = np.array([camera.fx_px, camera.fy_px, 1.0, camera.fy_px / camera.fx_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return np.asarray(chart * scale + offset)


def chart_of_axes(axes: npt.ArrayLike) -> FloatArray:
    """Charts (..., 5) of ellipses given by centre, semi-axes and direction (..., 5), in any order of a, b."""
    x, y, a, b, angle = np.moveaxis(np.asarray(axes, dtype=np.float64), -1, 0)
    c, d = np.cos(angle), np.sin(angle)
    sxx = (a * c) ** 2 + (b * d) ** 2
    sxy = (a**2 - b**2) * c * d
    # The determinant of S is (a b)^2: no digits are lost on a thin ellipse.
    return np.stack([x, y, 0.5 * np.log(sxx), sxy / sxx, np.log(a * b) - 0.5 * np.log(sxx)], axis=-1)


def axes_of_chart(charts: FloatArray) -> FloatArray:
    """Centre, semi-axes a >= b and direction of a (..., 5) of ellipses given by their charts (..., 5)."""
    charts = np.asarray(charts)
    sxx, sxy, syy = _matrix_elements(charts)
    mean, half = 0.5 * (sxx + syy), 0.5 * (sxx - syy)
    root = np.hypot(half, sxy)
    angle = 0.5 * np.arctan2(sxy, half)
    major = np.sqrt(mean + root)
    # The product of the semi-axes over the larger one: no digits are lost on a thin ellipse.
    minor = np.exp(charts[..., 2] + charts[..., 4]) / major
    return np.stack([charts[..., 0], charts[..., 1], major, minor, angle], axis=-1)


def semi_minor(charts: FloatArray) -> FloatArray:
    """Semi-minor axes (...) of ellipses given by their charts (..., 5), in the charts' unit."""
    return np.asarray(axes_of_chart(charts)[..., 3])


def matrix_of_chart(charts: FloatArray) -> FloatArray:
    """Matrices S (..., 2, 2) of ellipses given by their charts (..., 5), in the charts' unit squared."""
    sxx, sxy, syy = _matrix_elements(np.asarray(charts))
    return np.stack([sxx, sxy, sxy, syy], axis=-1).reshape(*sxx.shape, 2, 2)


def points_on(charts: FloatArray, count: int = 48) -> FloatArray:
    """Points (..., count, 2) around ellipses given by their charts (..., 5), in the charts' coordinates."""
    charts = np.asarray(charts)[..., None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    x = np.exp(charts[..., 2]) * np.cos(angle)
    y = charts[..., 3] * x + np.exp(charts[..., 4]) * np.sin(angle)
    return np.stack([charts[..., 0] + x, charts[..., 1] + y], axis=-1)


def half_extents(axes: FloatArray) -> FloatArray:
    """Half widths and heights (..., 2) of the upright boxes around ellipses given by their axes (..., 5)."""
    _, _, a, b, angle = np.moveaxis(np.asarray(axes), -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.hypot(a * c, b * s), np.hypot(a * s, b * c)], axis=-1)


def shape_change(before: FloatArray, after: FloatArray) -> FloatArray:
    """Measure by how much the shapes of ellipses differ: the largest logarithm of a stretch, over directions.

    An ellipse that is larger by 10 % has changed by 0.1, whatever its shape; one foreshortened by a factor c
    has changed by |ln c|. Neither its place nor a common rotation matters.

    Parameters
    ----------
    before, after : ndarray, shape (..., 5)
        Charts, in the same coordinates.

    Returns
    -------
    ndarray, shape (...)
        Non-negative; zero for equal shapes.
    """
    # S = L L', L lower triangular: singular values of inv(L1) L2.
    a = np.exp(after[..., 2] - before[..., 2])
    d = np.exp(after[..., 4] - before[..., 4])
    b = (after[..., 3] - before[..., 3]) * np.exp(after[..., 2] - before[..., 4])
    half = 0.5 * np.log(a * d)
    # Half the sum of squares over the product is cosh of the difference of the logarithms.
    spread = 0.5 * np.arccosh(np.maximum(0.5 * (a * a + b * b + d * d) / (a * d), 1.0))
    return np.asarray(np.abs(half) + spread)


def _matrix_elements(charts: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    sxx = np.exp(2.0 * charts[..., 2])
    sxy = charts[..., 3] * sxx
    return sxx, sxy, np.exp(2.0 * charts[..., 4]) + charts[..., 3] * sxy


def centre_and_matrix_px(charts: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Centres m (..., 2) and matrices S (..., 2, 2) of charts (..., 5), in the pixels of `camera.pinhole`."""
    charts_px = pixel_chart(np.asarray(charts), camera)
    return charts_px[..., :2], matrix_of_chart(charts_px)
