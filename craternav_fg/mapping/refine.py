"""Rims of a catalogue measured on an elevation model: ellipses in place of circles, with covariances.

The crest is searched on rays around each crater, as a closed line (`crest_kernel`), and an ellipse is fitted
to it robustly, as to the edge points of an image (`vision.ellipse_kernel`): outlines of real craters are not
ellipses, and their deviation is part of the covariance. The ellipse found is the start of the next search, in
a narrower ring. What the model's blur does to the last one is corrected: its size (`crest_blur`), and its
centre, which the walls show as well (`wall_centre`). A rim that the model does not show keeps the catalogue's
numbers, and the reason is told.

The rim is a planar ellipse on local horizontal axes; the mean height of its points is that of the crest. The
least-squares plane through the crest gives the tilt, and the deviation from it the scatter. A catalogue
without heights gets those of the model for the other rims, too.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from os import cpu_count
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.dem import Dem
from craternav_fg.catalogs.heights import chord_depths_m, unknown_beyond, with_covered_heights
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import (
    axes_covariance,
    axes_of_chart,
    chart_of_axes,
    mean_radius,
    points_on,
    shape_change,
)
from craternav_fg.mapping.crest_blur import crest_bias
from craternav_fg.mapping.crest_search import RAYS, SEARCHES, Terrain, find_crest
from craternav_fg.mapping.measured_rim import Found, MeasuredRim
from craternav_fg.mapping.measured_rim import Outcome as Outcome
from craternav_fg.mapping.wall_centre import wall_shift
from craternav_fg.vision import ellipse_kernel
from factors.arrays import BoolArray, FloatArray, IntArray

Progress = Callable[[int, int], None]

# Largest gap between neighbouring points that counts as covered, rad: five rays.
_MAX_GAP_RAD = 0.45
# Scatter of a perfect crest, in steps of the model: it is interpolated.
_MIN_SCATTER_STEPS = 0.05
# Rings, in radii, whose heights give the floor's, and those beside the crest that it must stand above.
_BOWL = (0.1, 0.2, 0.3, 0.4, 0.5)
_BESIDE = (0.75, 1.25)
# Systematic error of centre and semi-axes, per resolved length: blur moves the crest where its walls differ.
# Measured in `tests/mapping` on synthetic ground of other profiles, 1 to 2.5 steps of blur.
_FLOOR_PER_RESOLUTION = 0.2
# Direction in the chart in which an ellipse becomes larger.
_SIZE = np.array([0.0, 0.0, 1.0, 0.0, 1.0])
# Expected root mean square deviation of a rim from an ellipse, in radii, and the largest one.
_OUTLINE_SHARE, _MAX_SCATTER_SHARE = 0.03, 0.05
# Largest distance of the centre found from the catalogue's, in the catalogue's radii, and largest logarithm
# of a stretch between the ellipse found and the catalogue's.
_MAX_SHIFT_RADII, _MAX_SIZE_CHANGE = 0.5, 0.5
# Minimum share of the rays whose crest agrees with the ellipse.
_MIN_KEPT_SHARE = 0.7
# Minimum height of the crest above the mean of the searched ring, in radii: a pit or a hill has none.
_MIN_RELIEF_SHARE = 0.005
# Craters per task of a thread.
_CHUNK = 64


@dataclass(frozen=True)
class RefineOptions:
    """Which rims are searched, and how finely the model shows them.

    Attributes
    ----------
    min_diameter_steps : float
        Smallest diameter, in steps of the elevation model.
    resolution_steps : float
        Shortest length that the model resolves, in its steps: stereo models are smoother than their raster.
    """

    min_diameter_steps: float = 10.0
    resolution_steps: float = 2.5


@dataclass(frozen=True)
class RefinedRims:
    """A catalogue after refinement, and what was measured beside it; NaN where a rim is not refined.

    Attributes
    ----------
    catalog : Catalog
        Refined rims, and the others as they were, with errors and a common shift: of refined rims the errors
        of the fit, of the others what the catalogue states, or what the refined ones show of it. Planes are
        level unless the catalogue has tilts; refined rims have their measured ones then. See `tilted`.
    outcomes : tuple of Outcome, length n
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the rim's chart in the tangent plane, along east and north at the catalogue's centre:
        m, and logarithms.
    height_sigma_m : ndarray, shape (n,)
        Standard deviation of the rim's height.
    tilt_rad : ndarray, shape (n, 2)
        Slope of the rim's plane towards east and north at the refined centre.
    scatter_m : ndarray, shape (n,)
        Root mean square deviation of the crest's height from that plane.
    depth_m : ndarray, shape (n,)
        Mean height of the crest above the floor, which is a tenth of the bowl within half a radius.
    shift_m : ndarray, shape (n, 2)
        East and north of the refined centre from the catalogue's.
    log_size : ndarray, shape (n,)
        Logarithm of the refined mean radius over the catalogue's.
    """

    catalog: Catalog
    outcomes: tuple[Outcome, ...]
    covariance: FloatArray
    height_sigma_m: FloatArray
    tilt_rad: FloatArray
    scatter_m: FloatArray
    depth_m: FloatArray
    shift_m: FloatArray
    log_size: FloatArray

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return the columns that a store keeps beside the catalogue.

        Returns
        -------
        dict of str to ndarray, shape (n, ...)
            `outcome`; `chart_covariance`, the 25 numbers of each crater row by row; the others in the units
            of their names.
        """
        return {
            "outcome": np.array([outcome.value for outcome in self.outcomes]),
            "chart_covariance": self.covariance.reshape(-1, 25),
            "height_sigma_m": self.height_sigma_m,
            "tilt_east_rad": self.tilt_rad[:, 0],
            "tilt_north_rad": self.tilt_rad[:, 1],
            "crest_scatter_m": self.scatter_m,
            "depth_m": self.depth_m,
            "shift_east_m": self.shift_m[:, 0],
            "shift_north_m": self.shift_m[:, 1],
        }

    def tilted(self) -> Catalog:
        """Return the catalogue with the measured tilts of the refined rims' planes."""
        if self.catalog.plane_tilt_rad is not None:
            return self.catalog
        return _tilted(self.catalog, self.tilt_rad)

    @property
    def refined(self) -> BoolArray:
        """Mask (n,) of the refined rims."""
        return np.array([outcome is Outcome.REFINED for outcome in self.outcomes], dtype=np.bool_)


def refine_on_dem(
    catalog: Catalog,
    dem: Dem,
    options: RefineOptions | None = None,
    progress: Progress | None = None,
) -> RefinedRims:
    """Measure the rims of a catalogue on an elevation model, on all cores.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem
        Elevation model of the catalogue's body.
    options : RefineOptions, optional
    progress : callable, optional
        Called with the number of craters done and of all.

    Returns
    -------
    RefinedRims
        Rims of a catalogue without heights get those of the model; beyond it they lie on the sphere, with a
        common uncertainty as large as the model's heights.
    """
    options = options or RefineOptions()
    known = with_model_heights(catalog, dem)
    n = len(catalog)
    chunks = [np.arange(first, min(first + _CHUNK, n)) for first in range(0, n, _CHUNK)]
    found: list[Found] = []
    with ThreadPoolExecutor(cpu_count()) as threads:
        parts = threads.map(lambda rows: measure_rims(known.take(rows), dem, options), chunks)
        for part in parts:
            found += part
            if progress is not None:
                progress(len(found), n)
    return collect(catalog, dem, found)


def measure_rims(catalog: Catalog, dem: Dem, options: RefineOptions) -> list[Found]:
    """Measure the rims of a catalogue, one after the other.

    Parameters
    ----------
    catalog : Catalog
        With heights, see `with_model_heights`.
    dem : Dem
    options : RefineOptions

    Returns
    -------
    list of MeasuredRim or Outcome
        The rim, or why there is none.
    """
    enu = frames.east_north_up(catalog.latitude_rad, catalog.longitude_rad)
    # Most craters of a global catalogue are elsewhere.
    reach_rad = SEARCHES[0][1] * catalog.semi_major_m / catalog.body.radius_m
    beyond = dem.inside_rad(enu[:, :, 2]) < -reach_rad
    return [
        Outcome.OUTSIDE if out else _refine(catalog, dem, options, enu, row)
        for row, out in enumerate(beyond.tolist())
    ]


def collect(catalog: Catalog, dem: Dem, found: list[Found]) -> RefinedRims:
    """Put the rims that were measured on an elevation model into their catalogue.

    Parameters
    ----------
    catalog : Catalog
        As it was given.
    dem : Dem
    found : list of MeasuredRim or Outcome
        For each crater.

    Returns
    -------
    RefinedRims
    """
    known = with_model_heights(catalog, dem)
    enu = frames.east_north_up(catalog.latitude_rad, catalog.longitude_rad)
    rims = _collected(known, enu, found)
    if known is catalog:
        return rims
    return replace(rims, catalog=unknown_beyond(rims.catalog, dem))


def with_model_heights(catalog: Catalog, dem: Dem) -> Catalog:
    """Read the heights of the rims within the model from it, where the catalogue has none.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem

    Returns
    -------
    Catalog
        The same one when it has heights.
    """
    return catalog if catalog.has_heights else with_covered_heights(catalog, dem)


def _refine(catalog: Catalog, dem: Dem, options: RefineOptions, enu: FloatArray, row: int) -> Found:
    """Measure one rim."""
    step_m = dem.step_rad * catalog.body.radius_m
    start = chart_of_axes(
        [0.0, 0.0, catalog.semi_major_m[row], catalog.semi_minor_m[row], catalog.angle_rad[row]]
    )
    if 2.0 * float(mean_radius(start)) < options.min_diameter_steps * step_m:
        return Outcome.TOO_SMALL
    # Metres along the tangent plane are those at the height of the terrain.
    range_m = catalog.body.radius_m + float(dem.heights_m(enu[None, row, :, 2])[0])
    terrain = partial(_heights, dem, enu[row], range_m)
    around = np.concatenate([share * points_on(start, 16) for share in (*_BOWL, 1.0, SEARCHES[0][1])])
    if not np.all(dem.covers(_directions(enu[row], range_m, around))):
        return Outcome.OUTSIDE
    chart = start
    for search in SEARCHES:
        crest = find_crest(chart, terrain, search, step_m)
        ok, steps, covariance, _, _, rms, kept, _, _ = ellipse_kernel.fit(
            crest / step_m, np.ones(RAYS), np.zeros((RAYS, 2)), 1.0, 0.0, np.zeros(2),
            _scaled(chart, 1.0 / step_m), _MIN_SCATTER_STEPS, _MAX_GAP_RAD, _OUTLINE_SHARE,
        )  # fmt: skip
        if not ok:
            return Outcome.NO_CREST
        chart = _scaled(steps, step_m)
        if not _near(chart, start):
            return Outcome.OTHER_CRATER
    radius_m = float(mean_radius(chart))
    if kept < _MIN_KEPT_SHARE * RAYS or rms * step_m > _MAX_SCATTER_SHARE * radius_m:
        return Outcome.NO_CREST
    resolution_m = options.resolution_steps * step_m
    floor_m = _FLOOR_PER_RESOLUTION * resolution_m
    bias, spread = crest_bias(resolution_m / radius_m)
    unit = np.array([step_m, step_m, 1.0, 1.0, 1.0])
    floor = axes_covariance(chart, floor_m) + spread**2 * np.outer(_SIZE, _SIZE)
    rim = _measured(chart, np.outer(unit, unit) * covariance + floor, crest, terrain)
    if rim.relief_m < _MIN_RELIEF_SHARE * radius_m:
        return Outcome.NO_CREST
    resolved = chart - bias * _SIZE
    resolved[:2] += wall_shift(chart, terrain, floor_m)
    # Semi-axes are lengths at the height of the rim.
    return replace(rim, chart_m=_scaled(resolved, (catalog.body.radius_m + rim.height_m) / range_m))


def _measured(chart: FloatArray, covariance: FloatArray, crest: FloatArray, terrain: Terrain) -> MeasuredRim:
    """Measure the heights of a rim and of its bowl."""
    radius_m = float(mean_radius(chart))
    off = crest - chart[:2]
    heights = terrain(crest)
    G = np.column_stack([np.ones(len(off)), off / radius_m])
    plane, *_ = np.linalg.lstsq(G, heights, rcond=None)
    rest = heights - G @ plane
    scatter_m = float(np.sqrt(np.sum(rest**2) / (len(rest) - 3)))
    # Neighbouring rays see the same bumps: the number of independent ones follows from their correlation.
    rho = float(np.clip(rest @ np.roll(rest, 1) / max(rest @ rest, 1e-300), 0.0, 0.95))
    independent = max(len(rest) * (1.0 - rho) / (1.0 + rho), 4.0)
    bowl = terrain(np.concatenate([chart[:2] + share * off for share in _BOWL]))
    beside = [terrain(chart[:2] + share * off).mean() for share in _BESIDE]
    return MeasuredRim(
        chart,
        covariance,
        float(plane[0]),
        scatter_m / float(np.sqrt(independent)),
        np.arctan(plane[1:] / radius_m),
        scatter_m,
        float(plane[0] - np.quantile(bowl, 0.1)),
        float(plane[0] - np.mean(beside)),
    )


def _near(chart: FloatArray, start: FloatArray) -> bool:
    """Return whether an ellipse may be the catalogue's crater."""
    shift = float(np.hypot(*(chart[:2] - start[:2])))
    return bool(
        shift <= _MAX_SHIFT_RADII * mean_radius(start) and shape_change(start, chart) <= _MAX_SIZE_CHANGE
    )


def _directions(enu: FloatArray, range_m: float, places_m: FloatArray) -> FloatArray:
    """Directions (n, 3) from the body's centre to places (n, 2) of the tangent plane, m."""
    directions = range_m * enu[:, 2] + places_m @ enu[:, :2].T
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def _heights(dem: Dem, enu: FloatArray, range_m: float, places_m: FloatArray) -> FloatArray:
    """Heights (n,) at places (n, 2) of the tangent plane, m."""
    return dem.heights_m(_directions(enu, range_m, places_m))


def _scaled(chart: FloatArray, factor: float) -> FloatArray:
    """Return a chart in another unit."""
    out = chart.copy()
    out[:2] *= factor
    out[[2, 4]] += np.log(factor)
    return out


def _collected(catalog: Catalog, enu: FloatArray, found: list[Found]) -> RefinedRims:
    """Put the results of all craters together."""
    n = len(catalog)
    values: dict[str, Any] = {
        name: getattr(catalog, name).copy()
        for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m")
    }
    covariance, tilt, shift = np.full((n, 5, 5), np.nan), np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    height_sigma, scatter, depth, log_size = (np.full(n, np.nan) for _ in range(4))
    for row, rim in _rims(found):
        x, y, a, b, angle = axes_of_chart(rim.chart_m)
        centre = _directions(enu[row], catalog.body.radius_m + rim.height_m, np.array([x, y]))
        latitude, longitude = frames.latitude_longitude(centre)
        values["latitude_rad"][row], values["longitude_rad"][row] = latitude, longitude
        values["semi_major_m"][row], values["semi_minor_m"][row] = a, b
        # East at the refined centre is another direction than at the catalogue's, near a pole very much so.
        turn = frames.east_north_up(latitude, longitude)[:, :2].T @ enu[row, :, :2]
        east, north = turn @ np.array([np.cos(angle), np.sin(angle)])
        values["angle_rad"][row] = np.remainder(np.arctan2(north, east), np.pi)
        values["height_m"][row] = rim.height_m
        covariance[row], shift[row] = rim.covariance, (x, y)
        tilt[row] = np.arctan(turn @ np.tan(rim.tilt_rad))
        log_size[row] = 0.5 * np.log(a * b / (catalog.semi_major_m[row] * catalog.semi_minor_m[row]))
        height_sigma[row], scatter[row], depth[row] = rim.height_sigma_m, rim.scatter_m, rim.depth_m
    rows = np.flatnonzero(np.isfinite(log_size))
    # The crest's points stand at their mean height on curved ground.
    values["height_m"][rows] -= chord_depths_m(replace(catalog, **values))[rows]
    rise = values["height_m"] - catalog.height_m
    values["errors"] = _errors(catalog, covariance, height_sigma, shift, log_size, rise)
    values["common_shift"] = _common_shift(catalog, rows, shift, rise)
    outcomes = tuple(Outcome.REFINED if isinstance(rim, MeasuredRim) else rim for rim in found)
    refined = replace(catalog, **values)
    if catalog.plane_tilt_rad is not None:
        refined = _tilted(refined, tilt)
    return RefinedRims(refined, outcomes, covariance, height_sigma, tilt, scatter, depth, shift, log_size)


def _tilted(catalog: Catalog, tilt_rad: FloatArray) -> Catalog:
    """Tilt the planes of rims that were measured in the tangent plane; of others tilts (n, 2) are NaN."""
    tilts, axes = catalog.tilts_rad().copy(), [catalog.semi_major_m, catalog.semi_minor_m, catalog.angle_rad]
    major, minor, angle = (values.copy() for values in axes)
    for row in np.flatnonzero(np.isfinite(tilt_rad[:, 0])):
        slope = np.tan(tilt_rad[row])
        steepness = float(slope @ slope)
        # Along the slope, the plane is longer than its projection.
        stretch = np.eye(2)
        if steepness > 0.0:
            stretch += (np.sqrt(1.0 + steepness) - 1.0) / steepness * np.outer(slope, slope)
        c, s = np.cos(angle[row]), np.sin(angle[row])
        rim = stretch @ np.array([[c, -s], [s, c]]) @ np.diag([major[row], minor[row]])
        U, sizes, _ = np.linalg.svd(rim)
        major[row], minor[row] = sizes
        angle[row] = np.remainder(np.arctan2(U[1, 0], U[0, 0]), np.pi)
        tilts[row] = tilt_rad[row]
    return replace(catalog, semi_major_m=major, semi_minor_m=minor, angle_rad=angle, plane_tilt_rad=tilts)


def _errors(
    catalog: Catalog,
    covariance: FloatArray,
    height_sigma: FloatArray,
    shift: FloatArray,
    log_size: FloatArray,
    rise: FloatArray,
) -> MapErrors:
    """Errors of refined rims, and of the others: as the catalogue states, or as refinement shows."""
    errors = catalog.errors
    rows = np.flatnonzero(np.isfinite(log_size))
    if not len(rows):
        return errors or MapErrors.zeros(len(catalog))
    variances = np.diagonal(covariance[rows], axis1=1, axis2=2)
    if errors is None:
        radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
        place = float(_robust_rms(shift[rows] / radius_m[rows, None]).max())
        size = float(_robust_rms(log_size[rows, None])[0])
        spread_m = (
            float(_robust_rms((rise[rows] - np.median(rise[rows]))[:, None])[0])
            if catalog.has_heights
            else 0.0
        )
        errors = MapErrors(place * radius_m, np.full(len(catalog), size), np.full(len(catalog), spread_m))
    place_m = np.sqrt(0.5 * (variances[:, 0] + variances[:, 1]))
    size_share = np.sqrt(0.5 * (variances[:, 2] + variances[:, 4]))
    return errors.replaced(rows, MapErrors(place_m, size_share, height_sigma[rows]))


def _common_shift(
    catalog: Catalog, rows: IntArray, shift: FloatArray, rise: FloatArray
) -> CommonShift | None:
    """Return the common shift of the rims that are left: as stated, or as the refined ones show.

    Refined rims lie where the elevation model has them, and have none.
    """
    found = catalog.common_shift
    if not len(rows):
        return found
    if found is None:
        place_m = float(np.sqrt(np.mean(np.median(shift[rows], axis=0) ** 2)))
        height_m = abs(float(np.median(rise[rows]))) if catalog.has_heights else 0.0
        found = replace(
            CommonShift.zeros(len(catalog)),
            place_m=np.full(len(catalog), place_m),
            height_m=np.full(len(catalog), height_m),
        )
    return found.replaced(rows, CommonShift.zeros(len(rows)))


def _robust_rms(values: FloatArray) -> FloatArray:
    """Estimate root mean squares (m,) of columns (n, m) from the median of their sizes."""
    return np.asarray(1.4826 * np.median(np.abs(values), axis=0))


def _rims(found: list[Found]) -> Iterator[tuple[int, MeasuredRim]]:
    for row, rim in enumerate(found):
        if isinstance(rim, MeasuredRim):
            yield row, rim
