"""What the commands on catalogues print of one: its place, sizes, shapes and overlaps."""

from typing import Any

import numpy as np

from craternav_fg.catalogs.checks import Overlaps
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.terminal import say, three_digits

# Skipped rows and pairs that JSON lists at the most; files can hold thousands.
MAX_LISTED = 20
# Pairs that are printed at the most.
_MAX_PRINTED = 5
# Craters without a wider gap of longitudes between them lie all around the body.
_MIN_GAP_DEG = 20.0
# Stands for an unknown standard deviation, as NaN is not equal to itself.
_UNKNOWN = -1.0
# Of the diameters: smallest, median, largest, and the interval that holds 90 %.
_QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


def summarise(catalog: Catalog, overlaps: Overlaps, body_by: str) -> dict[str, Any]:
    """Describe a catalogue by numbers and texts that JSON can carry.

    Parameters
    ----------
    catalog : Catalog
    overlaps : Overlaps
        Overlaps of its craters.
    body_by : str
        What the body is known by, see `ImportReport`.

    Returns
    -------
    dict
    """
    diameter_km = 2e-3 * catalog.semi_major_m
    first = overlaps.duplicates[:MAX_LISTED]
    apart_km = 1e-3 * catalog.distance_m(first[:, 0], first[:, 1])
    return {
        "craters": len(catalog),
        "body": catalog.body.name,
        "body_radius_m": catalog.body.radius_m,
        "body_by": body_by or "assumed",
        "diameter_km_quantiles": dict(
            zip(map(str, _QUANTILES), np.quantile(diameter_km, _QUANTILES).tolist(), strict=True)
        ),
        "latitude_deg": np.degrees([catalog.latitude_rad.min(), catalog.latitude_rad.max()]).tolist(),
        "longitude_deg": _longitudes_deg(catalog),
        "circles": int(np.count_nonzero(catalog.semi_major_m == catalog.semi_minor_m)),
        "heights": catalog.has_heights,
        "height_m": [float(catalog.height_m.min()), float(catalog.height_m.max())],
        "plane_slope_deg": _slopes_deg(catalog),
        "errors": _errors(catalog),
        "crossed_rims": len(np.unique(overlaps.crossings)),
        "duplicates": len(overlaps.duplicates),
        "first_duplicates": [[catalog.identifiers[row] for row in pair] for pair in first.tolist()],
        "first_duplicates_km": np.column_stack([2e-3 * catalog.semi_major_m[first], apart_km]).tolist(),
    }


def show(values: dict[str, Any]) -> None:
    """Print what `summarise` gives.

    Parameters
    ----------
    values : dict
    """
    name = {"": "a body", "Moon": "the Moon"}.get(values["body"], values["body"])
    by = {"given": "as given", "assumed": "by default"}.get(values["body_by"], f"as {values['body_by']}")
    say(f"{values['craters']:,} craters of {name}, sphere of {1e-3 * values['body_radius_m']:g} km {by}")
    least, low, median, high, largest = (three_digits(v) for v in values["diameter_km_quantiles"].values())
    say(f"  diameters   {least} to {largest} km; median {median} km, 90 % from {low} to {high} km")
    ellipses = values["craters"] - values["circles"]
    say(f"  shapes      {ellipses:,} ellipses, {values['circles']:,} circles")
    west, east = values["longitude_deg"]
    (south, north), (bottom, top) = values["latitude_deg"], values["height_m"]
    say(f"  latitudes   {south:.2f} to {north:.2f} deg")
    around = east - west == 360.0
    say("  longitudes  all around" if around else f"  longitudes  {west:.2f} to {east:.2f} deg, eastwards")
    heights = "none: all on the sphere"
    if values["heights"]:
        heights = f"{three_digits(bottom)} to {three_digits(top)} m above the sphere"
    say(f"  rim heights {heights}")
    if values["plane_slope_deg"] is not None:
        median, steepest = map(three_digits, values["plane_slope_deg"])
        say(f"  rim planes  slopes of {median} deg in the median, at most {steepest} deg")
    for line in _told(values["errors"], has_heights=values["heights"]):
        say(line)
    say(f"  crossings   {values['crossed_rims']:,} craters whose rim crosses another's")
    if not values["duplicates"]:
        say("  duplicates  no pairs that are probably one crater entered twice")
        return
    say(f"  duplicates  {values['duplicates']:,} pairs that are probably one crater entered twice")
    pairs = list(zip(values["first_duplicates"], values["first_duplicates_km"], strict=True))
    for (one, other), (large, small, apart) in pairs[:_MAX_PRINTED]:
        say(f"              {one} and {other}: {large:.3g} and {small:.3g} km, {apart:.2g} km apart")
    if values["duplicates"] > _MAX_PRINTED:
        more = values["duplicates"] - _MAX_PRINTED
        say(f"              and {more:,} more (--pairs FILE.csv writes them all)")


def _slopes_deg(catalog: Catalog) -> list[float] | None:
    """Median and largest slope of the rims' planes; None where all are level."""
    if catalog.plane_tilt_rad is None:
        return None
    slopes = np.degrees(np.arctan(np.linalg.norm(np.tan(catalog.plane_tilt_rad), axis=1)))
    return [float(np.median(slopes)), float(slopes.max())]


def _errors(catalog: Catalog) -> dict[str, Any]:
    """Medians of the standard deviations that the catalogue states; empty where it states none."""
    found: dict[str, Any] = {}
    own, shift = catalog.errors, catalog.common_shift
    if own is not None:
        found |= {
            "place_sigma_m": float(np.median(own.place_m)),
            "size_sigma_share": float(np.median(own.size_share)),
            "height_sigma_m": float(np.median(own.height_m)),
        }
    if shift is not None:
        sigmas = np.nan_to_num(np.stack([shift.place_m, shift.height_m]), nan=_UNKNOWN)
        sources, counts = np.unique(np.vstack([shift.source, sigmas]), axis=1, return_counts=True)
        found["common_shift"] = [
            {
                "craters": int(count),
                "source": int(source),
                "place_sigma_m": None if place == _UNKNOWN else float(place),
                "height_sigma_m": None if height == _UNKNOWN else float(height),
            }
            for source, place, height, count in zip(*sources, counts, strict=True)
        ]
    return found


def _told(errors: dict[str, Any], *, has_heights: bool) -> list[str]:
    lines = []
    if "place_sigma_m" not in errors:
        exact = "places, sizes and heights" if has_heights else "places and sizes"
        lines.append(f"  errors      none of each crater: {exact} are exact, unless rims show otherwise")
    else:
        lines.append(
            f"  errors      each crater: place {errors['place_sigma_m']:.0f} m, size "
            f"{100.0 * errors['size_sigma_share']:.1f} %, height {errors['height_sigma_m']:.0f} m (medians)"
        )
    shared = errors.get("common_shift", [])
    lines += [
        f"              {_whose(one, alone=len(shared) == 1)}: place {_metres(one['place_sigma_m'])}, height "
        f"{_metres(one['height_sigma_m'])}"
        for one in shared[:_MAX_PRINTED]
    ]
    return lines


def _whose(shift: dict[str, Any], *, alone: bool) -> str:
    """Say which craters are displaced together."""
    which = "all craters" if alone else f"the {shift['craters']:,} craters of source {shift['source']}"
    return f"shift of {which} together"


def _metres(sigma: float | None) -> str:
    return "not stated" if sigma is None else f"{sigma:.0f} m"


def _longitudes_deg(catalog: Catalog) -> list[float]:
    """First and, eastwards, last longitude, 0 to 360; 0 and 360 for craters all around the body."""
    sorted_deg = np.sort(np.mod(np.degrees(catalog.longitude_rad), 360.0))
    gaps_deg = np.diff(np.append(sorted_deg, sorted_deg[0] + 360.0))
    widest = int(np.argmax(gaps_deg))
    if gaps_deg[widest] < _MIN_GAP_DEG:
        return [0.0, 360.0]
    return [float(sorted_deg[(widest + 1) % len(sorted_deg)]), float(sorted_deg[widest])]
