"""Posterior Cramér-Rao bound (PCRB) of a descent, filtering and smoothing: what no estimator can beat.

The information recursion at the truth: prior, IMU noise, rims, sun tilts and samples of sensors linearised at
the true states. Time-correlated errors of rims, errors of the map, biases of sensors and the ground points of
tracks are further unknowns, as in the smoothers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.ellipse import shape_change
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.correlated_errors import (
    STATE_SIZE,
    VARIANCE_INFLATION,
    RimErrorOptions,
    correlation_of_regions,
    next_region,
)
from craternav_fg.estimators.correlated_errors import transition as transition_of_errors
from craternav_fg.estimators.linearisation import linearise_arcs, linearise_rims, linearise_sun
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.motion import transition
from craternav_fg.estimators.sensor_bank import (
    Sample,
    SensorBank,
    gyro_at,
    gyro_variance,
    with_gyro_noise,
)
from craternav_fg.evaluation.track_information import POINT_SIZE, TrackInformation
from craternav_fg.linalg import square_root, whitening
from craternav_fg.measurements import MAP_SIZE, SHARED_SIZE, TILT_SIZE, FrameMeasurement
from craternav_fg.sensors.protocol import SensorState
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray
from factors.kernels import strapdown

_POSE = slice(0, 6)
_POSITION = slice(3, 6)
_SIZE = len(strapdown.WITHOUT_RATE)


@dataclass(frozen=True)
class PosteriorBound:
    """Smallest pose covariances that the data of a descent allow.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames.
    filtered : ndarray, shape (k, 6, 6)
        From the data up to each frame: for `online`, `fixed_lag`, `ekf`. Attitude (rotation vector in b,
        rad), then position (in g, m), as `Trajectory.pose_covariance`.
    smoothed : ndarray, shape (k, 6, 6)
        From all data: for `smoother`.
    """

    stamps_ns: IntArray
    filtered: FloatArray
    smoothed: FloatArray

    def take(self, rows: IntArray) -> "PosteriorBound":
        """Return the bound at some of the stamps.

        Parameters
        ----------
        rows : ndarray of int, shape (m,)
            Indices of the stamps.

        Returns
        -------
        PosteriorBound
        """
        return PosteriorBound(self.stamps_ns[rows], self.filtered[rows], self.smoothed[rows])


def position_rms_m(pose_covariance: FloatArray) -> FloatArray:
    """Root mean square norm of the position error of pose covariances.

    Parameters
    ----------
    pose_covariance : ndarray, shape (..., 6, 6)
        Attitude (rad), then position (m).

    Returns
    -------
    ndarray, shape (...,)
        In m.
    """
    return np.sqrt(np.trace(pose_covariance[..., _POSITION, _POSITION], axis1=-2, axis2=-1))


def posterior_bound(
    descent: Descent,
    frames: Sequence[FrameMeasurement],
    truth: Trajectory,
    rim_errors: RimErrorOptions | None = None,
) -> PosteriorBound:
    """Posterior Cramér-Rao bound of the pose at every frame.

    Parameters
    ----------
    descent : Descent
    frames : sequence of FrameMeasurement
        Measurements; of each, its crater and its covariance are used, not its value: linearisation and a
        rim's covariance are those at the truth. Every match counts as right. Edge points of arcs are used
        where they were measured.
    truth : Trajectory
        At the frames' stamps, with the true biases.
    rim_errors : RimErrorOptions, optional
        Decay of the correlation of time-correlated errors, and what is constant of the map's; the steps in
        which smoothers approximate it are not used.

    Returns
    -------
    PosteriorBound

    Raises
    ------
    EstimationError
        When truth and frames do not have the same stamps.
    ValueError
        When the IMU log does not cover the frames.
    """
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    if not np.array_equal(stamps, truth.stamps_ns):
        raise EstimationError("frames and ground truth have different stamps")
    prior = filter_state.prior(descent).covariance
    # In units of the prior's sigmas: radians, metres and biases differ by ten orders of magnitude.
    sigmas = np.sqrt(np.diag(prior))[strapdown.WITHOUT_RATE]
    bank = SensorBank(descent.sensors)
    tracks = None if descent.features is None else TrackInformation(descent.features, descent, truth)
    augmented = _AugmentedState(frames, rim_errors or RimErrorOptions(), len(bank.sigmas), tracks)
    gained, steps = [], []
    for k, frame in enumerate(frames):
        if k:
            F, Q = _transition(descent, truth, k - 1, sigmas)
            steps.append(augmented.step(k, F, Q))
        information = _information(descent, frame, truth.gTb[k], sigmas, augmented)
        rate = gyro_at(descent, frame.stamp_ns) - truth.bias[k, :3]
        state = SensorState(frame.stamp_ns, truth.gTb[k], truth.gV[k], rate)
        variance = gyro_variance(descent, frame.stamp_ns)
        for sample in bank.at(frame.stamp_ns):
            J = _of_sample(sample, state, variance, bank, sigmas, augmented)
            information = information + J.T @ J
        if tracks is not None:
            tracks.add(information, k, augmented.first_of_point, sigmas)
        gained.append(information)

    filtered = _filtered(steps, gained)
    smoothed = _smoothed(steps, gained, filtered)
    units = np.outer(sigmas[_POSE], sigmas[_POSE])
    poses = [np.array([P[_POSE, _POSE] for P in states]) * units for states in (filtered, smoothed)]
    return PosteriorBound(stamps, *poses)


def _filtered(
    steps: Sequence[tuple[FloatArray, FloatArray]], gained: Sequence[FloatArray]
) -> list[FloatArray]:
    """Covariances at the frames from the data up to each: information recursion forwards."""
    out = [_updated(np.eye(len(gained[0])), gained[0])]
    for (F, Q), information in zip(steps, gained[1:], strict=True):
        out.append(_updated(F @ out[-1] @ F.T + Q, information))
    return out


def _smoothed(
    steps: Sequence[tuple[FloatArray, FloatArray]],
    gained: Sequence[FloatArray],
    filtered: Sequence[FloatArray],
) -> list[FloatArray]:
    """Covariances at the frames from all data: the information of later frames, propagated backwards."""
    later = np.zeros_like(filtered[-1])
    out = [filtered[-1]]
    for k in range(len(gained) - 2, -1, -1):
        F, Q = steps[k]
        information = later + gained[k + 1]
        later = F.T @ np.linalg.solve(np.eye(len(Q)) + information @ Q, information) @ F
        later = 0.5 * (later + later.T)
        out.append(_updated(filtered[k], later))
    return out[::-1]


class _AugmentedState:
    """The state with further unknowns: errors all rims share, biases, errors of craters, tracked points."""

    def __init__(
        self,
        frames: Sequence[FrameMeasurement],
        options: RimErrorOptions,
        biases: int,
        tracks: TrackInformation | None,
    ) -> None:
        self._decay = options.decay_shape_change
        self.changing_place = 1.0 - options.constant_place_share
        self._seen = [_kept(frame) for frame in frames]
        self._last = {crater: k for k, seen in enumerate(self._seen) for crater in seen}
        # Of each crater: what changes with its image, then the error of the map.
        of_map = any(frame.rims.of_map is not None for frame in frames)
        self._of_crater = STATE_SIZE + of_map * (MAP_SIZE + TILT_SIZE)
        self.of_rims = SHARED_SIZE if any(frame.rims.shared is not None for frame in frames) else 0
        self._shared = self.of_rims + biases
        self._begins_region = _region_begins(frames, options)
        self._of_regions = correlation_of_regions(options)
        self._charts: dict[int, FloatArray] = {}
        self._tracks = tracks
        self.first: dict[int, int] = {}
        self.first_of_point: dict[int, int] = {}
        self._enter(0)

    @property
    def size(self) -> int:
        """Dimension of the state with the further unknowns."""
        craters, points = len(self.first), len(self.first_of_point)
        return _SIZE + self._shared + self._of_crater * craters + POINT_SIZE * points

    def _enter(self, k: int) -> None:
        """Begin with the craters and points of frame k, and keep those that will be seen again."""
        charts = {**self._charts, **self._seen[k]}
        self._charts = {crater: chart for crater, chart in charts.items() if self._last[crater] >= k}
        begin = _SIZE + self._shared
        self.first = {crater: begin + self._of_crater * i for i, crater in enumerate(self._charts)}
        begin += self._of_crater * len(self.first)
        alive = [] if self._tracks is None else self._tracks.alive(k)
        self.first_of_point = {track: begin + POINT_SIZE * i for i, track in enumerate(alive)}

    def step(self, k: int, F: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on to frame k: extend the state's transition and noise to the further unknowns."""
        columns, points, before, size = self.first, self.first_of_point, self._charts, self.size
        self._enter(k)
        whole, noise = np.zeros((self.size, size)), np.zeros((self.size, self.size))
        whole[:_SIZE, :_SIZE], noise[:_SIZE, :_SIZE] = F, Q
        for j in range(_SIZE, _SIZE + self._shared):
            whole[j, j] = 1.0
        if self._begins_region[k]:
            for j, correlation in enumerate(self._of_regions, start=_SIZE):
                whole[j, j], noise[j, j] = correlation, 1.0 - correlation**2
        for crater, row in self.first.items():
            own = slice(row, row + self._of_crater)
            noise[own, own] = np.eye(self._of_crater)
            if crater in columns:
                change = float(shape_change(before[crater], self._charts[crater]))
                of_crater = np.eye(self._of_crater)
                of_crater[:STATE_SIZE, :STATE_SIZE] = transition_of_errors(change, self._decay)
                whole[own, columns[crater] : columns[crater] + self._of_crater] = of_crater
                noise[own, own] -= of_crater @ of_crater.T
        for track, row in self.first_of_point.items():
            for j in range(row, row + POINT_SIZE):
                if track in points:
                    whole[j, points[track] + j - row] = 1.0
                else:
                    noise[j, j] = 1.0
        return whole, noise


def _region_begins(frames: Sequence[FrameMeasurement], options: RimErrorOptions) -> list[bool]:
    """Whether rims see another region than those of the frames before."""
    region, begins = frozenset[int](), []
    for frame in frames:
        before = region
        if frame.rims.shared is not None and len(frame.rims):
            region = next_region(before, frame.rims.craters, options)
        begins.append(bool(before) and region is not before)
    return begins


def _kept(frame: FrameMeasurement) -> dict[int, FloatArray]:
    """Charts (5,) of those craters whose errors are unknowns."""
    if frame.rims.correlated is None and frame.rims.of_map is None:
        return {}
    return dict(zip(frame.rims.craters.tolist(), frame.rims.chart, strict=True))


def _information(
    descent: Descent, frame: FrameMeasurement, gTb: FloatArray, sigmas: FloatArray, augmented: _AugmentedState
) -> FloatArray:
    """Information of a frame on the augmented state."""
    camera, catalog = descent.camera, descent.catalog
    frame = with_predicted_covariances(frame, gTb, camera, catalog)
    rims = frame.rims.with_changing_place(augmented.changing_place)
    white = replace(rims, covariance=rims.fused_white_covariance)
    A, _, usable = linearise_rims(gTb, white, camera, catalog, model="chart", noise="measured")
    W = whitening(white.covariance)
    rows = []
    for i in np.flatnonzero(usable):
        J = np.zeros((5, augmented.size))
        J[:, _POSE] = A[i] * sigmas[_POSE]
        first = augmented.first.get(int(rims.craters[i]), 0)
        begin_of_map = first + STATE_SIZE + rims.map_columns.start
        for root, begin in ((rims.correlated, first), (rims.of_map, begin_of_map)):
            if root is not None:
                J[:, begin : begin + root.shape[2]] = W[i] @ root[i]
        if rims.shared is not None:
            J[:, _SIZE : _SIZE + SHARED_SIZE] = W[i] @ rims.shared[i]
        rows.append(J)
    others = linearise_arcs(gTb, frame.arcs.inflate_correlated(VARIANCE_INFLATION), camera, catalog)
    sun = linearise_sun(gTb, frame.sun, camera)
    if sun is not None:
        others.append(sun)
    for one in others:
        J = np.zeros((len(one.A), augmented.size))
        J[:, _POSE] = one.A * sigmas[_POSE]
        rows.append(J)
    J = np.concatenate([np.zeros((0, augmented.size)), *rows])
    return np.asarray(J.T @ J)


def _of_sample(
    sample: Sample,
    state: SensorState,
    variance: float,
    bank: SensorBank,
    sigmas: FloatArray,
    augmented: _AugmentedState,
) -> FloatArray:
    """Whitened derivatives (m, n) of a sample in the augmented state, at the truth; variance of the gyro."""
    found = with_gyro_noise(sample.linearise(state, np.zeros(len(bank.sigmas))), variance)
    J = np.zeros((len(found.error), augmented.size))
    whole = found.jacobian.copy()
    # The angular velocity is the gyro's less its bias.
    whole[:, strapdown.GYRO_BIAS] -= whole[:, strapdown.RATE]
    J[:, :_SIZE] = whole[:, strapdown.WITHOUT_RATE] * sigmas
    first = _SIZE + augmented.of_rims
    biases = slice(first + sample.bias.start, first + sample.bias.stop)
    J[:, biases] = found.bias_jacobian * bank.sigmas[sample.bias]
    return J


def _transition(
    descent: Descent, truth: Trajectory, k: int, sigmas: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Transition (15, 15) from frame k to the next, and the IMU noise (15, 15) that it adds."""
    state = truth.gTb[k], truth.gV[k], truth.bias[k]
    F, Q = transition(descent, state, int(truth.stamps_ns[k]), int(truth.stamps_ns[k + 1]))
    return F * sigmas / sigmas[:, None], Q / np.outer(sigmas, sigmas)


def _updated(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Covariance (n, n) after information (n, n) is added: (P^-1 + I)^-1."""
    L = square_root(covariance)
    root = whitening(np.eye(len(L)) + L.T @ information @ L) @ L.T
    return np.asarray(root.T @ root)
