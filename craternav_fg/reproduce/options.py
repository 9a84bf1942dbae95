"""Options of the reproduction; the defaults are the paper's set-up."""

from dataclasses import dataclass

from craternav_fg.errors import CraternavError
from craternav_fg.simulation.flat_scenes import SEMI_AXES_M

# Shortest arc, as a share of the rim: on shorter ones ellipse fits have errors as large as the rim.
LEAST_ARC = 0.35
# Highest altitude over the smallest semi-axis: it then spans about 3 px, the least that an ellipse fit takes.
MAX_ALTITUDE_KM_PER_M = 0.4
MAX_NOISE_PX = 10.0
# A fitted ellipse has five unknowns; fewer points leave too little redundancy.
MIN_EDGE_POINTS = 8


@dataclass(frozen=True)
class ReproduceOptions:
    """Set-up of the reproduction.

    Attributes
    ----------
    craters : int
        Number in figs. 11 and 12; figs. 13 and 14 have two.
    altitudes_km : tuple of float
        Lowest and highest altitude of figs. 11 to 14; at most 0.4 km per metre of the smallest semi-axis.
    altitude_steps : int
        Number of altitudes.
    semi_axes_m : tuple of float
        Smallest and largest semi-axis of the rims of figs. 11 to 14.
    noise_px : float
        Standard deviation of each coordinate of an edge point.
    points : tuple of int
        Smallest and largest number of edge points of a rim: the paper's "length of the crater edge".
    arc : float
        Share of the rim that the points cover, 0 to 1.
    trials : int
        Number at each altitude, and of crater triples at each point of fig. 3.
    images : int
        Number at each altitude of table 2; the other sets of rendered images have fixed shares of it.
    descents : int
        Trials of figs. 17 and 18, each with its own terrain; figs. 15 and 16 show the first.
    seed : int
    workers : int
        Number of processes.
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
        highest = MAX_ALTITUDE_KM_PER_M * least_m
        checks = (
            (self.craters >= 3, f"craters: expected 3 or more, found {self.craters}"),
            (
                0.0 < least_m <= largest_m,
                f"semi-axes: expected 0 < smallest <= largest, found {least_m:g} {largest_m:g} m",
            ),
            (
                0.0 < low <= high <= highest,
                f"altitudes: expected 0 < low <= high <= {highest:g} km, found {low:g} {high:g}: "
                f"higher up the smallest rims, of {least_m:g} m, have too few pixels",
            ),
            (self.altitude_steps >= 1, f"altitude steps: expected 1 or more, found {self.altitude_steps}"),
            (
                0.0 < self.noise_px <= MAX_NOISE_PX,
                f"noise: expected more than 0, at most {MAX_NOISE_PX:g} px, found {self.noise_px:g}",
            ),
            (
                MIN_EDGE_POINTS <= self.points[0] <= self.points[1],
                f"points: expected {MIN_EDGE_POINTS} or more, rising, found {self.points}",
            ),
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
