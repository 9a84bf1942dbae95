"""The distributed extended Kalman filter: one sub-filter per crater, eqs. (25)-(29)."""

import itertools
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.correlated_errors import VARIANCE_INFLATION
from craternav_fg.estimators.ekf.fusion import Rule, combine, fuse_rows, stacked
from craternav_fg.estimators.ekf.point_features import FeatureWindow
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.linearisation import (
    LinearMeasurement,
    NoiseModel,
    arc_means,
    linearise_arcs,
    linearise_rims,
    linearise_sun,
)
from craternav_fg.estimators.measurement_weighting import noise_inflation, with_predicted_covariances
from craternav_fg.estimators.rim_models import RIM_MODELS, RimModel
from craternav_fg.estimators.sensor_bank import SensorBank, innovation_weight, linearise_sample
from craternav_fg.frames import right_jacobian
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

Fusion = Literal["paper", "paper-fed-back", "exact", "covariance-intersection"]
NOISE_MODELS: tuple[NoiseModel, ...] = get_args(NoiseModel)
FUSIONS: tuple[Fusion, ...] = get_args(Fusion)


@dataclass(frozen=True)
class EkfOptions:
    """How the filter measures and fuses.

    Attributes
    ----------
    measurement : {"chart", "eq19", "los", "los+shape", "points", "centre"}
        How rims are compared with the prediction, as by the smoothers.
    noise : {"measured", "fixed"}
        Each rim's own covariance, evaluated at the predicted measurement, or the paper's Qn for all of them;
        with "eq19" the latter is the paper's implicit measurement, eq. (25).
    fusion : {"exact", "paper", "paper-fed-back", "covariance-intersection"}
        "exact" counts the shared prior of the sub-filters once. "paper" runs the sub-filters independently,
        without tracked points, and publishes eq. (29). "paper-fed-back" feeds eq. (29) back into them in
        every frame, which makes them overconfident. "covariance-intersection" (weights 1/n) is conservative.
    iterations : int
        Linearisations per update; the second makes the first updates consistent if the start is wrong by a
        degree or a kilometre.
    limit_sigmas : float or None
        A rim's noise is inflated until its normalised innovation (5 degrees of freedom) is at most this;
        None: never.
    gate_sigmas : float or None
        A rim beyond this is dropped, unless every rim of the frame is; None: never. An arc has the same limit
        and gate, with the mean of its points (1 degree of freedom).
    variance_inflation : float
        Factor on the variance of time-correlated errors, which the filter treats as white.
    """

    measurement: RimModel = "chart"
    noise: NoiseModel = "measured"
    fusion: Fusion = "exact"
    iterations: int = 2
    limit_sigmas: float | None = 4.5
    gate_sigmas: float | None = 10.0
    variance_inflation: float = VARIANCE_INFLATION

    def __post_init__(self) -> None:
        for name, known in (("measurement", RIM_MODELS), ("noise", NOISE_MODELS), ("fusion", FUSIONS)):
            value = getattr(self, name)
            if value not in known:
                raise EstimationError(f"{name}: expected one of {', '.join(known)}, found {value!r}")
        if self.iterations < 1:
            raise EstimationError(f"iterations: expected 1 or more, found {self.iterations}")
        for name in ("limit_sigmas", "gate_sigmas", "variance_inflation"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise EstimationError(f"{name}: expected a positive number, found {value}")


@dataclass(frozen=True)
class FilterRun:
    """States of a filter, and what it had predicted before each update.

    Attributes
    ----------
    states : list of FilterState
        At every frame, each from the data up to it.
    predictions : list of FilterState, or None
        At the frames after the start's, each the state before, propagated by the IMU. None under "paper":
        what it publishes is not what it propagates.
    """

    states: list[FilterState]
    predictions: list[FilterState] | None


@dataclass(frozen=True)
class DistributedEkf:
    """Extended Kalman filter with one sub-filter per crater.

    Attributes
    ----------
    name : str
    options : EkfOptions
    """

    name: str = "ekf"
    options: EkfOptions = field(default_factory=EkfOptions)

    def estimate(self, problem: Problem) -> Trajectory:
        """Filter the frames after the start's; the states before are propagated from the prior.

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
        states = self.states(problem)
        found = filter_state.trajectory([frame.stamp_ns for frame in problem.frames], states)
        return replace(found, calibrated=SensorBank(problem.sensors).of_state(states[-1]))

    def states(self, problem: Problem) -> list[FilterState]:
        """Filter as `estimate` does.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        list of FilterState
            At every frame, each from the data up to it.

        Raises
        ------
        ValueError
            When the IMU log does not cover the frames.
        """
        return self.run(problem).states

    def run(self, problem: Problem) -> FilterRun:
        """Filter as `estimate` does, and keep the predictions, which innovations need.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        FilterRun

        Raises
        ------
        ValueError
            When the IMU log does not cover the frames.
        """
        states = filter_state.states_to_start(problem)
        predictions: list[FilterState] = []
        base = states[-1]
        first = problem.start.frame
        # Under "paper" every crater in view has a state of its own; else all share the published one.
        filters = dict.fromkeys(problem.frames[first].rims.craters.tolist(), base)
        fusion = self.options.fusion
        bank = SensorBank(problem.sensors)
        here_ns = problem.frames[first].stamp_ns
        if bank.at(here_ns):
            # The start rests on the camera alone.
            base = self._update(base, FrameMeasurement(here_ns, RimSet.empty(), None), problem, "exact", bank)
            states[-1] = base
        window = None
        # Sub-filters that run independently have no past pose in common, from which a point could be seen.
        if problem.features is not None and fusion != "paper":
            window = FeatureWindow(problem.features, problem.camera, len(base.covariance))
            base = window.update(base, here_ns)
        for last, frame in itertools.pairwise(problem.frames[first:]):
            prior = filter_state.propagate(base, problem, last.stamp_ns, frame.stamp_ns)
            if fusion == "paper":
                filters = self._step_each(filters, prior, last.stamp_ns, frame, problem, bank)
                alone = self._update(prior, frame, problem, "exact", bank)
                fused = _combined(list(filters.values())) if filters else alone
                # (29) counts the past that n sub-filters share n times. It is published as it is, but a
                # sub-filter that began with it would remain over-confident.
                base = replace(fused, covariance=max(len(filters), 1) * fused.covariance)
                states.append(fused)
            else:
                predictions.append(prior if window is None else window.without_clones(prior))
                base = self._update(prior, frame, problem, fusion, bank)
                if window is not None:
                    base = window.update(base, frame.stamp_ns)
                states.append(base if window is None else window.without_clones(base))
        return FilterRun(states, None if fusion == "paper" else predictions)

    def _step_each(
        self,
        filters: dict[int, FilterState],
        prior: FilterState,
        last_ns: int,
        frame: FrameMeasurement,
        problem: Problem,
        bank: SensorBank,
    ) -> dict[int, FilterState]:
        """Propagate every sub-filter to a frame and update it with its own crater and the sun.

        A sub-filter ends when its crater leaves the view. A new crater's sub-filter begins from the fused
        state, its covariance multiplied by the number of sub-filters that were fused.
        """
        out = {}
        for row, crater in enumerate(frame.rims.craters.tolist()):
            state = prior
            if crater in filters:
                state = filter_state.propagate(filters[crater], problem, last_ns, frame.stamp_ns)
            single = FrameMeasurement(frame.stamp_ns, frame.rims.take(np.array([row])), frame.sun)
            out[crater] = self._update(state, single, problem, "exact", bank)
        return out

    def _update(
        self, prior: FilterState, frame: FrameMeasurement, problem: Problem, rule: Rule, bank: SensorBank
    ) -> FilterState:
        """Update a propagated state with a frame, relinearised `iterations` times."""
        options = self.options
        samples = bank.at(frame.stamp_ns)
        if not len(frame.rims) and not len(frame.arcs) and frame.sun is None and not samples:
            return prior
        frame = frame.inflate_correlated(options.variance_inflation)
        delta = np.zeros(len(prior.covariance))
        covariance = prior.covariance
        rims = frame.rims
        if options.noise == "measured":
            rims = with_predicted_covariances(frame, prior.gTb, problem.camera, problem.catalog).rims
        frame = replace(frame, arcs=self._weighted_arcs(frame.arcs, prior, problem))
        factors: FloatArray | None = None
        weights: list[float] = []
        for iteration in range(options.iterations):
            point = prior.corrected(delta, covariance) if iteration else prior
            A, residual, usable = linearise_rims(
                point.gTb, rims, problem.camera, problem.catalog,
                model=options.measurement, noise=options.noise,
            )  # fmt: skip
            if factors is None:
                keep, factors = self._weights(A, residual, usable, prior)
                if not keep.all():
                    rims, factors = rims.take(keep), factors[keep]
                    A, residual, usable = A[keep], residual[keep], usable[keep]
            rows, count = _pose_rows(A, residual, usable, factors, point.gTb, frame, problem, rule)
            if iteration:
                rows = _relative(rows, delta)
            if samples:
                compared = [linearise_sample(one, point, delta, frame.stamp_ns) for one in samples]
                if not weights:
                    gate = np.inf if options.gate_sigmas is None else options.gate_sigmas
                    weights = [
                        innovation_weight(one, *row, prior.covariance, gate)
                        for one, row in zip(samples, compared, strict=True)
                    ]
                updates = [
                    LinearMeasurement(np.sqrt(weight) * A, np.sqrt(weight) * residual)
                    for weight, (A, residual) in zip(weights, compared, strict=True)
                    if weight > 0.0
                ]
                rows, count = stacked([_widened(rows, len(delta)), *updates]), count + len(updates)
            if not count:
                return point
            delta, covariance = fuse_rows(prior.covariance, rows, count, rule)
        return prior.corrected(delta, covariance)

    def _weights(
        self, A: FloatArray, residual: FloatArray, usable: npt.NDArray[np.bool_], prior: FilterState
    ) -> tuple[npt.NDArray[np.bool_], FloatArray]:
        """Which rims pass the gate, and the noise factors of all."""
        options = self.options
        limit = np.inf if options.limit_sigmas is None else options.limit_sigmas
        gate = np.inf if options.gate_sigmas is None else options.gate_sigmas
        sigmas, factors = noise_inflation(A, residual, prior.covariance, limit)
        keep = usable & (sigmas <= gate)
        # When all rims disagree with the prediction, the prediction is suspect.
        return (keep if keep.any() else usable), factors

    def _weighted_arcs(self, arcs: ArcSet, prior: FilterState, problem: Problem) -> ArcSet:
        """Return the arcs that pass the gate, with larger noise beyond the limit; judged by their means."""
        seen, means = arc_means(prior.gTb, arcs, problem.camera, problem.catalog)
        if not means:
            return arcs
        options = self.options
        limit = np.inf if options.limit_sigmas is None else options.limit_sigmas
        gate = np.inf if options.gate_sigmas is None else options.gate_sigmas
        A, residual = np.array([one.A for one in means]), np.array([one.residual for one in means])
        innovations, factors = noise_inflation(A, residual, prior.covariance, limit)
        keep, root = np.ones(len(arcs), dtype=np.bool_), np.ones(len(arcs))
        keep[seen], root[seen] = innovations <= gate, np.sqrt(factors)
        sigmas = tuple(scale * sigma for scale, sigma in zip(root.tolist(), arcs.sigmas, strict=True))
        return replace(arcs, sigmas=sigmas).take(keep)


def _pose_rows(
    A: FloatArray, residual: FloatArray, usable: npt.NDArray[np.bool_], factors: FloatArray, gTb: FloatArray,
    frame: FrameMeasurement, problem: Problem, rule: Rule,
) -> tuple[LinearMeasurement, int]:  # fmt: skip
    """Stack what a frame tells of the pose (rims of given noise factors, arcs, sun); count sub-filters."""
    root = np.sqrt(factors)[:, None]
    A, residual = A / root[:, :, None], residual / root
    if not usable.all():
        A, residual = A[usable], residual[usable]
    rows, count = [LinearMeasurement(A.reshape(-1, POSE.stop), residual.ravel())], len(A)
    if len(frame.arcs):
        arcs = linearise_arcs(gTb, frame.arcs, problem.camera, problem.catalog)
        rows, count = rows + arcs, count + len(arcs)
    sun = linearise_sun(gTb, frame.sun, problem.camera)
    if sun is not None:
        count = max(count, 1)
        # A central filter uses the sun once; independent sub-filters use it once each.
        often = 1.0 if rule == "exact" else np.sqrt(count)
        rows.append(LinearMeasurement(often * sun.A, often * sun.residual))
    return stacked(rows), count


def _relative(update: LinearMeasurement, delta: FloatArray) -> LinearMeasurement:
    """Refer a measurement linearised at a corrected pose to the prior's error."""
    A = update.A.copy()
    A[:, :3] = A[:, :3] @ right_jacobian(delta[:3])
    return LinearMeasurement(A, update.residual + A @ delta[POSE])


def _widened(update: LinearMeasurement, size: int) -> LinearMeasurement:
    """Return a measurement of the first states as one of all."""
    A = np.zeros((len(update.A), size))
    A[:, : update.A.shape[1]] = update.A
    return LinearMeasurement(A, update.residual)


def _combined(states: list[FilterState]) -> FilterState:
    """Combine the states of sub-filters by eq. (29), attitudes averaged on the tangent space."""
    mean = states[0]
    covariances = np.array([state.covariance for state in states])
    if len(states) == 1:
        return mean
    for _ in range(3):
        delta, covariance = combine(np.array([state.minus(mean) for state in states]), covariances)
        mean = mean.corrected(delta, covariance)
        if np.linalg.norm(delta[:3]) < 1e-9:
            break
    return mean


def ekf() -> DistributedEkf:
    """Return the best variant: ellipse chart, each rim's own noise, prior counted once."""
    return DistributedEkf("ekf", EkfOptions())


def ekf_paper() -> DistributedEkf:
    """Return the paper's filter: eq. (19) with (24), fixed Qn, eq. (29) on the output.

    Returns
    -------
    DistributedEkf

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (19), (24), (25), (29);
    docs/equations.md.
    """
    return DistributedEkf(
        "ekf_paper",
        EkfOptions(
            measurement="eq19",
            noise="fixed",
            fusion="paper",
            iterations=1,
            limit_sigmas=None,
            gate_sigmas=None,
        ),
    )
