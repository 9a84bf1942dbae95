"""The paper's measurements in the graph: what each keeps of the information of the ellipse chart."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.ekf.filter import DistributedEkf, EkfOptions
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.linearisation import linearise_rims
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.estimators.registry import estimator
from craternav_fg.estimators.rim_models import RIM_MODELS, RimModel, rim_factors
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.trajectory import Trajectory
from factors.custom import Loss
from tests import descents

NO_LOSS = Loss(scale_sigmas=3.3)
SAME: tuple[RimModel, ...] = ("eq19", "los+shape", "points")


@pytest.fixture(scope="module")
def descent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Problem, Trajectory]:
    """Rims with edges known to 0.5 px."""
    measured = descents.scenario().measurements
    assert measured is not None
    fine = measured.model_copy(update={"edge_sigma_px": 0.5})
    return descents.problem(tmp_path_factory.mktemp("d"), descents.scenario(measurements=fine), 0)


@pytest.fixture(scope="module")
def chart(descent: tuple[Problem, Trajectory]) -> Trajectory:
    return BatchSmoother().estimate(descent[0])


def apart_sigmas(one: Trajectory, other: Trajectory) -> float:
    """Root mean square distance of positions, in sigmas of the first."""
    assert one.pose_covariance is not None
    step = other.gP - one.gP
    white = np.linalg.solve(np.linalg.cholesky(one.pose_covariance[:, 3:, 3:]), step[..., None])
    return float(np.sqrt(np.mean(white**2)))


@pytest.mark.parametrize("model", SAME)
def test_what_carries_all_information_has_the_charts_optimum(
    descent: tuple[Problem, Trajectory], chart: Trajectory, model: RimModel
) -> None:
    found = BatchSmoother(GraphOptions(rims=model)).estimate(descent[0])
    assert apart_sigmas(chart, found) < 0.1
    assert chart.pose_covariance is not None
    assert found.pose_covariance is not None
    sigmas = [
        np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (chart.pose_covariance, found.pose_covariance)
    ]
    np.testing.assert_allclose(sigmas[1] / sigmas[0], 1.0, atol=0.02)


def test_lines_of_sight_alone_know_less_the_fewer_craters_are_in_view(
    descent: tuple[Problem, Trajectory],
) -> None:
    p, _ = descent
    growth = []
    for count in (1, 2, 5):
        frames = [replace(f, rims=f.rims.take(np.arange(min(count, len(f.rims))))) for f in p.frames]
        few = replace(p, frames=frames)
        sigmas = []
        for model in ("chart", "los"):
            found = BatchSmoother(GraphOptions(rims=model)).estimate(few)
            assert found.pose_covariance is not None
            sigmas.append(np.sqrt(np.trace(found.pose_covariance[:, 3:, 3:], axis1=1, axis2=2)))
        growth.append(float(np.median(sigmas[1] / sigmas[0])))
    assert growth[0] > growth[1] > growth[2] > 1.0


@pytest.mark.parametrize("with_sun", [True, False], ids=["sun", "alone"])
@pytest.mark.parametrize("model", RIM_MODELS)
def test_every_model_works_in_batch_online_with_a_lag_and_in_the_filter(
    descent: tuple[Problem, Trajectory], model: RimModel, with_sun: bool
) -> None:
    p, truth = descent
    frames = p.frames[:20] if with_sun else [replace(frame, sun=None) for frame in p.frames[:20]]
    short = replace(p, frames=frames)
    of_filter = EkfOptions(measurement=model)
    for one in (
        BatchSmoother(GraphOptions(rims=model)),
        OnlineSmoother(GraphOptions(rims=model)),
        FixedLagSmoother(GraphOptions(rims=model)),
        DistributedEkf("ekf", of_filter),
    ):
        found = one.estimate(short)
        last = np.linalg.norm(found.gP[-1] - truth.gP[19])
        # Centres are off by what perspective moves them.
        assert last < (2000.0 if model == "centre" else 200.0), (model, one.name)


@pytest.mark.parametrize("model", RIM_MODELS)
def test_the_filter_uses_the_slope_of_its_residual(
    descent: tuple[Problem, Trajectory], model: RimModel
) -> None:
    # With the noise of real rims: a whitening that turns with the pose is a part of the slope.
    p, truth = descent
    rims, gTb, step = p.frames[0].rims, truth.gTb[0], 1e-2

    def residual(shift: np.ndarray) -> np.ndarray:
        moved = gTb.copy()
        moved[:3, 3] += shift
        return linearise_rims(moved, rims, p.camera, p.catalog, model=model, noise="measured")[1]

    A, _, usable = linearise_rims(gTb, rims, p.camera, p.catalog, model=model, noise="measured")
    assert usable.all()
    slope = [(residual(-step * e) - residual(step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(A[:, :, 3:], np.stack(slope, axis=-1), atol=1e-4 * np.abs(A[:, :, 3:]).max())


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    """The paper's third case: three craters from 100 km on, and a start that is kilometres off."""
    p, _ = descents.problem(tmp_path_factory.mktemp("far"), load_scenario("paper_case3"), 0)
    return replace(p, frames=p.frames[:100])


@pytest.mark.parametrize("model", SAME)
def test_the_filter_follows_the_chart_from_a_wide_start(far: Problem, model: RimModel) -> None:
    chart, found = (
        DistributedEkf("ekf", EkfOptions(measurement=one)).estimate(far) for one in ("chart", model)
    )
    assert apart_sigmas(chart, found) < 0.3


# Dimension of a rim's residual. That of a centre is not zero at the truth: perspective moves it.
DIMENSIONS = {"chart": 5, "eq19": 5, "los": 2, "los+shape": 5, "points": 5}


@pytest.mark.parametrize("model", DIMENSIONS)
def test_chi_square_at_the_truth_is_the_dimension(
    descent: tuple[Problem, Trajectory], model: RimModel
) -> None:
    p, truth = descent
    chi2, freedom = 0.0, 0
    for frame, gTb in zip(p.frames, truth.gTb, strict=True):
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose3(gTb))
        expected = with_predicted_covariances(frame, gTb, p.camera, p.catalog)
        for factor in rim_factors(model, X(0), p.camera, p.catalog, expected.rims, gTb, NO_LOSS):
            chi2 += 2.0 * factor.error(values)
        freedom += DIMENSIONS[model] * len(frame.rims)
    assert freedom > 400
    assert abs(chi2 / freedom - 1.0) < 3.5 * np.sqrt(2.0 / freedom)


@pytest.mark.parametrize(
    "name", ["smoother_eq19", "online_eq19", "smoother_los", "online_los", "ekf_eq19", "ekf_los"]
)
def test_the_named_estimators_measure_what_their_names_say(name: str) -> None:
    one: Estimator = estimator(name)
    assert one.name == name
    options = one.options  # type: ignore[attr-defined]
    found = options.rims if isinstance(options, GraphOptions) else options.measurement
    assert found == name.rsplit("_", 1)[1]
