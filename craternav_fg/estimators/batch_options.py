"""What the graph of the batch smoother consists of."""

from dataclasses import dataclass

import numpy as np

from craternav_fg.catalogs.map_errors import CRATER_FREEDOM
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.graph import GraphOptions


@dataclass(frozen=True)
class BatchOptions(GraphOptions):
    """What the graph of the batch smoother consists of: `GraphOptions`, and what only it estimates.

    Attributes
    ----------
    calibration : Calibration
        What is estimated beside the trajectory.
    crater_freedom : float or None
        Degrees of freedom of Student's t distribution that the errors which craters keep follow, see
        `crater_scatter`; None for a normal one. Needs `rim_errors`.
    """

    calibration: Calibration = Calibration()
    crater_freedom: float | None = CRATER_FREEDOM

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rims != "chart" and self.calibration.of_charts:
            raise EstimationError(
                f"calibration: errors of the map and of the intrinsics need rims='chart', found {self.rims!r}"
            )
        if self.crater_freedom is not None and not 0.0 < self.crater_freedom < np.inf:
            raise EstimationError(f"crater_freedom: expected a positive number, found {self.crater_freedom}")
        if self.rim_error_states is None and self.crater_freedom not in (None, CRATER_FREEDOM):
            raise EstimationError("crater_freedom: needs rims='chart' and rim_errors")

    @classmethod
    def of(cls, options: GraphOptions) -> "BatchOptions":
        """Return these options, with the defaults of what they do not have.

        Parameters
        ----------
        options : GraphOptions

        Returns
        -------
        BatchOptions
        """
        return cls(**vars(options))
