"""What is expected of the brightness around a rim: reference, its gradient, and how slopes change it."""

from typing import NamedTuple

import numpy as np

from craternav_fg.vision.rim_geometry import in_circle
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Least second-order change of brightness with slope: less has no effect on a crossing.
_LEAST_CURVATURE = 1e-3
# Least cosine of emission of ground that is seen.
_LEAST_COSINE = 0.01
# Least reference brightness at a rim point over that at the rim's centre.
_DARKEST = 0.4


class RimShading(NamedTuple):
    """What the photometric law and the image as a whole let expect of the brightness around a rim.

    Attributes
    ----------
    reference : float
        Reference brightness at the centre: that of locally flat terrain, 0 to 255.
    gradient : ndarray, shape (2,)
        Its change along the image as a share of it, 1/px.
    contrast_px : ndarray, shape (2,)
        Slope contrast c in the image, per pixel of crater radius.
    curvature_px : ndarray, shape (2, 2)
        Second-order change K of brightness in the image, per square pixel of crater radius: ground that rises
        outward with slope s at a rim point with image normal n and support distance h is brighter by the
        share -(c . n / h) s + (n . K n / h^2) s^2.
    to_sun_px, to_camera_px : ndarray, shape (2,)
        Components along the ground of the unit vectors towards the sun and the camera, in the image, per
        pixel of crater radius.
    cosines : ndarray, shape (2,)
        Cosines of incidence and emission on flat terrain.
    lommel_share : float
        Share L of the Lommel-Seeliger term, see `photometry`.
    """

    reference: float
    gradient: FloatArray
    contrast_px: FloatArray
    curvature_px: FloatArray
    to_sun_px: FloatArray
    to_camera_px: FloatArray
    cosines: FloatArray
    lommel_share: float


class RimLight(NamedTuple):
    """How a rim is lit and seen, in the coordinates in which it is the unit circle.

    Attributes
    ----------
    contrast, to_sun, to_camera : ndarray, shape (2,)
        Slope contrast, and components along the ground of the unit vectors towards the sun and the camera.
    cosines : ndarray, shape (2,)
        Cosines of incidence and emission on flat terrain.
    lommel_share : float
        Share L of the Lommel-Seeliger term, see `photometry`.
    """

    contrast: FloatArray
    to_sun: FloatArray
    to_camera: FloatArray
    cosines: FloatArray
    lommel_share: float


class NormalView(NamedTuple):
    """How the ground along a normal of a rim is lit and seen.

    Attributes
    ----------
    cosine, sine : float
        Of the affine angle.
    contrast : float
        Slope contrast across the rim.
    along : float
        Its change along the rim, per radian.
    curvature : float
        Second-order change of brightness with slope across the rim; not zero.
    lift, lift_along : float
        Displacement in the image, outward and along the rim, of ground that is higher by a radius, in radii.
    lean : float
        How far the normal goes along the rim, per outward distance.
    """

    cosine: float
    sine: float
    contrast: float
    along: float
    curvature: float
    lift: float
    lift_along: float
    lean: float


@njit(cache=True, error_model="numpy")
def contrast_across(contrast_px: FloatArray, q: FloatArray) -> float:
    """Compute the slope contrast across the rim at a rim point.

    Parameters
    ----------
    contrast_px : ndarray, shape (2,)
        See `RimShading`.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    return -(contrast_px[0] * q[2] + contrast_px[1] * q[3]) / q[4]


@njit(cache=True, error_model="numpy")
def rim_light(chart_px: FloatArray, shading: RimShading) -> RimLight:
    """Take what is known of the light to the coordinates in which the rim is the unit circle.

    Parameters
    ----------
    chart_px : ndarray, shape (5,)
        The rim, px.
    shading : RimShading
    """
    return RimLight(
        in_circle(chart_px, shading.contrast_px[0], shading.contrast_px[1]),
        in_circle(chart_px, shading.to_sun_px[0], shading.to_sun_px[1]),
        in_circle(chart_px, shading.to_camera_px[0], shading.to_camera_px[1]),
        shading.cosines,
        shading.lommel_share,
    )


@njit(cache=True, error_model="numpy")
def normal_view(
    chart_px: FloatArray, light: RimLight, curvature_px: FloatArray, angle: float, q: FloatArray
) -> NormalView:
    """Compute how the ground along a normal is lit and seen.

    Parameters
    ----------
    chart_px : ndarray, shape (5,)
        The rim, px.
    light : RimLight
    curvature_px : ndarray, shape (2, 2)
        See `RimShading`.
    angle : float
        Affine angle of the rim point.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    c, s = np.cos(angle), np.sin(angle)
    normal = in_circle(chart_px, q[2], q[3])
    # Ground appears where its line of sight meets the rim's plane.
    x, y = -light.to_camera[0] / light.cosines[1], -light.to_camera[1] / light.cosines[1]
    return NormalView(
        c,
        s,
        -(c * light.contrast[0] + s * light.contrast[1]),
        s * light.contrast[0] - c * light.contrast[1],
        curvature_across(curvature_px, q),
        c * x + s * y,
        c * y - s * x,
        q[4] * (c * normal[1] - s * normal[0]),
    )


@njit(cache=True, error_model="numpy")
def relative_brightness(light: RimLight, view: NormalView, turn: float, slope: float) -> float:
    """Compute the brightness of sloping ground relative to that of flat terrain.

    Parameters
    ----------
    light : RimLight
    view : NormalView
    turn : float
        Angle along the rim from the normal's foot to the ground, rad; small.
    slope : float
        Rise over run outward.
    """
    x, y = turned(view, turn)
    sloping, flat = sloping_terms(light, x, y, slope), sloping_terms(light, x, y, 0.0)
    share = light.lommel_share
    return (share * sloping[0] + (1.0 - share) * sloping[1]) / (share * flat[0] + (1.0 - share) * flat[1])


@njit(cache=True, error_model="numpy")
def turned(view: NormalView, turn: float) -> tuple[float, float]:
    """Compute the direction outward from a rim's centre at ground beside a normal's foot.

    Parameters
    ----------
    view : NormalView
    turn : float
        Angle along the rim from the normal's foot to the ground, rad; small.
    """
    return view.cosine - turn * view.sine, view.sine + turn * view.cosine


@njit(cache=True, error_model="numpy")
def sloping_terms(light: RimLight, x: float, y: float, slope: float) -> tuple[float, float]:
    """Compute the Lommel-Seeliger and Lambert terms of sloping ground, see `photometry`.

    Parameters
    ----------
    light : RimLight
    x, y : float
        Direction outward.
    slope : float
        Rise over run outward.
    """
    length = np.sqrt(1.0 + slope * slope)
    mu0 = (light.cosines[0] - slope * (x * light.to_sun[0] + y * light.to_sun[1])) / length
    mu = (light.cosines[1] - slope * (x * light.to_camera[0] + y * light.to_camera[1])) / length
    mu0, mu = max(mu0, 0.0), max(mu, _LEAST_COSINE)
    return 2.0 * mu0 / (mu0 + mu), mu0


@njit(cache=True, error_model="numpy")
def curvature_across(curvature_px: FloatArray, q: FloatArray) -> float:
    """Compute the second-order change of brightness with slope across the rim at a rim point; not zero.

    Parameters
    ----------
    curvature_px : ndarray, shape (2, 2)
        See `RimShading`.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    of_x = curvature_px[0, 0] * q[2] + curvature_px[0, 1] * q[3]
    of_y = curvature_px[1, 0] * q[2] + curvature_px[1, 1] * q[3]
    value = (q[2] * of_x + q[3] * of_y) / (q[4] * q[4])
    return value if np.abs(value) > _LEAST_CURVATURE else -_LEAST_CURVATURE


@njit(cache=True, error_model="numpy")
def reference_along(gradient: FloatArray, chart_px: FloatArray, q: FloatArray) -> float:
    """Compute the reference brightness at a rim point over that at the rim's centre.

    Parameters
    ----------
    gradient : ndarray, shape (2,)
        See `RimShading`.
    chart_px : ndarray, shape (5,)
        The rim, px.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    ratio = 1.0 + gradient[0] * (q[0] - chart_px[0]) + gradient[1] * (q[1] - chart_px[1])
    return max(ratio, _DARKEST)
