"""Rims of a catalogue corrected by errors that a smoother has estimated from the images of a descent.

The smoother estimates each crater's six errors beside the poses; the marginal covariances contain what the
poses leave uncertain. Poses are relative to the map: a shift that all craters share moves the whole
trajectory, and no image shows it. The catalogue's common shift therefore stays as it is stated.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from factors.arrays import FloatArray

# A correction beyond so many of the catalogue's standard deviations is that of another crater or a wrong rim.
_MAX_SIGMAS = 5.0
# The same where the catalogue states no errors, in radii.
_MAX_RADII = 0.5
# Corrected craters that show how far the others may be off, where the catalogue does not say; with fewer, a
# share of the radius as that of published circles, for places, heights and sizes.
_LEAST_CRATERS = 5
_UNKNOWN = 0.1


class RunOutcome(StrEnum):
    """What has become of a crater."""

    REFINED = "refined"
    NOT_SEEN = "not seen in the images"
    TOO_FAR = "the correction is beyond the catalogue's errors"


@dataclass(frozen=True)
class CorrectedRims:
    """A catalogue with corrected rims.

    Attributes
    ----------
    catalog : Catalog
        Corrected rims with the errors that are left, the others as they were.
    outcomes : tuple of RunOutcome, length n
    shift_m : ndarray, shape (n, 3)
        Shift of the centre in l: along the rim's major and minor axis, and its normal; NaN where a rim is not
        corrected.
    sigma_m : ndarray, shape (n, 3)
        Standard deviation of the corrected centre, in l.
    """

    catalog: Catalog
    outcomes: tuple[RunOutcome, ...]
    shift_m: FloatArray
    sigma_m: FloatArray

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return the columns that a store keeps beside the catalogue.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            `outcome`; the others in the units of their names.
        """
        out: dict[str, npt.NDArray[Any]] = {"outcome": np.array([one.value for one in self.outcomes])}
        for k, axis in enumerate(("major", "minor", "normal")):
            out[f"shift_{axis}_m"], out[f"shift_{axis}_sigma_m"] = self.shift_m[:, k], self.sigma_m[:, k]
        return out

    def counts(self) -> dict[str, int]:
        """Count the craters of each outcome.

        Returns
        -------
        dict of str to int
            By what the outcome says.
        """
        found = Counter(self.outcomes)
        return {outcome.value: found[outcome] for outcome in RunOutcome if found[outcome]}


def apply_errors(catalog: Catalog, errors: Mapping[int, tuple[FloatArray, FloatArray]]) -> CorrectedRims:
    """Correct the rims of a catalogue.

    Parameters
    ----------
    catalog : Catalog
    errors : mapping of int to (ndarray, ndarray), shape (6,) each
        See `trajectory.Calibrated.map_errors`: by row, true minus map, and standard deviations; in units of
        the mean radius.

    Returns
    -------
    CorrectedRims
    """
    n = len(catalog)
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    shift_m, sigma_m = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    outcomes = [RunOutcome.NOT_SEEN] * n
    values = {
        name: getattr(catalog, name).copy()
        for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m")
    }
    if catalog.plane_tilt_rad is not None:
        values["plane_tilt_rad"] = catalog.plane_tilt_rad.copy()
    stated = catalog.errors or MapErrors.zeros(n)
    left = [array.copy() for array in (stated.place_m, stated.size_share, stated.height_m)]
    limits = _limits(catalog, radius_m)
    for row, (error, sigma) in sorted(errors.items()):
        if np.any(np.abs(error) > limits[row]):
            outcomes[row] = RunOutcome.TOO_FAR
            continue
        outcomes[row] = RunOutcome.REFINED
        shift_m[row], sigma_m[row] = radius_m[row] * error[:3], radius_m[row] * sigma[:3]
        for name, value in _corrected(catalog, row, radius_m[row], error).items():
            values[name][row] = value
        left[0][row], left[1][row] = radius_m[row] * _rms(sigma[:2]), _rms(sigma[[3, 5]])
        left[2][row] = sigma_m[row, 2]
    done = np.isfinite(shift_m[:, 0])
    if catalog.errors is None and done.any():
        corrected = np.array([errors[row] for row in np.flatnonzero(done).tolist()])
        place, height, size = (_of_others(corrected[:, :, part]) for part in ([0, 1], [2], [3, 5]))
        shown = (place * radius_m, np.full(n, size), height * radius_m)
        for array, values_of_all in zip(left, shown, strict=True):
            array[~done] = values_of_all[~done]
    refined = replace(catalog, **values, errors=MapErrors(*left) if done.any() else catalog.errors)
    return CorrectedRims(refined, tuple(outcomes), shift_m, sigma_m)


def _of_others(corrected: FloatArray) -> float:
    """Estimate how large errors are, of which some were estimated, with standard deviations (n, 2, m).

    An estimate that shrinks to its prior keeps the prior's variance in its own. Two degrees of freedom less:
    the mean of what the variance may be, and not its likeliest value.
    """
    if len(corrected) < _LEAST_CRATERS:
        return _UNKNOWN
    return float(np.sqrt(np.sum(corrected**2) / (corrected[:, 0].size - 2)))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _limits(catalog: Catalog, radius_m: FloatArray) -> FloatArray:
    """Largest plausible errors (n, 6), in radii."""
    if catalog.errors is None:
        return np.full((len(catalog), 6), _MAX_RADII)
    return _MAX_SIGMAS * np.sqrt(catalog.errors.variances(radius_m))


def _corrected(catalog: Catalog, row: int, radius_m: float, error: FloatArray) -> dict[str, Any]:
    """Return the columns of one corrected rim."""
    gRl = catalog.gRl[row]
    centre = catalog.centres[row] + radius_m * gRl @ error[:3]
    stretch = np.eye(2) + np.array([[error[3], error[4]], [error[4], error[5]]])
    axes, sizes, _ = np.linalg.svd(stretch @ np.diag([catalog.semi_major_m[row], catalog.semi_minor_m[row]]))
    latitude, longitude = frames.latitude_longitude(centre)
    # In the directions at the old centre; those at the new one differ from them, near a pole very much so.
    turned = catalog.angle_rad[row] + np.arctan2(axes[1, 0], axes[0, 0])
    here = frames.east_north_up(catalog.latitude_rad[row], catalog.longitude_rad[row])[:, :2]
    there = frames.east_north_up(latitude, longitude)[:, :2]
    east, north = there.T @ here @ [np.cos(turned), np.sin(turned)]
    corrected = {
        "latitude_rad": float(latitude),
        "longitude_rad": float(longitude),
        "height_m": float(np.linalg.norm(centre) - catalog.body.radius_m),
        "semi_major_m": float(sizes[0]),
        "semi_minor_m": float(sizes[1]),
        "angle_rad": float(np.remainder(np.arctan2(north, east), np.pi)),
    }
    if catalog.plane_tilt_rad is not None:
        slope = there.T @ here @ np.tan(catalog.plane_tilt_rad[row])
        corrected["plane_tilt_rad"] = np.arctan(slope)
    return corrected
