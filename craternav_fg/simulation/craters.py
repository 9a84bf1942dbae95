"""Random fields of craters along a descent."""

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.crater_shape import (
    crest_height_over_centre_ground_m,
    depth_m,
    ground_levels,
    rim_height_m,
)
from craternav_fg.simulation.relief import Relief
from factors.arrays import FloatArray

# Distance that clutter keeps from the crests of the catalogue, in its own radii.
CREST_CLEARANCE = 1.6
# Positions of the lander at which visibility is judged, at most.
_TRACK_POINTS = 200
# Distance beyond the outer points of a size distribution at which its power law is sampled, in e-folds.
_CONTINUED = 20.0


@dataclass(frozen=True)
class CraterFieldOptions:
    """A random field of craters.

    Attributes
    ----------
    density : float
        k of the scale-free size distribution: k r^-2 craters larger than r on a unit of area.
    size_frequency_km : tuple of tuple of float
        In place of `density`: diameters, km, and numbers of larger craters per km^2.
    min_apparent_px : float
        Smallest semi-minor axis, seen from the lowest altitude at which the crater is in view.
    max_apparent_px : float
        Largest semi-major axis, seen from the highest altitude at which the crater is in view.
    focal_px : float
        Focal length of the camera that sees them.
    reach_altitudes : float
        Half-width of the corridor along the ground track, in altitudes: what the lander sees.
    separation_ratio : float
        Smallest distance of centres over the sum of their semi-major axes; below 1 craters overlap.
    min_axis_ratio : float
        Axis ratios b/a are uniform from here to 1.
    clutter_px : tuple of float
        Smallest and largest apparent size of craters outside the catalogue, see `random_clutter`.
    """

    density: float = 0.003
    min_apparent_px: float = 12.0
    max_apparent_px: float = 150.0
    focal_px: float = 1267.2
    reach_altitudes: float = 1.25
    separation_ratio: float = 1.3
    min_axis_ratio: float = 0.75
    clutter_px: tuple[float, float] = (2.5, 9.0)
    size_frequency_km: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 < self.min_apparent_px < self.max_apparent_px:
            raise ValueError("expected 0 < min_apparent_px < max_apparent_px")
        if not 0.0 < self.clutter_px[0] < self.clutter_px[1]:
            raise ValueError("expected clutter_px to rise from above 0")


def random_craters(
    rng: np.random.Generator,
    body: Body,
    ground_track: FloatArray,
    options: CraterFieldOptions,
    relief: Relief,
) -> Catalog:
    """Draw craters with elliptical rims along a descent.

    Parameters
    ----------
    rng : Generator
    body : Body
    ground_track : ndarray, shape (k, 3)
        Positions of the lander in g, m, so close that successive views overlap.
    options : CraterFieldOptions
        Sizes and density.
    relief : Relief
        Terrain in which they stand: it determines their heights.

    Returns
    -------
    Catalog
        Largest first, named S00001, S00002, ...
    """
    field = _draw(rng, body, ground_track, options)
    order = np.argsort(-field.semi_major_m, kind="stable")
    field = field.take(order[field.seen_px(order, options) <= options.max_apparent_px])
    field = field.take(
        np.flatnonzero(_apart(body.radius_m * field.normals, field.semi_major_m, options.separation_ratio))
    )
    return standing(field.catalog("S", body), relief)


def standing(catalog: Catalog, relief: Relief) -> Catalog:
    """Put a catalogue's craters, largest first, on the terrain they stand in, with level rims."""
    body = catalog.body
    radius = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    xy = relief.plane(catalog.up)
    level, gradient = relief.at(xy, radius)
    heights = np.full(len(catalog), np.nan)
    ground_levels(
        catalog.up,
        catalog.axes,
        np.stack([depth_m(radius), rim_height_m(radius)], axis=-1),
        crest_height_over_centre_ground_m(catalog.semi_major_m, catalog.semi_minor_m, body),
        np.concatenate([xy, level[:, None], gradient], axis=1),
        body.radius_m,
        heights,
    )
    return replace(catalog, height_m=heights, plane_tilt_rad=np.zeros((len(catalog), 2)))


def random_clutter(
    rng: np.random.Generator,
    body: Body,
    ground_track: FloatArray,
    options: CraterFieldOptions,
    catalog: Catalog,
) -> Catalog:
    """Draw small craters that the catalogue does not have, for `Terrain`.

    They continue the size distribution of the catalogue downwards, may overlap one another and keep clear of
    the crests of the catalogue.

    Parameters
    ----------
    rng : Generator
    body : Body
    ground_track : ndarray, shape (k, 3)
        Positions of the lander in g, m.
    options : CraterFieldOptions
        Density and `clutter_px`.
    catalog : Catalog
        Craters whose crests are kept clear.

    Returns
    -------
    Catalog
        Named U00001, ...; the heights are 0 and without meaning.
    """
    small, large = options.clutter_px
    field = _draw(rng, body, ground_track, replace(options, min_apparent_px=small, max_apparent_px=large))
    near_px = field.semi_major_m * options.focal_px / field.lowest_m
    field = field.take(np.flatnonzero(near_px <= large))
    if len(catalog) and len(field.normals):
        free = np.ones(len(field.normals), dtype=np.bool_)
        tree = cKDTree(body.radius_m * field.normals)
        centres = body.radius_m * catalog.up
        margin = CREST_CLEARANCE * field.semi_major_m
        groups = tree.query_ball_point(centres, catalog.semi_major_m + margin.max())
        for i, group in enumerate(groups):
            near = np.asarray(group, dtype=np.int64)
            distance = body.radius_m * np.linalg.norm(field.normals[near] - catalog.up[i], axis=1)
            cut = (distance > catalog.semi_minor_m[i] - margin[near]) & (
                distance < catalog.semi_major_m[i] + margin[near]
            )
            free[near[cut]] = False
        field = field.take(np.flatnonzero(free))
    return field.catalog("U", body)


@dataclass(frozen=True)
class _Field:
    """Drawn craters (n,), and the altitudes between which they are in view."""

    normals: FloatArray
    semi_major_m: FloatArray
    semi_minor_m: FloatArray
    angle_rad: FloatArray
    lowest_m: FloatArray
    highest_m: FloatArray

    def take(self, rows: npt.NDArray[np.int64]) -> "_Field":
        return _Field(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def seen_px(self, rows: npt.NDArray[np.int64], options: CraterFieldOptions) -> FloatArray:
        """Semi-major axes (n,), px, seen from the highest altitude."""
        return self.semi_major_m[rows] * options.focal_px / self.highest_m[rows]

    def catalog(self, letter: str, body: Body) -> Catalog:
        lat, lon = frames.latitude_longitude(self.normals)
        return Catalog(
            identifiers=tuple(f"{letter}{i + 1:05d}" for i in range(len(lat))),
            latitude_rad=lat,
            longitude_rad=lon,
            semi_major_m=self.semi_major_m,
            semi_minor_m=self.semi_minor_m,
            angle_rad=self.angle_rad,
            height_m=np.zeros(len(lat)),
            body=body,
        )


def _draw(
    rng: np.random.Generator, body: Body, ground_track: FloatArray, options: CraterFieldOptions
) -> _Field:
    """Draw craters of at least `min_apparent_px`, seen from the lowest altitude at which they are in view."""
    track = np.asarray(ground_track, dtype=np.float64)
    track = track[np.unique(np.linspace(0, len(track) - 1, min(len(track), _TRACK_POINTS)).astype(int))]
    altitude_m = body.altitude_m(track)
    ground = body.radius_m * track / np.linalg.norm(track, axis=1, keepdims=True)
    r_max = options.max_apparent_px * altitude_m.max() / options.focal_px
    r = options.min_apparent_px * altitude_m.min() / options.focal_px
    parts = []
    # By octaves of size: small craters are drawn only where the lander is low.
    while r < r_max:
        r_next = min(2.0 * r, r_max)
        low = altitude_m <= r_next * options.focal_px / options.min_apparent_px
        parts.append(_draw_sizes(rng, body, ground[low], altitude_m[low], (r, r_next), options))
        r = r_next
    joined = _Field(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Field)})
    joined.lowest_m[:], joined.highest_m[:] = _seen_from_m(
        body, joined.normals, ground, altitude_m, options.reach_altitudes
    )
    smallest_m = options.min_apparent_px * joined.lowest_m / options.focal_px
    return joined.take(np.flatnonzero(joined.semi_minor_m >= smallest_m))


def _draw_sizes(
    rng: np.random.Generator,
    body: Body,
    ground: FloatArray,
    altitude_m: FloatArray,
    sizes_m: tuple[float, float],
    options: CraterFieldOptions,
) -> _Field:
    """Draw craters with semi-minor axes between two sizes in a rectangle around a ground track (k, 3)."""
    gRe = frames.east_north_up(*frames.latitude_longitude(ground.mean(axis=0)))
    plane = body.radius_m * (ground @ gRe)[:, :2] / (ground @ gRe)[:, 2:]
    centred = plane - plane.mean(axis=0)
    along = np.linalg.svd(centred)[2]
    reach_m = options.reach_altitudes * altitude_m[:, None]
    low = (centred @ along.T - reach_m).min(axis=0)
    high = (centred @ along.T + reach_m).max(axis=0)
    area_m2 = np.prod(high - low)
    if options.size_frequency_km:
        diameter, number = _continued(options.size_frequency_km)
        least, most = np.exp(np.interp(np.log(2e-3 * np.array(sizes_m[::-1])), diameter, number))
        n = int(rng.poisson(1e-6 * (most - least) * area_m2))
        logs = np.interp(-np.log(rng.uniform(least, most, n)), -number, diameter)
        semi_minor = 500.0 * np.exp(logs)
    else:
        # N(>r) = k r^-2.
        most, least = sizes_m[0] ** -2, sizes_m[1] ** -2
        n = int(rng.poisson(options.density * (most - least) * area_m2))
        semi_minor = 1.0 / np.sqrt(rng.uniform(least, most, n))
    xy = rng.uniform(low, high, (n, 2)) @ along + plane.mean(axis=0)
    e = np.concatenate([xy, np.full((n, 1), body.radius_m)], axis=1)
    return _Field(
        normals=(e / np.linalg.norm(e, axis=1, keepdims=True)) @ gRe.T,
        semi_major_m=semi_minor / rng.uniform(options.min_axis_ratio, 1.0, n),
        semi_minor_m=semi_minor,
        angle_rad=rng.uniform(0.0, np.pi, n),
        lowest_m=np.zeros(n),
        highest_m=np.zeros(n),
    )


def _continued(size_frequency_km: tuple[tuple[float, float], ...]) -> tuple[FloatArray, FloatArray]:
    """Logarithms of diameters and numbers (n,), with a far point on the power law of either end."""
    x, y = np.log(np.array(size_frequency_km)).T
    slopes = np.diff(y) / np.diff(x)
    far = _CONTINUED
    x = np.concatenate([[x[0] - far], x, [x[-1] + far]])
    y = np.concatenate([[y[0] - far * slopes[0]], y, [y[-1] + far * slopes[-1]]])
    return x, y


def _seen_from_m(
    body: Body, normal: FloatArray, ground: FloatArray, altitude_m: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest altitude (n,) from which points (n, 3) are in view; inf and 0 where never."""
    lowest = np.full(len(normal), np.inf)
    highest = np.zeros(len(normal))
    places = body.radius_m * normal
    for point, h in zip(ground, altitude_m, strict=True):
        away = places - point
        near = np.einsum("ni,ni->n", away, away) <= (reach * h) ** 2
        lowest[near] = np.minimum(lowest[near], h)
        highest[near] = np.maximum(highest[near], h)
    return lowest, highest


def _apart(centres: FloatArray, semi_major_m: FloatArray, separation: float) -> npt.NDArray[np.bool_]:
    """Which craters (n,), largest first, are apart from all larger ones that are kept."""
    free = np.ones(len(centres), dtype=np.bool_)
    tree = cKDTree(centres) if len(centres) else None
    for i in range(len(centres)):
        if tree is None or not free[i]:
            continue
        near = np.asarray(tree.query_ball_point(centres[i], separation * 2.0 * semi_major_m[i]))
        near = near[near > i]
        distance = np.linalg.norm(centres[near] - centres[i], axis=1)
        free[near[distance < separation * (semi_major_m[near] + semi_major_m[i])]] = False
    return free
