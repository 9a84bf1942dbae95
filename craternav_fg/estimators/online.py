"""Online smoothers: the estimate at a frame uses the data up to it."""

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.incremental import FixedLagIsam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.trajectory import Trajectory


class OnlineSmoother:
    """iSAM2 over a whole descent; the estimate at a frame uses the data up to it.

    Parameters
    ----------
    options : GraphOptions
    name : str
        Under which its result is kept.
    """

    def __init__(self, options: GraphOptions = GraphOptions(), name: str = "online") -> None:
        self.options = options
        self.name = name

    def run(self, problem: Problem) -> OnlineSession:
        """Process all frames in a session that keeps all states."""
        session = OnlineSession(problem, self.options, keep_past=True)
        session.run(problem)
        return session

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from the data up to it.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory
        """
        session = OnlineSession(problem, self.options)
        session.run(problem)
        return session.filtered()


class FixedLagSmoother:
    """Online smoother that marginalises states older than a lag, so that cost and memory stay bounded.

    The estimate at a frame uses all data up to it; states older than the lag are no longer relinearised.

    Parameters
    ----------
    options : GraphOptions
    lag_s : float
        Length of the window of states, s. Long enough that a start wrong by 25 deg has settled within it.
    """

    name = "fixed_lag"

    def __init__(self, options: GraphOptions = GraphOptions(), lag_s: float = 30.0) -> None:
        self.options = options
        self.lag_s = lag_s

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from the data up to it.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory

        Raises
        ------
        EstimationError
            When the lag is not positive.
        """
        session = OnlineSession(problem, self.options, FixedLagIsam(self.lag_s))
        session.run(problem)
        return session.filtered()
