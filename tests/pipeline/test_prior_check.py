"""Initial states that are worse than they state, in data sets of measured rims."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.frames import rotation_exp
from craternav_fg.pipeline.prior_check import _ASKED, sigma_factor
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario

ESTIMATORS = ("smoother", "online", "ekf")


@pytest.fixture(scope="module", params=[3, 4])
def data(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("prior") / "data"
    return Dataset.open(simulate(scenario(), folder, trial=request.param))


def narrowed(data: Dataset, factor: float) -> Dataset:
    """The same with standard deviations that are so many times too small."""
    initial = data.initial
    assert initial is not None
    return replace(
        data,
        initial=replace(
            initial,
            attitude_sigma_rad=initial.attitude_sigma_rad / factor,
            position_sigma_m=initial.position_sigma_m / factor,
            velocity_sigma_m_s=initial.velocity_sigma_m_s / factor,
        ),
    )


def worst_nees(data: Dataset) -> float:
    """Mean squared normalised error of the pose over the second half, of the worst estimator."""
    result = reconstruct(data, ESTIMATORS)
    assert data.truth is not None
    worst = 0.0
    for one in result.trajectories.values():
        assert one.pose_covariance is not None
        found = nees(errors(one, data.truth).pose, one.pose_covariance)
        worst = max(worst, float(found[len(found) // 2 :].mean()))
    return worst


def test_sigmas_that_are_far_too_small_are_widened_and_told(data: Dataset) -> None:
    narrow = narrowed(data, 30.0)
    result = reconstruct(narrow, ESTIMATORS)
    assert 8.0 < result.sigma_factor < 60.0
    assert result.origin == "given"
    (told,) = [text for text in result.warnings if "contradict the initial state" in text]
    assert f"{result.sigma_factor:.2g} times as far off as it states" in told
    # Expected 6; about a state that is believed it is above 100.
    assert worst_nees(narrow) < 20.0


def test_a_sound_initial_state_is_kept(data: Dataset) -> None:
    result = reconstruct(data, ("ekf",))
    assert result.sigma_factor == 1.0
    assert not any("contradict the initial state" in text for text in result.warnings)
    assert result.problems[0].initial is data.initial


def test_single_frames_do_not_count_against_it(data: Dataset) -> None:
    """Stale images: their rims are those of another place."""
    assert data.initial is not None
    assert data.truth is not None
    known = replace(data.initial, gTb=data.truth.gTb[0], position_sigma_m=50.0, attitude_sigma_rad=0.01)
    descent = replace(Descent.of(data), initial=known)
    frames = list(data.measurements or ())
    stale = [replace(frames[k], rims=frames[-1].rims, sun=None) for k in range(_ASKED)]
    assert sigma_factor(descent, stale[:2] + frames[2:]) == 1.0
    assert sigma_factor(descent, stale[:2]) == 1.0
    assert sigma_factor(descent, stale) > 3.0


def test_what_the_map_has_in_common_is_not_blamed_on_it(data: Dataset) -> None:
    """A catalogue without heights, whose ground is a standard deviation higher."""
    assert data.initial is not None
    assert data.truth is not None
    known = replace(data.initial, gTb=data.truth.gTb[0], position_sigma_m=100.0, attitude_sigma_rad=1e-3)
    catalog = data.catalog
    silent = replace(catalog, has_heights=False)
    lower = replace(silent, height_m=catalog.height_m - silent.unknown_height_sigma_m)
    frames = list(data.measurements or ())
    descent = replace(Descent.of(data), initial=known)
    assert sigma_factor(replace(descent, catalog=lower), frames) == 1.0
    exact = replace(lower, has_heights=True)
    assert sigma_factor(replace(descent, catalog=exact), frames) > 3.0


def test_a_wide_attitude_bends_the_path_before_late_rims(data: Dataset) -> None:
    """The thrust then points elsewhere by so much that the position is off in the second order."""
    assert data.initial is not None
    assert data.truth is not None
    rng = np.random.default_rng(8)
    late = 35
    frames = [
        frame if k >= late else replace(frame, rims=frame.rims.take(np.arange(0)))
        for k, frame in enumerate(data.measurements or ())
    ]
    for _ in range(6):
        turn = 0.436 * rng.normal(size=3)
        gTb = data.truth.gTb[0].copy()
        gTb[:3, :3] = gTb[:3, :3] @ rotation_exp(turn)
        gTb[:3, 3] += 100.0 * rng.normal(size=3)
        known = replace(
            data.initial, gTb=gTb, attitude_sigma_rad=0.436, position_sigma_m=100.0, velocity_sigma_m_s=1.0,
            gV=data.truth.gV[0] + rng.normal(size=3),
        )  # fmt: skip
        assert sigma_factor(replace(Descent.of(data), initial=known), frames) == 1.0


def test_too_few_rims_do_not_tell(data: Dataset) -> None:
    narrow = narrowed(data, 30.0)
    few = [replace(frame, rims=frame.rims.take(np.arange(2))) for frame in narrow.measurements or ()]
    assert sigma_factor(Descent.of(narrow), few) == 1.0
