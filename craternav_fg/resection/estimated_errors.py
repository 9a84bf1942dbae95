"""Standard deviations of a catalogue that states none, as the rims of a descent show them."""

from dataclasses import dataclass, fields, replace

import numpy as np

from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from factors.arrays import FloatArray

# Standard deviations below these are not told.
_NEGLIGIBLE_M, _NEGLIGIBLE_SHARE, _NEGLIGIBLE_RAD = 0.05, 5e-4, 2e-3


@dataclass(frozen=True)
class EstimatedErrors:
    """Standard deviations of a map: those of places and heights are constant in part, in part they grow.

    Attributes
    ----------
    place_m, place_share : float
        Of a rim's centre, per axis along the ground: m, and share of the radius; both together.
    size_share : float
        Of each semi-axis, as a share of itself.
    height_m, height_share : float
        Of the height of a rim's plane, likewise: an elevation model smooths small and large rims.
    tilt_rad : float
        Of either slope of a rim's plane, beside what the covariances of the rims hold; 0 where the catalogue
        states the slopes, or the other errors explain the rims as well.
    """

    place_m: float
    place_share: float
    size_share: float
    height_m: float
    height_share: float
    tilt_rad: float

    def of(self, catalog: Catalog) -> MapErrors:
        """Return the errors of all craters of a catalogue, but for the slopes.

        Parameters
        ----------
        catalog : Catalog

        Returns
        -------
        MapErrors
        """
        radius_m = radii_m(catalog)
        place_m = np.hypot(self.place_m, self.place_share * radius_m)
        height_m = np.hypot(self.height_m, self.height_share * radius_m)
        return MapErrors(place_m, np.full(len(catalog), self.size_share), height_m)

    def of_heights(self, catalog: Catalog) -> FloatArray | None:
        """Return the standard deviations of the heights of a catalogue.

        Parameters
        ----------
        catalog : Catalog

        Returns
        -------
        ndarray, shape (n,), or None
            m; None where they are negligible.
        """
        height_m = self.of(catalog).height_m
        return height_m if np.median(height_m) > _NEGLIGIBLE_M else None

    def common_shift(self, catalog: Catalog) -> CommonShift | None:
        """Return the shift of a catalogue with the height error that its craters may have in common.

        Rims of one image show how their heights scatter about what they have in common, but not the latter:
        a pose is higher by it. What makes heights wrong (a column of zeros, another unit, a coarse elevation
        model) makes all wrong alike, at least by as much as they scatter.

        Parameters
        ----------
        catalog : Catalog

        Returns
        -------
        CommonShift or None
            What the catalogue itself states, or what is in its covariance as its heights are unknown, stays.
        """
        shift, height_m = catalog.common_shift, self.of_heights(catalog)
        if not catalog.has_heights or height_m is None:
            return shift
        shift = shift or CommonShift.unknown(len(catalog))
        return replace(shift, height_m=np.where(np.isnan(shift.height_m), height_m, shift.height_m))

    def scaled(self, factor: float) -> "EstimatedErrors":
        """Multiply all standard deviations by a factor, but for that of slopes, which move no centre.

        Parameters
        ----------
        factor : float
        """
        every = {one.name: factor * getattr(self, one.name) for one in fields(self)}
        return EstimatedErrors(**every | {"tilt_rad": self.tilt_rad})

    def exceed(self, others: "EstimatedErrors", factor: float) -> bool:
        """Whether one of the standard deviations is larger than another estimate by a factor.

        Parameters
        ----------
        others : EstimatedErrors
        factor : float

        Returns
        -------
        bool
        """
        return any(
            getattr(self, one.name) > factor * max(getattr(others, one.name), _negligible(one.name))
            for one in fields(self)
        )

    @property
    def words(self) -> str:
        """The standard deviations that are not negligible, in words."""
        told = []
        for what, names, after in (
            ("places", ("place_m", "place_share"), " per axis"),
            ("semi-axes", ("size_share",), ""),
            ("heights", ("height_m", "height_share"), ""),
            ("slopes of planes", ("tilt_rad",), ""),
        ):
            sizes = [(name, getattr(self, name)) for name in names]
            parts = [_in_words(name, size) for name, size in sizes if size > _negligible(name)]
            if parts:
                told.append(f"{what} {' and '.join(parts)}{after}")
        return ", ".join(told)

    @property
    def tilted(self) -> bool:
        """Whether planes slope by more than is negligible."""
        return self.tilt_rad > _NEGLIGIBLE_RAD


def _negligible(name: str) -> float:
    if name == "tilt_rad":
        return _NEGLIGIBLE_RAD
    return _NEGLIGIBLE_M if name.endswith("_m") else _NEGLIGIBLE_SHARE


def _in_words(name: str, sigma: float) -> str:
    if name == "tilt_rad":
        return f"{sigma:.2g} rad"
    if name.endswith("_m"):
        return f"{sigma:.2g} m" if sigma < 99.5 else f"{sigma:.0f} m"
    return f"{100.0 * sigma:.2g} %" + ("" if name == "size_share" else " of the radius")


def radii_m(catalog: Catalog) -> FloatArray:
    """Geometric means of the semi-axes.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n,)
        m.
    """
    return np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
