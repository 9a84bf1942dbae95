"""Merge catalogues: each crater once, with the differences between its sources.

Two entries are the same crater if their centres lie within a fraction of the larger radius, their sizes agree
within a factor, and neither has a better partner. An ellipse is kept if a source has one, otherwise the entry
of the first source. The differences between the sources determine the errors of those that state none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.tables import Column, write_table
from factors.arrays import FloatArray, IntArray

# Radii of one body that agree to so much: those of two tables may be rounded differently.
_RADIUS_TOLERANCE = 1e-6
_COLUMNS = (Column("CRATER_ID", "text"), Column("SOURCE", "text"), Column("ALSO_IN", "text"))
# Median absolute deviation to standard deviation.
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class MergeOptions:
    """When two entries are one crater.

    Attributes
    ----------
    place_share : float
        Largest distance of the centres, in the larger radius.
    size_factor : float
        Largest ratio of the sizes.
    """

    place_share: float = 0.5
    size_factor: float = 1.4


@dataclass(frozen=True)
class Merged:
    """A merged catalogue.

    Attributes
    ----------
    catalog : Catalog
        With errors, if its sources state some or share enough craters to show them.
    source : ndarray of int, shape (n,)
        Index of the source of each crater.
    also_in : tuple of tuple of int, length n
        Further sources that have it.
    """

    catalog: Catalog
    source: IntArray
    also_in: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Difference:
    """How the entries of one catalogue differ from those of another for the same craters.

    Attributes
    ----------
    pairs : ndarray of int, shape (n, 2)
        Rows of the two.
    shift_m : ndarray, shape (2,)
        Median of the other's place less this one's, east and north, m.
    shift_sigma_m : ndarray, shape (2,)
        Robust standard deviation of single craters about it, m.
    shift_share : ndarray, shape (2,)
        The same in radii.
    scale : float
        Median ratio of the other's size to this one's.
    scale_sigma : float
        Robust standard deviation of its logarithm.
    """

    pairs: IntArray
    shift_m: FloatArray
    shift_sigma_m: FloatArray
    shift_share: FloatArray
    scale: float
    scale_sigma: float


def same_craters(one: Catalog, other: Catalog, options: MergeOptions = MergeOptions()) -> IntArray:
    """Find the craters that two catalogues share.

    Parameters
    ----------
    one, other : Catalog
        Catalogues of one body.
    options : MergeOptions

    Returns
    -------
    ndarray of int, shape (n, 2)
        Rows of the two; no row stands twice.
    """
    sizes = [np.sqrt(part.semi_major_m * part.semi_minor_m) for part in (one, other)]
    places = [frames.up(part.latitude_rad, part.longitude_rad) for part in (one, other)]
    # The larger radius is at most this factor above the other's.
    reach = options.place_share * options.size_factor * sizes[1] / one.body.radius_m
    near = cKDTree(places[0]).query_ball_point(places[1], reach)
    counts = np.array([len(rows) for rows in near])
    right = np.repeat(np.arange(len(near)), counts)
    left = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near]) if counts.any() else right
    apart = np.linalg.norm(places[0][left] - places[1][right], axis=1) * one.body.radius_m
    ratio = np.abs(np.log(sizes[0][left] / sizes[1][right])) / np.log(options.size_factor)
    share = apart / np.maximum(sizes[0][left], sizes[1][right]) / options.place_share
    cost = np.hypot(ratio, share)
    fit = (ratio <= 1.0) & (share <= 1.0)
    order = np.flatnonzero(fit)[np.argsort(cost[fit], kind="stable")]
    pairs: list[tuple[int, int]] = []
    used: tuple[set[int], set[int]] = (set(), set())
    for k in order.tolist():
        i, j = int(left[k]), int(right[k])
        if i not in used[0] and j not in used[1]:
            used[0].add(i)
            used[1].add(j)
            pairs.append((i, j))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def merge(parts: Sequence[Catalog], names: Sequence[str], options: MergeOptions = MergeOptions()) -> Merged:
    """Merge catalogues.

    Parameters
    ----------
    parts : sequence of Catalog
        Catalogues of one body, the preferred first.
    names : sequence of str
        Names of the sources: they precede identifiers that stand in two of them.
    options : MergeOptions

    Returns
    -------
    Merged

    Raises
    ------
    InputError
        When the catalogues are of different bodies.
    """
    first = parts[0]
    for part, name in zip(parts, names, strict=True):
        if abs(part.body.radius_m - first.body.radius_m) > _RADIUS_TOLERANCE * first.body.radius_m:
            expected = f"a sphere of {first.body.radius_m:.9g} m, as in {names[0]}"
            raise InputError(name, f"expected {expected}, found {part.body.radius_m:.9g} m")
    if any(part.errors is None for part in parts):
        parts = _with_errors(parts, options)
    parts = _with_own_sources(parts)
    first = parts[0]
    catalog, source = first, np.zeros(len(first), dtype=np.int64)
    also: list[tuple[int, ...]] = [()] * len(first)
    for k, part in enumerate(parts[1:], 1):
        pairs = same_craters(catalog, part, options)
        better = pairs[_is_circle(catalog, pairs[:, 0]) & ~_is_circle(part, pairs[:, 1])]
        for i, _ in pairs.tolist():
            also[i] = (*also[i], k)
        for i, _ in better.tolist():
            also[i] = (int(source[i]), *(s for s in also[i] if s != k))
        source[better[:, 0]] = k
        catalog = _replaced(catalog, part, better)
        new = np.setdiff1d(np.arange(len(part)), pairs[:, 1])
        added = part.take(new)
        known = set(catalog.identifiers)
        identifiers = [f"{names[k]}-{one}" if one in known else one for one in added.identifiers]
        catalog = Catalog.joined([catalog, replace(added, identifiers=tuple(identifiers), body=first.body)])
        source = np.append(source, np.full(len(new), k))
        also += [()] * len(new)
    return Merged(catalog, source, tuple(also))


def _with_errors(parts: Sequence[Catalog], options: MergeOptions) -> list[Catalog]:
    """Set the errors of catalogues that state none; those of place and size grow with the radius.

    A difference has the errors of both. They cannot be told apart, so each source gets all of it, and the
    first source the least of its differences from the others. A source that shares no craters with the first
    gets the largest differences or, without any, the largest errors that a source states.
    """
    found = [difference(parts[0], part, options) for part in parts[1:]]
    shares = [(float(one.shift_share.max()), one.scale_sigma) for one in found if one is not None]
    shares = shares or [_error_share(part, part.errors) for part in parts if part.errors is not None]
    if not shares:
        return list(parts)
    own = [None if one is None else (float(one.shift_share.max()), one.scale_sigma) for one in found]
    out = []
    for part, share in zip(parts, [min(shares), *own], strict=True):
        if part.errors is not None:
            out.append(part)
            continue
        place, size = share or max(shares)
        radius_m = np.sqrt(part.semi_major_m * part.semi_minor_m)
        errors = MapErrors(place * radius_m, np.full(len(part), size), np.zeros(len(part)))
        out.append(replace(part, errors=errors))
    return out


def _error_share(part: Catalog, errors: MapErrors) -> tuple[float, float]:
    """Median errors that a catalogue states: of places in radii, and of sizes as a share."""
    radius_m = np.sqrt(part.semi_major_m * part.semi_minor_m)
    return float(np.median(errors.place_m / radius_m)), float(np.median(errors.size_share))


def _with_own_sources(parts: Sequence[Catalog]) -> list[Catalog]:
    """Give the sources of each catalogue numbers of their own; an unstated common shift stays unknown."""
    if all(part.common_shift is None for part in parts):
        return list(parts)
    out, count = [], 0
    for part in parts:
        shift = part.common_shift or CommonShift.unknown(len(part))
        numbers, source = np.unique(shift.source, return_inverse=True)
        out.append(replace(part, common_shift=replace(shift, source=count + source.astype(np.int64))))
        count += len(numbers)
    return out


def difference(one: Catalog, other: Catalog, options: MergeOptions = MergeOptions()) -> Difference | None:
    """Compare the entries of two catalogues for the craters that both have.

    Parameters
    ----------
    one, other : Catalog
        Catalogues of one body.
    options : MergeOptions

    Returns
    -------
    Difference or None
        None when they share fewer than three craters.
    """
    pairs = same_craters(one, other, options)
    if len(pairs) < 3:
        return None
    here, there = one.take(pairs[:, 0]), other.take(pairs[:, 1])
    enu = frames.east_north_up(here.latitude_rad, here.longitude_rad)
    step = frames.up(there.latitude_rad, there.longitude_rad)
    shift = one.body.radius_m * np.einsum("nij,ni->nj", enu[:, :, :2], step)
    size = np.sqrt(here.semi_major_m * here.semi_minor_m)
    ratio = np.log(np.sqrt(there.semi_major_m * there.semi_minor_m) / size)
    share = shift / size[:, None]
    return Difference(
        pairs,
        np.median(shift, axis=0),
        _robust_sigma(shift),
        _robust_sigma(share),
        float(np.exp(np.median(ratio))),
        float(_robust_sigma(ratio[:, None])[0]),
    )


def write_sources(path: Path, merged: Merged, names: Sequence[str]) -> None:
    """Write which source each crater is from, and which others have it, as CSV.

    Parameters
    ----------
    path : Path
    merged : Merged
    names : sequence of str
        Names of the sources.
    """
    also = [" ".join(names[k] for k in others) for others in merged.also_in]
    write_table(path, _COLUMNS, [merged.catalog.identifiers, [names[k] for k in merged.source], also])


def _is_circle(catalog: Catalog, rows: IntArray) -> npt.NDArray[np.bool_]:
    return np.asarray(catalog.semi_major_m[rows] == catalog.semi_minor_m[rows])


def _replaced(catalog: Catalog, part: Catalog, pairs: IntArray) -> Catalog:
    """Take the shapes of some craters from another catalogue, and their heights, if it knows any."""
    values = {}
    heights = ("height_m",) if part.has_heights else ()
    for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", *heights):
        values[name] = getattr(catalog, name).copy()
        values[name][pairs[:, 0]] = getattr(part, name)[pairs[:, 1]]
    errors = catalog.errors
    if errors is not None or part.errors is not None:
        there = part.errors or MapErrors.zeros(len(part))
        errors = (errors or MapErrors.zeros(len(catalog))).replaced(pairs[:, 0], there.take(pairs[:, 1]))
    shift = catalog.common_shift
    if shift is not None and part.common_shift is not None:
        shift = shift.replaced(pairs[:, 0], part.common_shift.take(pairs[:, 1]))
    tilt = catalog.plane_tilt_rad
    if tilt is not None or part.plane_tilt_rad is not None:
        tilt = catalog.tilts_rad().copy()
        tilt[pairs[:, 0]] = part.tilts_rad()[pairs[:, 1]]
    return replace(catalog, errors=errors, common_shift=shift, plane_tilt_rad=tilt, **values)


def _robust_sigma(values: FloatArray) -> FloatArray:
    """Estimate standard deviations (m,) of columns (n, m) by the median absolute deviation."""
    off = np.abs(values - np.median(values, axis=0))
    return np.asarray(_MAD_TO_SIGMA * np.median(off, axis=0))
