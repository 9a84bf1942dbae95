"""Rims that agree by chance, or are all wrong alike, are no pose; many wrong matches still are one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.catalogs.model import Catalog
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.intrinsics import (
    IntrinsicsFit,
    IntrinsicsPrior,
    fit_intrinsics,
    intrinsics_warnings,
    with_unknown_intrinsics,
)
from craternav_fg.resection.problem import ResectionProblem, ResectionResult, Status
from craternav_fg.resection.robust import solve_all, solve_robustly
from craternav_fg.simulation.catalog_views import View, synthetic_catalog
from craternav_fg.simulation.scenes import MOON
from factors.kernels.gauss_newton import screw_between
from tests.resection.matched_views import Faults, draw, is_right, matched, some_swapped

Solver = Callable[[ResectionProblem], ResectionResult]
FAULTS: dict[str, Faults] = {
    "mirrored": Faults(mirrored=True),
    "shuffled": Faults(),
    "half-size image": Faults(image_scale=0.5),
    "f + 5 %": Faults(focal_scale=1.05),
    "f - 5 %": Faults(focal_scale=0.95),
    "f + 1 %": Faults(focal_scale=1.01),
    "scaled craters": Faults(size_scale=2.0),
    "other body": Faults(body_scale=0.32),
    "other catalogue": Faults(),
    "pixels from 1": Faults(shift_px=1.0),
}


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return synthetic_catalog(MOON, np.random.default_rng(0))


def craters_of(fault: str, catalog: Catalog, view: View, rng: np.random.Generator) -> np.ndarray | None:
    if fault == "shuffled":
        return rng.permutation(view.craters)
    if fault == "other catalogue":
        return rng.integers(len(catalog), size=len(view.craters))
    return None


def silently_wrong(catalog: Catalog, fault: str, count: int, solver: Solver) -> int:
    """Number of wrong poses without a warning."""
    rng = np.random.default_rng(5)
    wrong = 0
    for k in range(count):
        view = draw(catalog, rng, k)
        problem = matched(catalog, view, rng, FAULTS[fault], craters_of(fault, catalog, view, rng))
        result = with_unknown_intrinsics(problem, solver(problem), IntrinsicsPrior(view.camera.focal_px))
        if result.status in (Status.SOLVED, Status.AMBIGUOUS):
            wrong += not is_right(result, view) and not result.warnings
    return wrong


@pytest.mark.parametrize("fault", FAULTS)
def test_no_fault_is_believed_in_silence(catalog: Catalog, fault: str) -> None:
    assert silently_wrong(catalog, fault, 6, solve_robustly) == 0
    assert silently_wrong(catalog, fault, 6, solve_all) == 0


@pytest.mark.slow
@pytest.mark.parametrize("solver", [solve_robustly, solve_all])
@pytest.mark.parametrize("fault", FAULTS)
def test_no_fault_of_a_thousand_is_believed_in_silence(catalog: Catalog, fault: str, solver: Solver) -> None:
    assert silently_wrong(catalog, fault, 1000, solver) <= 1


def test_mirrored_rims_are_no_pose(catalog: Catalog) -> None:
    rng = np.random.default_rng(6)
    for k in range(20):
        result = solve_robustly(matched(catalog, draw(catalog, rng, k), rng, Faults(mirrored=True)))
        assert result.status is Status.NO_POSE
        assert result.poses == ()


def test_mirrored_rims_of_slanted_views_are_no_pose(catalog: Catalog) -> None:
    """Rims near a line agree on a pose that is turned about it; a linear map did not explain the others."""
    rng = np.random.default_rng(5)
    for k in range(30):
        view = draw(catalog, rng, k, largest_tilt_deg=60.0)
        result = solve_robustly(matched(catalog, view, rng, Faults(mirrored=True)))
        assert result.status is Status.NO_POSE, result.warnings


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_the_right_matches_of_slanted_views_are_found(catalog: Catalog, share: float) -> None:
    rng = np.random.default_rng(14)
    for k in range(15):
        view = draw(catalog, rng, k, largest_tilt_deg=60.0)
        result = solve_robustly(matched(catalog, view, rng, craters=some_swapped(view, rng, share)))
        assert result.status is Status.SOLVED
        assert is_right(result, view)


def right_of(catalog: Catalog, share: float, count: int) -> int:
    """Number of views, a share of whose matches is wrong, with the right pose."""
    rng = np.random.default_rng(7)
    right = 0
    for k in range(count):
        view = draw(catalog, rng, k)
        result = solve_robustly(matched(catalog, view, rng, craters=some_swapped(view, rng, share)))
        right += bool(result.poses) and is_right(result, view)
        if share > 0.5 and result.poses:
            assert "rims were left out as wrongly matched" in result.warnings[0]
    return right


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_the_right_matches_are_found(catalog: Catalog, share: float) -> None:
    assert right_of(catalog, share, 25) == 25


def test_the_right_matches_are_found_where_the_best_measured_rims_are_wrong(catalog: Catalog) -> None:
    rng = np.random.default_rng(7)
    for k in range(15):
        view = draw(catalog, rng, k)
        largest = np.argsort(-view.ellipses_px[:, 2])[: len(view.craters) // 2]
        craters = view.craters.copy()
        craters[largest] = craters[np.roll(largest, 1)]
        result = solve_robustly(matched(catalog, view, rng, craters=craters))
        assert result.status is Status.SOLVED
        assert is_right(result, view)
        assert set(map(str, largest)) <= set(result.wrong)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.2, 0.4, 0.6])
def test_the_right_matches_of_many_views_are_found(catalog: Catalog, share: float) -> None:
    assert right_of(catalog, share, 500) >= 495


@pytest.mark.parametrize("solver", [solve_robustly, solve_all])
@pytest.mark.parametrize("factor", [2.5, 10.0])
def test_too_small_a_sigma_is_found_from_the_residuals(
    catalog: Catalog, solver: Solver, factor: float
) -> None:
    """Before, three rims of many were taken for right, or the matches and the camera were blamed."""
    rng = np.random.default_rng(8)
    for k in range(15):
        view = draw(catalog, rng, k)
        result = solver(matched(catalog, view, rng, Faults(said_sigma_px=1.0 / factor)))
        assert result.status is Status.SOLVED
        assert is_right(result, view)
        assert result.wrong == ()
        assert result.sigma_scale == pytest.approx(factor, rel=0.35)
        assert any("times as widely as their standard deviations say" in text for text in result.warnings)


@pytest.mark.parametrize("said_sigma_px", [1.0, 0.2])
def test_one_wrong_match_is_not_explained_by_a_larger_sigma(catalog: Catalog, said_sigma_px: float) -> None:
    """Nor are rims that have a wrong match and too small a sigma."""
    rng = np.random.default_rng(9)
    for k in range(10):
        view = draw(catalog, rng, k)
        craters = some_swapped(view, rng, 2.0 / len(view.craters))
        result = solve_all(matched(catalog, view, rng, Faults(said_sigma_px=said_sigma_px), craters=craters))
        assert result.status is Status.NO_POSE
        assert "a wrong match, the wrong camera, or too small a sigma" in result.reason


@pytest.mark.parametrize("focal_scale", [0.97, 1.0, 1.03])
def test_the_focal_length_is_estimated_within_its_sigma(catalog: Catalog, focal_scale: float) -> None:
    rng = np.random.default_rng(10)
    off = []
    for k in range(30):
        view = draw(catalog, rng, k)
        problem = matched(catalog, view, rng, Faults(focal_scale=focal_scale))
        fit = fit_intrinsics(problem, view.gTb, IntrinsicsPrior(view.camera.focal_px, 0.05))
        off.append((np.log(fit.focal_scale) + np.log(focal_scale)) / fit.focal_scale_sigma)
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=0.7)


def test_errors_of_rims_do_not_change_the_focal_length_of_many_images(catalog: Catalog) -> None:
    """Each rim pulled it up: small ones to five standard errors over forty frames of an orbit."""
    rng = np.random.default_rng(15)
    estimates, information = [], []
    for k in range(30):
        view = draw(catalog, rng, k)
        rims = matched(catalog, view, rng).rims
        root = np.linalg.cholesky(rims.covariance)
        for _ in range(4):
            # Edges of 6 px in place of 1 px.
            noise = np.sqrt(35.0) * (root @ rng.normal(size=(len(rims), 5, 1)))[..., 0]
            noisy = replace(rims, chart=rims.chart + noise, covariance=36.0 * rims.covariance)
            prior = IntrinsicsPrior(view.camera.focal_px)
            fit = fit_intrinsics(ResectionProblem(noisy), view.gTb, prior)
            estimates.append(np.log(fit.focal_scale))
            information.append(fit.focal_scale_sigma**-2)
    assert abs(np.dot(information, estimates)) < 3.5 * np.sqrt(np.sum(information))


@pytest.mark.parametrize(("focal_scale", "said"), [(1.09, "contradict by 3.4 sigma"), (1.05, "cannot check")])
def test_a_focal_length_that_is_doubtful_is_said_to_be(focal_scale: float, said: str) -> None:
    fit = IntrinsicsFit(
        gTb=np.eye(4), covariance=np.eye(6), effect=np.full((6, 3), 1e5), unknowns=np.zeros(3),
        unknowns_covariance=np.eye(3), focal_scale=focal_scale, focal_scale_sigma=0.025,
        principal_shift_px=np.zeros(2), principal_covariance_px2=np.eye(2), cost=0.0, converged=True,
    )  # fmt: skip
    (warning,) = intrinsics_warnings(fit, IntrinsicsPrior(700.0))
    assert f"these rims {said}" in warning


def test_a_focal_length_far_off_is_fitted_until_it_converges(catalog: Catalog) -> None:
    """Ten steps used to end up to 0.7 standard deviations from the minimum."""
    rng = np.random.default_rng(3)
    apart = []
    for k in range(30):
        view = draw(catalog, rng, k)
        problem = matched(catalog, view, rng, Faults(focal_scale=0.5))
        few = problem.rims.take(np.sort(rng.permutation(len(problem.rims))[:3]))
        problem = ResectionProblem(few)
        start = solve(problem)
        if start.poses:
            prior = IntrinsicsPrior(view.camera.focal_px, focal_sigma_share=1.0)
            one, other = (fit_intrinsics(problem, gTb, prior) for gTb in (start.poses[0].gTb, view.gTb))
            assert one.converged
            assert other.converged
            sigma = np.sqrt(one.unknowns_covariance[0, 0])
            apart.append(abs(one.unknowns[0] - other.unknowns[0]) / sigma)
    assert len(apart) > 8
    assert max(apart) < 0.01


def test_intrinsics_that_do_not_converge_leave_the_pose_and_are_said(catalog: Catalog) -> None:
    rng = np.random.default_rng(3)
    view = draw(catalog, rng, 0)
    prior = IntrinsicsPrior(view.camera.focal_px)
    fit = fit_intrinsics(matched(catalog, view, rng, Faults(mirrored=True)), view.gTb, prior)
    assert not fit.converged
    np.testing.assert_array_equal(fit.gTb, view.gTb)
    (warning,) = intrinsics_warnings(fit, prior)
    assert "did not converge" in warning


@pytest.mark.parametrize(
    ("principal_sigma_px", "spread_px", "said"), [(0.5, 50.0, True), (0.5, 2.0, False), (0.0, np.nan, False)]
)
def test_a_principal_point_that_the_rims_cannot_check_is_named_beside_the_focal_length(
    principal_sigma_px: float, spread_px: float, said: bool
) -> None:
    """As of a photograph that was cropped: 155 px beside the stated one, the pose was 38 km off unsaid."""
    fit = IntrinsicsFit(
        gTb=np.eye(4), covariance=np.eye(6), effect=np.full((6, 3), 1e5), unknowns=np.zeros(3),
        unknowns_covariance=np.eye(3), focal_scale=2.09, focal_scale_sigma=0.417,
        principal_shift_px=np.zeros(2), principal_covariance_px2=spread_px**2 * np.eye(2), cost=0.0,
        converged=True,
    )  # fmt: skip
    (warning,) = intrinsics_warnings(fit, IntrinsicsPrior(700.0, principal_sigma_px=principal_sigma_px))
    assert "focal length (theirs differs by +109 +- 42 %)" in warning
    assert ("its principal point" in warning) == said


def test_unknown_intrinsics_keep_the_covariance_consistent(catalog: Catalog) -> None:
    """Each image by a camera whose intrinsics are off by the expected error."""
    rng = np.random.default_rng(11)
    nees = []
    for k in range(60):
        view = draw(catalog, rng, k)
        faults = Faults(focal_scale=float(np.exp(0.003 * rng.normal())), shift_px=0.5 * rng.normal(size=2))
        problem = matched(catalog, view, rng, faults)
        result = with_unknown_intrinsics(problem, solve_all(problem), IntrinsicsPrior(view.camera.focal_px))
        error = np.empty(6)
        screw_between(np.ascontiguousarray(result.poses[0].gTb), view.gTb, error)
        nees.append(error @ np.linalg.solve(result.poses[0].covariance, error))
    assert 4.8 < np.mean(nees) < 7.4


def test_residuals_are_those_of_the_fitted_intrinsics(catalog: Catalog) -> None:
    """A rim that a wrong focal length moves by many sigmas fits once it is found."""
    rng = np.random.default_rng(13)
    for k in range(10):
        view = draw(catalog, rng, k)
        problem = matched(catalog, view, rng, Faults(focal_scale=1.005))
        prior = IntrinsicsPrior(view.camera.focal_px, 0.05)
        found = solve_all(problem)
        best = with_unknown_intrinsics(problem, found, prior).poses[0]
        squares = float(np.sum(best.residuals**2))
        assert squares < found.poses[0].cost
        assert squares < chi2.ppf(0.9999, best.residuals.size)
        # Beside the prior of the three intrinsics.
        assert 0.0 < best.cost - squares < 30.0


def test_the_principal_point_is_estimated_within_its_covariance(catalog: Catalog) -> None:
    """Pixels counted from 1, and the same convention for camera and rims."""
    rng = np.random.default_rng(12)
    said = {0.0: 0, 1.0: 0}
    off = []
    for k in range(40):
        view = draw(catalog, rng, k)
        shift_px = float(k % 2)
        problem = matched(catalog, view, rng, Faults(shift_px=shift_px))
        prior = IntrinsicsPrior(view.camera.focal_px, focal_sigma_share=0.0)
        fit = fit_intrinsics(problem, view.gTb, prior)
        error = fit.principal_shift_px - shift_px
        off.append(error @ np.linalg.solve(fit.principal_covariance_px2, error))
        result = with_unknown_intrinsics(problem, solve_all(problem), prior)
        said[shift_px] += any("is the first pixel's centre at (0, 0)?" in text for text in result.warnings)
    assert np.mean(off) == pytest.approx(2.0, abs=1.0)
    assert said[0.0] == 0
    assert said[1.0] >= 1
