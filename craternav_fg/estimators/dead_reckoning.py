"""Dead reckoning: the start propagated by the IMU alone."""

import itertools

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.trajectory import Trajectory


class DeadReckoning:
    """Inertial navigation without images: the baseline of every other estimator."""

    name = "dead_reckoning"

    def estimate(self, problem: Problem) -> Trajectory:
        """Propagate the start and its covariance to every frame.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            When the IMU log does not cover the frames.
        """
        stamps = [frame.stamp_ns for frame in problem.frames]
        states = filter_state.states_to_start(problem)
        for begin_ns, end_ns in itertools.pairwise(stamps[problem.start.frame :]):
            states.append(filter_state.propagate(states[-1], problem, begin_ns, end_ns))
        return filter_state.trajectory(stamps, states)
