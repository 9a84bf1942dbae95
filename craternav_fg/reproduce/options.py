"""What can be changed about the reproduction."""

from dataclasses import dataclass

from craternav_fg.errors import CraternavError
from craternav_fg.simulation.flat_scenes import SEMI_AXES_M

# No ellipse fit is of use on arcs shorter than about a third of the rim.
LEAST_ARC = 0.35
# From higher up rims have semi-axes under 3 px, and ellipses of their points fail.
HIGHEST_KM_OF_SEMI_AXIS_M = 0.4


@dataclass(frozen=True)
class ReproduceOptions:
    """Set-up of the reproduction; the defaults are the paper's.

    Attributes
    ----------
    craters : int
        Of figs. 11 and 12; figs. 13 and 14 are of two.
    altitudes_km : tuple of float
        Lowest and highest altitude of figs. 11 to 14; at most 0.4 km for each metre of the least semi-axis.
    altitude_steps : int
        Altitudes from the one to the other.
    semi_axes_m : tuple of float
        Least and largest semi-axis of the rims of figs. 11 to 14.
    noise_px : float
        Standard deviation of each coordinate of an edge point.
    points : tuple of int
        Range of the number of edge points of a rim: the paper's "length of the crater edge".
    arc : float
        Part of the rim that the points cover, of 1.
    trials : int
        At each altitude, and triples of craters at each point of fig. 3.
    images : int
        From each altitude of table 2, and a measure of the other sets of rendered images.
    descents : int
        Trials of figs. 17 and 18, each with a terrain of its own; figs. 15 and 16 show the first.
    seed : int
    workers : int
        Processes.
    """

    craters: int = 3
    altitudes_km: tuple[float, float] = (10.0, 100.0)
    altitude_steps: int = 10
    semi_axes_m: tuple[float, float] = SEMI_AXES_M
    noise_px: float = 1.0
    points: tuple[int, int] = (10, 100)
    arc: float = 1.0
    trials: int = 100
    images: int = 128
    descents: int = 30
    seed: int = 1
    workers: int = 2

    def __post_init__(self) -> None:
        low, high = self.altitudes_km
        least_m, largest_m = self.semi_axes_m
        highest = HIGHEST_KM_OF_SEMI_AXIS_M * least_m
        checks = (
            (self.craters >= 3, f"craters: expected 3 or more, found {self.craters}"),
            (
                0.0 < least_m <= largest_m,
                f"semi-axes: expected 0 < least <= largest, found {least_m:g} {largest_m:g} m",
            ),
            (
                0.0 < low <= high <= highest,
                f"altitudes: expected 0 < low <= high <= {highest:g} km, found {low:g} {high:g}: from "
                f"higher up the smallest rims, of {least_m:g} m, have too few pixels",
            ),
            (self.altitude_steps >= 1, f"altitude steps: expected 1 or more, found {self.altitude_steps}"),
            (
                0.0 < self.noise_px <= 10.0,
                f"noise: expected more than 0, at most 10 px, found {self.noise_px:g}",
            ),
            (8 <= self.points[0] <= self.points[1], f"points: expected 8 or more, found {self.points}"),
            (
                LEAST_ARC <= self.arc <= 1.0,
                f"arc: expected {LEAST_ARC:g} to 1 of the rim, found {self.arc:g}: "
                "no ellipse can be fitted to a shorter one",
            ),
            (self.trials >= 2, f"trials: expected 2 or more, found {self.trials}"),
            (self.images >= 2, f"images: expected 2 or more, found {self.images}"),
            (self.descents >= 2, f"descents: expected 2 or more, found {self.descents}"),
            (self.seed >= 0, f"seed: expected 0 or more, found {self.seed}"),
            (self.workers >= 1, f"workers: expected 1 or more, found {self.workers}"),
        )
        for good, problem in checks:
            if not good:
                raise CraternavError(problem)
