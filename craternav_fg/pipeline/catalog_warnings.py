"""Warnings of a catalogue, and of the body that it lies on: units, entries that occur twice, errors."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from craternav_fg.catalogs.bodies import SAME_SPHERE, SPHERES_M, known_name
from craternav_fg.catalogs.model import Catalog
from craternav_fg.importing.bodies import known_mu_m3_s2, known_spin_rad_s
from craternav_fg.pipeline.input_warnings import listed

if TYPE_CHECKING:
    # The commands for one image name their mounting here, and detect nothing.
    from craternav_fg.pipeline.map_scale import Growth
    from craternav_fg.resection.estimated_errors import EstimatedErrors
    from craternav_fg.resection.shifted_group import ShiftedGroup

# Share by which gravity and spin of a known body may differ from what is known: sources differ by less.
_SAME_MOTION = 0.005
# Heights of rims on a body of that radius scatter by hundreds of metres: fewer craters than these may lie on
# one level, and heights below the limit are in another unit.
_LARGE_BODY_M, _MIN_HEIGHTS, _LOW_HEIGHT_M = 1e5, 8, 12.0
# So many craters that come so near to both poles, and reach so far around the body, in radians, but not
# beyond by more than a digit.
_MIN_PLACES, _NEAR_POLES, _AROUND, _DIGIT = 20, 1.1, 5.5, 1e-3
# Growth of rims, in standard deviations, that is told. On right data it was within 1.2 where rims are given,
# and within 3.7 in images of another renderer.
_MAX_GROWTH_SIGMAS = 6.0
# Logarithm of the ratio of densities, halfway between its means: 0.1 on a whole body, -0.24 in a region.
_EVEN_DENSITY = -0.07


def repeated_craters(names: Sequence[str]) -> list[str]:
    """Warn of craters that the catalogue has twice.

    Parameters
    ----------
    names : sequence of str
        See `Dataset.repeated_craters`.

    Returns
    -------
    list of str
    """
    if not names:
        return []
    return [
        f"the catalogue has craters twice: {listed(names)} are left out, as earlier rows have nearly the "
        "same places and sizes (`craternav catalog merge` merges tables)"
    ]


def unusual_body(catalog: Catalog) -> list[str]:
    """Warn of a body that is known by name, and stated with another sphere, gravity or spin.

    Nothing in the images contradicts a wrong sphere: heights and the whole trajectory move with it.

    Parameters
    ----------
    catalog : Catalog
        On the body of `dataset.toml`.

    Returns
    -------
    list of str
    """
    body, name = catalog.body, known_name(catalog.body.name)
    if name is None:
        return []
    sphere_m, mu, spin = SPHERES_M[name], known_mu_m3_s2(name), known_spin_rad_s(name)
    found = []
    if not catalog.sphere_stated and abs(body.radius_m - sphere_m) > SAME_SPHERE * sphere_m:
        found.append(
            f"radius_m of [body] is {body.radius_m:.9g}, but that of maps and heights of {name} "
            f"{sphere_m:.9g}: if the catalogue's heights refer to the latter, all positions are wrong by the "
            "difference; a column BODY_RADIUS_M in the catalogue says to which"
        )
    if mu and abs(body.mu_m3_s2 - mu) > _SAME_MOTION * mu:
        found.append(f"mu_m3_s2 of [body] is {body.mu_m3_s2:.6g}, but that of {name} {mu:.6g}")
    if spin and math.dist(body.spin_rad_s, (0.0, 0.0, spin)) > _SAME_MOTION * abs(spin):
        stated = ", ".join(f"{one:.6g}" for one in body.spin_rad_s)
        found.append(f"spin_rad_s of [body] is [{stated}], but that of {name} [0, 0, {spin:.6g}]")
    return found


def heights_in_km(catalog: Catalog) -> list[str]:
    """Warn of rim heights that are far below those of any large body.

    Nothing else shows it where rims are measured in images: those that fit the wrong heights are used.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    list of str
    """
    if not catalog.has_heights or len(catalog) < _MIN_HEIGHTS or catalog.body.radius_m < _LARGE_BODY_M:
        return []
    highest_m = float(np.abs(catalog.height_m).max())
    if not 0.0 < highest_m < _LOW_HEIGHT_M:
        return []
    return [
        f"RIM_HEIGHT_M of the catalogue is at most {highest_m:.2g} m above or below the sphere: expected "
        "metres, is it in kilometres?"
    ]


def scaled_map(growth: "Growth | None") -> list[str]:
    """Warn of rims whose sizes contradict the distances between them.

    Parameters
    ----------
    growth : Growth or None
        See `map_scale.growth_of_rims`.

    Returns
    -------
    list of str
    """
    if growth is None or abs(growth.share) < _MAX_GROWTH_SIGMAS * growth.sigma_share:
        return []
    percent, sigma = 100.0 * abs(growth.share), 100.0 * growth.sigma_share
    return [
        f"the rims are {percent:.2g} +- {sigma:.1g} % {'larger' if growth.share > 0.0 else 'smaller'} than "
        "their craters from where the distances between them put the camera: check the scale of the "
        "catalogue's places (the radius and the projection that they were made with) and its diameters; "
        "if the places are wrong, so are the distances to the ground, by as much"
    ]


def unstated_map_errors(catalog: Catalog, contradicted: bool, tenth_px_m: float) -> list[str]:
    """Tell that the catalogue counts as exact, where images or other sensors contradict its craters.

    Parameters
    ----------
    catalog : Catalog
    contradicted : bool
        Whether rims are missing, left out or contradict other sensors.
    tenth_px_m : float
        A tenth of a pixel on the ground: a rim is measured to about as much.

    Returns
    -------
    list of str
    """
    if not contradicted or catalog.errors is not None:
        return []
    return [
        "the catalogue states no errors and counts as exact, which alone can cause the warnings of rims, of "
        f"the IMU and of frames without rims: unless its places and heights are known to {tenth_px_m:.1g} m "
        "(a tenth of a pixel), state PLACE_SIGMA_M, SIZE_SIGMA_SHARE and RIM_HEIGHT_SIGMA_M"
    ]


def assumed_map_errors(errors: "EstimatedErrors | None", catalog: Catalog) -> list[str]:
    """Tell which errors were assumed of a catalogue that states none.

    Parameters
    ----------
    errors : EstimatedErrors or None
    catalog : Catalog

    Returns
    -------
    list of str
    """
    if errors is None:
        return []
    common = ""
    if catalog.has_heights and errors.of_heights(catalog) is not None:
        # Without heights another warning tells what they may have in common.
        common = " (and as much of all heights together, unless COMMON_HEIGHT_SIGMA_M states it)"
    slopes = ", and the slopes (PLANE_TILT_EAST_DEG, PLANE_TILT_NORTH_DEG)" if errors.tilted else ""
    return [
        "the catalogue states no errors, but the rims of single images contradict it at every pose: standard "
        f"deviations with which they agree were assumed, {errors.words}{common}; state PLACE_SIGMA_M, "
        f"SIZE_SIGMA_SHARE and RIM_HEIGHT_SIGMA_M{slopes} if you know better"
    ]


def shifted_craters(group: "ShiftedGroup | None", catalog: Catalog) -> list[str]:
    """Warn of craters that are displaced alike against the others.

    Parameters
    ----------
    group : ShiftedGroup or None
    catalog : Catalog

    Returns
    -------
    list of str
    """
    if group is None:
        return []
    names = listed([catalog.identifiers[row] for row in group.rows.tolist()])
    return [
        f"{group.seen} of {group.of} craters that rims show are displaced alike against the others, by "
        f"{group.shift_m:.3g} m towards {group.bearing_deg:.0f} deg (from north over east): {names}. Both "
        "were moved by half of it, and as much is in the covariances of positions: are they from another "
        "source? Correct their places, or state COMMON_SOURCE and COMMON_PLACE_SIGMA_M"
    ]


def wrong_craters(frames: Mapping[str, int]) -> list[str]:
    """Warn of craters that contradict all others.

    Parameters
    ----------
    frames : mapping of str to int
        By the crater's name, in how many frames.

    Returns
    -------
    list of str
    """
    if not frames:
        return []
    names = [f"{name} ({count} frames)" for name, count in frames.items()]
    return [
        f"the rims of {listed(names)} are outliers (beyond 7 sigma) where the others agree, and left out: "
        "are they those of other craters, or is the catalogue wrong there?"
    ]


def angles_in_radians(catalog: Catalog) -> list[str]:
    """Warn of places that cover the whole body if they are in radians, and a few degrees as they are read.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    list of str
    """
    if len(catalog) < _MIN_PLACES:
        return []
    latitude, longitude = np.degrees(catalog.latitude_rad), np.degrees(catalog.longitude_rad)
    east = (longitude + 180.0) % 360.0 - 180.0
    west, far = float(east.min()), float(east.max())
    around = (west >= -_DIGIT and far <= 2.0 * math.pi + _DIGIT) or max(-west, far) <= math.pi + _DIGIT
    south, north = float(latitude.min()), float(latitude.max())
    highest = 0.5 * math.pi + _DIGIT
    if (
        not around
        or far - west < _AROUND
        or not (-highest < south < -_NEAR_POLES and _NEAR_POLES < north < highest)
    ):
        return []
    # On a whole body few craters are near the poles; in a small region their density is even. This is the
    # logarithm of the ratio of both densities.
    density = np.log(np.maximum(0.5 * np.cos(latitude), _DIGIT) * (north - south))
    if density.mean() < _EVEN_DENSITY:
        return []
    return [
        f"the catalogue's latitudes are {south:.3g} to {north:.3g} deg, its longitudes {west:.3g} to "
        f"{far:.3g} deg: expected degrees, are they in radians?"
    ]
