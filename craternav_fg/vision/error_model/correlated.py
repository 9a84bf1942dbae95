"""Correlated errors of rims: what a crater keeps from frame to frame, and what all rims of a descent share.

The terrain under a crater differs from a plane and its outline from an ellipse in the same way in every
frame, so a part of a rim's error is fixed to the ground, in directions of the rim's plane. Other errors are
common to all rims. A blurred rim crest that hides the ground behind it shifts rims towards the camera and
stretches them along the line of sight, as far as it is not the canonical one (`crest_tables`). An unknown
ground brightness shifts them along the illumination direction; the regional slope does so in proportion to
their radius where outlines are irregular. A crest profile unlike the canonical one makes all rims too large
or too small.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import SHARED_SIZE
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.vision.error_model.systematic import RimErrors
from factors.arrays import FloatArray, IntArray
from factors.kernels.rim_errors import ground_slopes, tilt_slopes

# Columns of `ground_slopes` that move a rim within its plane: shifts along l1 and l2, growth along l1, shear,
# growth along l2. The other column is a shift along the normal.
_IN_PLANE = [0, 1, 3, 4, 5]
# Columns of shared errors that make all rims larger.
_GROWTH = [5, 6]
# Largest excess of a frame's variance factor over 1 for which white variance is added. The systematic
# variance is multiplied by the factor already, so without a bound the added one grows with its square: on
# rough ground of another renderer (`tests/foreign`), with factors of 10 to 25, to ten times the error.
_MAX_EXCESS = 2.0
# Slope contrasts below which shared errors grow, and the least that counts: rims with less are hardly
# measured. Chosen: over 48 descents on three bodies with the sun 15 to 88 deg high the log-likelihood of the
# errors is larger by 20 with the square of the inverse for shifts than with the inverse, whether from 0.5 or
# 0.8 on; for growths the square makes it smaller.
_WEAK_CONTRAST, _WEAK_CONTRAST_OF_SHIFTS, _LEAST_CONTRAST = 1.0, 0.6, 0.1
# Least share of a variance that is time-correlated, so that roots exist.
_LEAST_SHARE = 1e-9


@dataclass(frozen=True)
class CorrelatedErrorOptions:
    """Size of the errors of rims that are correlated over frames or over rims.

    All lengths in px are standard deviations at the rim, in the image; all shares are relative to the radius
    unless they are shares of a variance. Where slopes change the brightness little, as under a high sun, an
    error of the brightness moves edges farther: lengths that all rims share are those for a large slope
    contrast (see `photometry`). Below a contrast of 1 growths increase with its inverse; below 0.6 shifts
    increase with the square, as the second order of the slope then outweighs the first.

    Compared with rendered images by `craternav_fg.calibration.correlated_errors`, `arc_px` and `arc_share` by
    `craternav_fg.calibration.arcs`, which determine some of them and hardly the others, see
    `craternav_fg.calibration`; `excess_white_share` is chosen.

    Attributes
    ----------
    crater_share : float
        Share of a rim's systematic variance (`RimErrors.systematic`) that is time-correlated for its crater.
        The rest is white: gaps in the seen outline, neighbouring craters and the pixel grid change from frame
        to frame.
    excess_white_share : float
        White variance that estimators which fuse frames add (`RimSet.fused_white`) where a frame's rims
        scatter more than they claim (`frame_scatter`), as a share of the systematic variance per unit of the
        excess of the variance factor over 1, of which at most 2 count. On rough terrain many rims are worse
        than the median, neighbouring ones alike.
    camera_shift_px : float
        Common shift towards the camera along the ground, for a camera at the horizon. One component grows
        with the sine of the emission angle, another of the same size with its cube.
    sun_shift_px : float
        Common shift towards the sun along the ground, for a sun at the horizon.
    stretch_px, stretch_share : float
        Common growth of the radius along the line of sight, for a camera at the horizon: px, and share of the
        radius. It grows with the square of the sine of the emission angle.
    size_px, size_share : float
        Common growth of the radius: px, and share of the radius.
    brightness_share : float
        Share of the variance from the unknown reference brightness (`RimErrors.brightness_root`) that all
        rims have in common.
    arc_px, arc_share : float
        Time-correlated shift that the edge points of an arc share: px, and share of the radius.
    map_place_share, map_size_share : float
        Standard deviations of the catalogue beside those that it states (`Catalog.errors`): of each
        coordinate of a crater's place, and of each semi-axis. Both are errors that a crater keeps. Real
        catalogues of circles have several per cent.
    map_height_m : float
        The same of the height of a rim's plane, m: a coarse elevation model smooths a rim.
    map_tilt_rad : float
        Standard deviation of both slopes of a rim's plane where the catalogue does not state them
        (`Catalog.plane_tilt_rad`). That of rims on the Moon's elevation model, by
        `craternav_fg.calibration.rim_tilts`.
    """

    crater_share: float = 0.7
    excess_white_share: float = 0.2
    camera_shift_px: float = 0.03
    sun_shift_px: float = 0.03
    stretch_px: float = 0.04
    stretch_share: float = 0.00005
    size_px: float = 0.04
    size_share: float = 0.003
    brightness_share: float = 0.6
    arc_px: float = 0.1
    arc_share: float = 0.006
    map_place_share: float = 0.0
    map_size_share: float = 0.0
    map_height_m: float = 0.0
    map_tilt_rad: float = 0.04


class SplitErrors(NamedTuple):
    """Parts of the errors of a frame's rims, with the covariance of the whole.

    Attributes
    ----------
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the whole error.
    correlated, of_map, shared : ndarray, shapes (n, 5, 5), (n, 5, m), (n, 5, 8)
        Roots of its parts, see `RimSet`; `of_map` is None where the map counts as exact.
    fused_white : ndarray, shape (n, 5, 5)
        See `RimSet`.
    """

    covariance: FloatArray
    correlated: FloatArray
    of_map: FloatArray | None
    shared: FloatArray
    fused_white: FloatArray


def map_variances(rows: IntArray, catalog: Catalog, options: CorrelatedErrorOptions) -> FloatArray:
    """Variances of craters' errors on the map: those that the catalogue states, and those of the options.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The craters in the catalogue.
    catalog : Catalog
    options : CorrelatedErrorOptions

    Returns
    -------
    ndarray, shape (n, 6)
        In the order and the units of `ground_slopes`: shifts in radii, growths as shares.
    """
    radius_m = np.sqrt(catalog.semi_major_m[rows] * catalog.semi_minor_m[rows])
    one = np.ones(len(rows))
    assumed = MapErrors(
        options.map_place_share * radius_m, options.map_size_share * one, options.map_height_m * one
    )
    out = assumed.variances(radius_m)
    return out if catalog.errors is None else out + catalog.errors.take(rows).variances(radius_m)


def map_roots(
    rows: IntArray, gTb: FloatArray, camera: Camera, catalog: Catalog, options: CorrelatedErrorOptions
) -> FloatArray | None:
    """Compute the roots of what errors of craters on the map add to rims' charts.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    camera : Camera
    catalog : Catalog
    options : CorrelatedErrorOptions

    Returns
    -------
    ndarray, shape (n, 5, m), or None
        As in `RimSet.of_map`; m depends on the catalogue and the options alone.
    """
    parts = []
    assumed = options.map_place_share, options.map_size_share, options.map_height_m
    if any(assumed) or not (catalog.errors is None or catalog.errors.exact):
        slopes = ground_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
        parts.append(slopes * np.sqrt(map_variances(rows, catalog, options))[:, None])
    if catalog.plane_tilt_rad is None and options.map_tilt_rad > 0.0:
        tilts = tilt_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
        parts.append(options.map_tilt_rad * tilts)
    return np.concatenate(parts, axis=2) if parts else None


def map_covariance(
    rows: IntArray, gTb: FloatArray, camera: Camera, catalog: Catalog, options: CorrelatedErrorOptions
) -> FloatArray:
    """Covariance of rims' charts from the errors of their craters on the map.

    Parameters
    ----------
    rows, gTb, camera, catalog, options
        See `map_roots`: shapes (n,), (4, 4).

    Returns
    -------
    ndarray, shape (n, 5, 5)
        In normalised image coordinates.
    """
    A = map_roots(rows, gTb, camera, catalog, options)
    return np.zeros((len(rows), 5, 5)) if A is None else A @ np.swapaxes(A, 1, 2)


def in_plane_slopes(rows: IntArray, gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Differentiate charts for errors of rims in their own planes.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n, 5, 5)
        Derivatives of the charts, in normalised image coordinates. Columns in units of the rim's mean radius:
        shift along l1 and l2, growth along l1, shear, growth along l2.
    """
    return ground_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[:, :, _IN_PLANE]


def radii_px(rows: IntArray, gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Compute the mean radii of rims as seen face on.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n,)
        px.
    """
    radius_m = np.sqrt(np.linalg.norm(catalog.axes[rows], axis=-1).prod(axis=-1))
    range_m = np.linalg.norm(camera.gTc(gTb)[:3, 3] - catalog.centres[rows], axis=-1)
    return np.asarray(camera.focal_px * radius_m / range_m)


def correlated_roots(
    errors: RimErrors,
    rows: IntArray,
    gTb: FloatArray,
    sun_g: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> tuple[FloatArray, FloatArray]:
    """Compute the roots of the correlated errors of a frame's rims.

    Parameters
    ----------
    errors : RimErrors
        Errors of n rims.
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g that sees them.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    camera : Camera
    catalog : Catalog
    options : CorrelatedErrorOptions

    Returns
    -------
    correlated, shared : ndarray, shapes (n, 5, 5), (n, 5, 8)
        As in `RimSet`.
    """
    brightness = errors.brightness_root
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    inverse = np.linalg.inv(slopes)
    own = errors.systematic - options.brightness_share * brightness[:, :, None] * brightness[:, None, :]
    on_ground = max(options.crater_share, _LEAST_SHARE) * inverse @ own @ np.swapaxes(inverse, 1, 2)
    correlated = slopes @ np.linalg.cholesky(0.5 * (on_ground + np.swapaxes(on_ground, 1, 2)))
    shared = slopes @ _shared_on_ground(rows, gTb, sun_g, camera, catalog, options)
    shared[:, :, 7] = np.sqrt(options.brightness_share) * brightness
    return correlated, shared


def _shared_on_ground(
    rows: IntArray,
    gTb: FloatArray,
    sun_g: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> FloatArray:
    """Roots (n, 5, 8) of the shared errors in the rims' planes, in radii; the last column is left zero."""
    centres, axes = catalog.centres[rows], catalog.axes[rows]
    length_m = np.linalg.norm(axes, axis=-1)
    view = camera.gTc(gTb)[:3, 3] - centres
    range_m = np.linalg.norm(view, axis=-1)
    # Unit vectors towards the camera and the sun: components along l1 and l2.
    along = axes / length_m[:, :, None]
    camera_l = np.einsum("nki,ni->nk", along, view / range_m[:, None])
    sun_l = along @ sun_g
    sine2 = np.sum(camera_l**2, axis=-1, keepdims=True)
    x, y = camera_l.T
    # A stretch t along c is the map 1 + t c c': growth along l1, shear, growth along l2.
    stretch = np.stack([x * x, x * y, y * y], axis=-1)
    _, contrast = flat_terrain_brightness(catalog.normals[rows], sun_g, view / range_m[:, None])
    contrast = np.linalg.norm(contrast, axis=-1)
    farther = _WEAK_CONTRAST_OF_SHIFTS / np.clip(contrast, _LEAST_CONTRAST, _WEAK_CONTRAST_OF_SHIFTS)
    larger = _WEAK_CONTRAST / np.clip(contrast, _LEAST_CONTRAST, _WEAK_CONTRAST)
    px = (1.0 / radii_px(rows, gTb, camera, catalog))[:, None]
    shift_px, growth_px = px * farther[:, None] ** 2, px * larger[:, None]
    roots = np.zeros((len(rows), 5, SHARED_SIZE))
    roots[:, :2, 0] = options.camera_shift_px * shift_px * camera_l
    roots[:, :2, 1] = options.camera_shift_px * shift_px * sine2 * camera_l
    roots[:, :2, 2] = options.sun_shift_px * shift_px * sun_l
    roots[:, 2:, 3] = options.stretch_px * growth_px * stretch
    roots[:, 2:, 4] = options.stretch_share * stretch
    roots[:, [2, 4], 5] = options.size_px * growth_px
    roots[:, [2, 4], 6] = options.size_share
    return roots


def split(
    errors: RimErrors,
    variance_factor: float,
    rows: IntArray,
    gTb: FloatArray,
    sun_g: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> SplitErrors:
    """Split the errors of a frame's rims into white, time-correlated and shared parts and those of the map.

    Parameters
    ----------
    errors : RimErrors
        Errors of n rims, scaled by the frame's variance factor.
    variance_factor : float
        See `frame_scatter.variance_factor`.
    rows, gTb, sun_g, camera, catalog, options
        See `correlated_roots`: shapes (n,), (4, 4), (3,).

    Returns
    -------
    SplitErrors
    """
    correlated, shared = correlated_roots(errors, rows, gTb, sun_g, camera, catalog, options)
    of_map = map_roots(rows, gTb, camera, catalog, options)
    brightness = errors.brightness_root
    # The time-correlated part of the fit and the shared brightness are in the covariance already, the other
    # shared parts and the errors of the map are new.
    own = errors.covariance - options.brightness_share * brightness[:, :, None] * brightness[:, None, :]
    covariance = own + shared @ np.swapaxes(shared, 1, 2)
    if of_map is not None:
        covariance += of_map @ np.swapaxes(of_map, 1, 2)
    added = options.excess_white_share * min(variance_factor - 1.0, _MAX_EXCESS)
    white = own - correlated @ np.swapaxes(correlated, 1, 2) + added * errors.systematic
    return SplitErrors(covariance, correlated, of_map, shared, white)


def shared_of_arcs(
    rows: IntArray,
    gTb: FloatArray,
    sun_g: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> FloatArray:
    """Compute the roots of the error that a frame's arcs share with all rims.

    Without the common growth of the radius, of which arcs are freed (`common_growth`), and without the
    reference brightness, whose error is not estimated where no ellipse is fitted.

    Parameters
    ----------
    rows, gTb, sun_g, camera, catalog, options
        See `correlated_roots`: shapes (n,), (4, 4), (3,).

    Returns
    -------
    ndarray, shape (n, 5, 8)
        As in `RimSet.shared`.
    """
    roots = _shared_on_ground(rows, gTb, sun_g, camera, catalog, options)
    roots[:, :, _GROWTH] = 0.0
    return np.asarray(in_plane_slopes(rows, gTb, camera, catalog) @ roots)


def arc_sigma_px(minor_px: float, outline_share: float, options: CorrelatedErrorOptions) -> float:
    """Compute the time-correlated standard deviation that the edge points of an arc share.

    Parameters
    ----------
    minor_px : float
        Semi-minor axis of the arc's rim, px.
    outline_share : float
        Median deviation of the frame's outlines from ellipses, in radii.
    options : CorrelatedErrorOptions

    Returns
    -------
    float
        Outward shift, px.
    """
    return options.arc_px + float(np.hypot(options.arc_share, outline_share)) * minor_px
