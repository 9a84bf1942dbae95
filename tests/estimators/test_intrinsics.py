"""Focal length, principal point and distortion as variables."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import pixel_chart, points_and_normals, points_on
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph, trajectory
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.intrinsics import intrinsic_slopes
from craternav_fg.estimators.motion import longest_interval_s
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.consistency import mean_interval
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.evaluation.residuals import rim_residuals
from craternav_fg.measurements import ArcSet, FrameMeasurement
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.trajectory import Trajectory

STATED = Camera(1012, 1012, 672.0, 672.0, 505.0, 506.0)


def _fitted(points: np.ndarray) -> np.ndarray:
    """Chart of an ellipse through points that are even in its parameter: their first harmonic."""
    t = 2.0 * np.pi * np.arange(points.shape[1]) / points.shape[1]
    centre = points.mean(axis=1)
    a = 2.0 * np.mean(points * np.cos(t)[None, :, None], axis=1)
    b = 2.0 * np.mean(points * np.sin(t)[None, :, None], axis=1)
    S = a[:, :, None] * a[:, None, :] + b[:, :, None] * b[:, None, :]
    xx, xy, yy = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    return np.column_stack([centre, 0.5 * np.log(xx), xy / xx, 0.5 * np.log(yy - xy**2 / xx)])


def _charts(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack(
        [rng.uniform(-0.6, 0.6, (n, 2)), np.log(rng.uniform(0.01, 0.03, n)), rng.uniform(-0.3, 0.3, n),
         np.log(rng.uniform(0.01, 0.03, n))]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("k", "change"),
    [
        (0, {"fx_px": 672.0 * 1.001, "fy_px": 672.0 * 1.001}),
        (1, {"cx_px": 506.0}),
        (2, {"cy_px": 507.0}),
        (3, {"distortion": (1e-3, 0.0, 0.0, 0.0, 0.0)}),
    ],
    ids=["focal length", "x", "y", "k1"],
)
def test_charts_change_as_through_the_true_camera(k, change):
    charts = _charts(np.random.default_rng(1), 30)
    true = replace(STATED, **change)
    step = [1e-3, 1.0, 1.0, 1e-3][k]
    points = points_on(charts)
    seen = STATED.normalised(true.pixels(points))
    expected = (_fitted(seen) - _fitted(points)) / step
    slopes = intrinsic_slopes(charts, STATED)[:, :, k]
    np.testing.assert_allclose(slopes, expected, atol=0.01 * np.abs(expected).max())


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return Dataset.open(simulate("orbit_coast", tmp_path_factory.mktemp("orbit") / "data", trial=2))


def _with(camera: Camera, true: np.ndarray) -> Camera:
    """Camera whose intrinsics are off by a share of the focal length, px of the principal point, and k1."""
    return replace(
        camera,
        fx_px=camera.fx_px * (1.0 + true[0]), fy_px=camera.fy_px * (1.0 + true[0]),
        cx_px=camera.cx_px + true[1], cy_px=camera.cy_px + true[2],
        distortion=(true[3], 0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip


def _through(data: Dataset, true: np.ndarray) -> list[FrameMeasurement]:
    """Measurements through a camera whose intrinsics are off: focal length, principal point, distortion."""
    frames = []
    assert data.measurements is not None
    for frame in data.measurements:
        rims = frame.rims
        points = points_on(rims.chart)
        seen = data.camera.normalised(_with(data.camera, true).pixels(points))
        shift = _fitted(seen) - _fitted(points)
        frames.append(replace(frame, rims=replace(rims, chart=rims.chart + shift)))
    return frames


def test_intrinsics_are_estimated_along_with_an_orbit(data):
    true = np.array([1.5e-3, -2.0, 1.0, 8e-4])
    frames = _through(data, true)
    problem = make_problem(Descent.of(data), frames)
    options = Calibration(focal_sigma_share=3e-3, principal_point_sigma_px=4.0, k1_sigma=1e-3)
    found = BatchSmoother(BatchOptions(calibration=options)).estimate(problem)
    values, sigmas = found.calibrated.intrinsics
    assert np.all(np.abs(values - true) < 3.5 * sigmas)
    # The focal length is as uncertain as the altitude; the distortion is seen well.
    assert sigmas[3] < 0.3e-3
    error = np.linalg.norm(found.gP - data.truth.gP, axis=1)
    without = BatchSmoother().estimate(problem)
    assert error.mean() < 0.5 * np.linalg.norm(without.gP - data.truth.gP, axis=1).mean()
    # Its rims fit through the lens that it found, not through the stated one.
    fitting, stated = (
        np.mean(rim_residuals(one, frames, data.camera, data.catalog) ** 2)
        for one in (found, replace(found, calibrated=None))
    )
    assert 0.9 < fitting < 1.1
    assert stated > 10.0


@pytest.mark.parametrize("kind", ["arcs", pytest.param("tracked points", marks=pytest.mark.slow)])
def test_arcs_and_tracked_points_of_another_lens_do_no_harm(kind, tmp_path):
    """They are normalised by the stated intrinsics; taken as right, they would contradict the rims."""
    rng, trials = np.random.default_rng(1), 4
    sigmas = np.array([1e-2, 5.0, 5.0, 0.0])
    options = Calibration(focal_sigma_share=sigmas[0], principal_point_sigma_px=sigmas[1])
    case = load_scenario("orbit_coast")
    tracks = {"features": {"sigma_px": 0.2, "simulation": {"count": 80}}}
    case = case.model_copy(update={"sensors": tracks if kind == "tracked points" else {}})
    consistency = []
    for trial in range(trials):
        data = Dataset.open(simulate(case, tmp_path / f"data{trial}", trial=trial))
        true, camera = sigmas * rng.normal(size=4), data.camera
        problem = make_problem(Descent.of(data), _through(data, true))
        if kind == "arcs":
            problem = replace(problem, frames=[_with_arcs(one, camera, rng) for one in problem.frames])
        else:
            seen = _with(camera, true).pixels(camera.normalised(data.features.points_px))
            problem = replace(problem, features=replace(data.features, points_px=seen))
        found = BatchSmoother(BatchOptions(calibration=options)).estimate(problem)
        consistency.append(np.mean(nees(errors(found, data.truth).pose, found.pose_covariance)))
    low, high = mean_interval(6, trials)
    assert low < np.mean(consistency) < high


def _with_arcs(frame: FrameMeasurement, camera: Camera, rng: np.random.Generator) -> FrameMeasurement:
    """Every third rim as edge points on a quarter of it, 0.3 px each."""
    cut = np.arange(len(frame.rims)) % 3 == 2
    points = []
    for chart in frame.rims.chart[cut]:
        angles = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 0.5 * np.pi, 15)
        on_rim, normal = points_and_normals(pixel_chart(chart, camera), angles)
        points.append(camera.normalised(on_rim + 0.3 * rng.normal(size=(15, 1)) * normal))
    sigmas = tuple(np.full(15, 0.3 / camera.focal_px) for _ in points)
    arcs = ArcSet(frame.rims.craters[cut], tuple(points), sigmas)
    return replace(frame, rims=frame.rims.take(~cut), arcs=arcs)


def test_one_of_them_alone(data):
    problem = make_problem(Descent.of(data), data.measurements)
    found = BatchSmoother(BatchOptions(calibration=Calibration(k1_sigma=1e-3))).estimate(problem)
    values, sigmas = found.calibrated.intrinsics
    assert np.all(values[:3] == 0.0)
    assert np.all(sigmas[:3] == 0.0)
    assert abs(values[3]) < 3.5 * sigmas[3]
    with pytest.raises(EstimationError, match="focal_sigma_share: expected 0 or more"):
        Calibration(focal_sigma_share=-1.0)


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False], ids=["known", "estimated"])
def test_an_orbit_reaches_the_bound_with_and_without_intrinsics(known, tmp_path):
    """The bound is the covariance of the graph that is linearised at the truth."""
    rng, trials = np.random.default_rng(1), 20
    sigmas = np.zeros(4) if known else np.array([3e-3, 2.0, 2.0, 1e-3])
    options = BatchOptions(
        calibration=Calibration(
            focal_sigma_share=sigmas[0], principal_point_sigma_px=sigmas[1], k1_sigma=sigmas[3]
        )
    )
    ratios2, consistency = [], []
    for trial in range(trials):
        data = Dataset.open(simulate("orbit_coast", tmp_path / f"data{trial}", trial=trial))
        frames = _through(data, sigmas * rng.normal(size=4))
        problem = make_problem(Descent.of(data), frames)
        found = BatchSmoother(options).estimate(problem)
        error = errors(found, data.truth)
        consistency.append(np.mean(nees(error.pose, found.pose_covariance)))
        bound2 = np.trace(_at_truth(problem, options, data.truth)[:, 3:, 3:], axis1=1, axis2=2)
        ratios2.append(np.sum(error.position_m**2, axis=1) / bound2)
    low, high = mean_interval(6, trials)
    assert low < np.mean(consistency) < high
    # Over the trials at each frame, then over the frames.
    assert np.mean(np.sqrt(np.mean(ratios2, axis=0))) < 1.1


def _at_truth(problem: Problem, options: BatchOptions, truth: Trajectory) -> np.ndarray:
    """Pose covariances (k, 6, 6) of the graph at the true states."""
    states = [
        replace(filter_state.prior(problem), gTb=gTb, gV=gV, bias=bias)
        for gTb, gV, bias in zip(truth.gTb, truth.gV, truth.bias, strict=True)
    ]
    start = replace(problem.start, frame=0)
    values, indices = initial_values(problem, start, states, longest_interval_s(problem, options))
    graph = build_graph(problem, options, values)
    return trajectory(problem, options, graph, values, indices).pose_covariance
