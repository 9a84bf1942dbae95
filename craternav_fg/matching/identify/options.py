"""Options of identification."""

from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.view import CENTRE_SHARE, SIZE_SHARE
from craternav_fg.resection.intrinsics import FOCAL_SIGMA, PRINCIPAL_SIGMA_PX, IntrinsicsPrior
from factors.arrays import FloatArray

# Altitudes that are searched for craters of kilometres. Smaller ones are seen from lower: the smallest crater
# of the catalogue must fit so many times into the image's shorter side, as several must be seen; and the
# largest must have this radius, px, to be found.
_ALTITUDES_M = (1e3, 2e6)
_RADII_ACROSS, _LEAST_RADIUS_PX = 8.0, 2.0


class Effort(Enum):
    """How a search is done: each kind finds poses that those before it miss, and takes longer."""

    PLAIN = auto()
    """The nearest triples of the index are examined."""
    WIDE = auto()
    """Very many triples are examined, of which the best by narrow gates are expanded."""
    DEEP = auto()
    """As the first, with candidates multiplied by the millions of triples in the index, and by pairs."""


@dataclass(frozen=True)
class IdentifyOptions:
    """Extent of the search, and the evidence that an answer needs.

    Attributes
    ----------
    altitudes_m : tuple of float or None
        Lowest and highest altitude above the reference sphere that are searched; None for those from which
        the catalogue's craters can be identified.
    noise_levels_px : tuple of float
        Standard deviations of the rims' centres that are assumed, one after the other, until one gives an
        answer.
    candidates : tuple of int
        Triples of craters that are examined per triple of rims, for each noise level.
    size_factors : tuple of float
        Sizes of rims in the image over those on the map, tried one after the other until one gives an answer.
        People trace real rims inside the crests that images show: 5 to 15 % smaller.
    fine_size_factors : tuple of float
        Those with which a promising pose is expanded again. None are tried if there are none.
    size_sigma_share : float
        Relative standard deviation of the sizes beside the noise, before it is estimated: irregular outlines,
        and the map's ellipses or circles.
    centre_share : float
        Standard deviation of the centres beside the noise: the noise times this times the radius, px.
    effort : Effort
        More than the first is for rims to which a plain search gave no answer. Nothing is searched where that
        would be the same: in an index of few triples, or with a known attitude.
    triples : int
        Largest number of rim triples that are looked up per noise level and estimate of the vertical. A
        quarter of it is used for verticals beside the best estimate. If nothing is found, as many again are
        looked up with the best estimate.
    tried : int
        Largest number of pairs of a rim and a crater that are tried with a known attitude. It bounds the
        computing time with a large catalogue.
    log_chance : float
        Natural logarithm of the largest probability that an answer arose by chance.
    log_chance_attitude : float
        The same with a known attitude.
    log_ambiguity : float
        A second pose is ignored when its evidence is lower by more than this (a negative logarithm);
        otherwise the result is ambiguous.
    focal_sigma_share : float
        Relative standard deviation of the camera's focal length; 0 for an exact one, which is not checked.
    principal_sigma_px : float
        Standard deviation of each coordinate of the principal point; 0 for an exact one.
    focal_stated : bool
        Whether the user has stated `focal_sigma_share`: then no warning says that the rims cannot check it.
    """

    altitudes_m: tuple[float, float] | None = None
    noise_levels_px: tuple[float, ...] = (1.0, 3.0, 6.0)
    candidates: tuple[int, ...] = (16, 48, 160)
    size_factors: tuple[float, ...] = (1.0,)
    fine_size_factors: tuple[float, ...] = ()
    size_sigma_share: float = SIZE_SHARE
    centre_share: float = CENTRE_SHARE
    effort: Effort = Effort.PLAIN
    triples: int = 96
    tried: int = 3_000_000
    log_chance: float = float(np.log(1e-6))
    log_chance_attitude: float = float(np.log(1e-4))
    log_ambiguity: float = float(np.log(1e-3))
    focal_sigma_share: float = FOCAL_SIGMA
    principal_sigma_px: float = PRINCIPAL_SIGMA_PX
    focal_stated: bool = False

    @classmethod
    def of(cls, camera: Camera, altitudes_m: tuple[float, float] | None = None) -> "IdentifyOptions":
        """Make options with what a camera states of its intrinsics.

        Parameters
        ----------
        camera : Camera
        altitudes_m : (float, float), optional
            As the attribute.

        Returns
        -------
        IdentifyOptions
        """
        prior = IntrinsicsPrior.of(camera)
        return cls(
            altitudes_m,
            focal_sigma_share=prior.focal_sigma_share,
            principal_sigma_px=prior.principal_sigma_px,
            focal_stated=prior.focal_stated,
        )

    def searched_m(self, camera: Camera, radius_m: FloatArray) -> tuple[float, float]:
        """Compute the altitudes that are searched.

        Parameters
        ----------
        camera : Camera
        radius_m : ndarray, shape (n,)
            Mean radii of the catalogue's craters, or of the smallest and the largest, m.

        Returns
        -------
        tuple of float
            Lowest and highest, m: `altitudes_m`, or from 1 km or the lowest from which the smallest crater
            fits well into the image, to 2000 km or the highest from which the largest is seen.
        """
        if self.altitudes_m is not None:
            return self.altitudes_m
        side_px = min(camera.width_px, camera.height_px)
        low_m = float(radius_m.min()) * camera.focal_px * _RADII_ACROSS / side_px
        high_m = float(radius_m.max()) * camera.focal_px / _LEAST_RADIUS_PX
        return min(low_m, _ALTITUDES_M[0]), min(high_m, _ALTITUDES_M[1])
