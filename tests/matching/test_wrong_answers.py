"""Views whose right pose is not in what is searched: answers to them are wrong, and must be as good as none.

The slow tests draw 50 views of each fault; `--views 1000` draws more.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import chart_of_axes
from craternav_fg.matching.acquire.detected_rims import DetectedRims
from craternav_fg.matching.acquire.search import acquire_from_rims
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.rematch import NO_CRATER, rematched
from craternav_fg.measurements import RimSet
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.simulation.catalog_views import synthetic_catalog
from craternav_fg.simulation.scenes import MOON
from factors.kernels.gauss_newton import screw_between
from tests.matching.faulty_views import FAULTS, Given, draw, searched

FEW = 4
# A rim at the place of one that looks alike is that one's for whoever knows the pose.
AT_A_POSE = tuple(fault for fault in FAULTS if fault != "shuffled")
# An error of the pose of six numbers is larger, squared, once in 1e6.
FAR2 = 38.0
# As the robust smoother asks of a rim: chi-square of five numbers, 99 %.
LIMIT2 = float(chi2.ppf(0.99, 5))
# Standard deviations of the prediction from which acquisition starts.
ATTITUDE_SIGMA_RAD, POSITION_SIGMA_M = np.radians(10.0), 4e3
SUNWARD_SIGMA_RAD = np.radians(8.0)


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return synthetic_catalog(MOON, np.random.default_rng(0))


@pytest.fixture
def many(request: pytest.FixtureRequest) -> int:
    """Number of views that a slow test draws."""
    return int(request.config.getoption("--views"))


def far(gTb: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> bool:
    """Whether a pose is not within its covariance, of the right twist, about the truth."""
    error = np.empty(6)
    screw_between(np.ascontiguousarray(gTb), truth, error)
    return not error @ np.linalg.solve(covariance, error) < FAR2


# --- identification ---


def identified(catalog: Catalog, fault: str | None, count: int) -> tuple[int, int]:
    """Numbers of answers, and of those that are wrong without a warning."""
    rng = np.random.default_rng(30)
    index = TripleIndex.build(searched(catalog, fault))
    answers = wrong = 0
    for _ in range(count):
        given = draw(catalog, rng, fault)
        answer = identify(given.ellipses_px, given.camera, index)
        answers += answer.identified
        if answer.identified and not answer.warnings:
            wrong += far(answer.gTb, answer.covariance, given.view.gTb)
    return answers, wrong


# --- acquisition ---


def acquired(catalog: Catalog, fault: str | None, count: int) -> tuple[int, int]:
    """Numbers of answers, and of wrong ones."""
    rng = np.random.default_rng(31)
    wanted = searched(catalog, fault)
    answers = wrong = 0
    for _ in range(count):
        given = draw(catalog, rng, fault, altitudes_m=(60e3, 150e3), least_px=10.0)
        truth = given.view.gTb.copy()
        truth[:3, 3] *= wanted.body.radius_m / MOON.radius_m
        towards = truth[:3, 3] / np.linalg.norm(truth[:3, 3])
        sun = towards + np.tan(np.radians(rng.uniform(30.0, 65.0))) * aside(towards, rng)
        sun /= np.linalg.norm(sun)
        error = np.concatenate(
            [ATTITUDE_SIGMA_RAD * rng.normal(size=3), POSITION_SIGMA_M * rng.normal(size=3)]
        )
        prior = truth.copy()
        prior[:3, :3] = truth[:3, :3] @ frames.rotation_exp(error[:3])
        prior[:3, 3] += error[3:]
        covariance = np.diag(np.repeat([ATTITUDE_SIGMA_RAD**2, POSITION_SIGMA_M**2], 3))
        rims = detected(given, sun, fault, rng)
        found = acquire_from_rims(rims, given.camera, wanted, prior, covariance, sun)
        if found is not None:
            answers += 1
            off = np.concatenate(
                [frames.rotation_log(found.gTb[:3, :3].T @ truth[:3, :3]), truth[:3, 3] - found.gTb[:3, 3]]
            )
            wrong += not off @ np.linalg.solve(found.pose_covariance, off) < FAR2
    return answers, wrong


def aside(up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw a horizontal unit vector."""
    v = np.cross(up, rng.normal(size=3))
    return v / np.linalg.norm(v)


def detected(given: Given, sun: np.ndarray, fault: str | None, rng: np.random.Generator) -> DetectedRims:
    """Return the rims as a detector finds them, with the direction in which each one's wall is darkest."""
    gTc = given.view.gTb @ given.view.camera.bTc
    # Where the shading of level ground points, about the middle of the image.
    up = gTc[:3, 3] / np.linalg.norm(gTc[:3, 3])
    _, gain = flat_terrain_brightness(up[None], sun, -gTc[None, :3, 2])
    x, y, _ = gain[0] @ gTc[:3, :3]
    sunward = np.arctan2(y, x) + SUNWARD_SIGMA_RAD * rng.normal(size=len(given.ellipses_px))
    if fault == "mirrored":
        sunward = np.pi - sunward
    order = np.argsort(-given.ellipses_px[:, 2:4].prod(axis=1))
    charts, covariance = given.normalised()
    return DetectedRims(
        chart_of_axes(given.ellipses_px)[order], charts[order], covariance[order], sunward[order]
    )


# --- re-association ---


def reassociated(catalog: Catalog, fault: str | None, count: int) -> tuple[int, int]:
    """Numbers of rims that are given, at the right pose, a crater, and of those given a wrong one."""
    rng = np.random.default_rng(32)
    wanted = searched(catalog, fault)
    named = wrong = 0
    for _ in range(count):
        given = draw(catalog, rng, fault)
        charts, covariance = given.normalised()
        n = len(charts)
        rims = RimSet(rng.permutation(len(wanted))[:n], charts, covariance)
        gTb = given.view.gTb.copy()
        gTb[:3, 3] *= wanted.body.radius_m / MOON.radius_m
        found = rematched(rims, np.zeros(n, dtype=np.bool_), gTb, given.camera, wanted, LIMIT2)
        named += int(np.sum(found != NO_CRATER))
        right = found == given.view.craters if fault is None else np.zeros(n, dtype=np.bool_)
        wrong += int(np.sum((found != NO_CRATER) & ~right))
    return named, wrong


# --- tests ---


def test_the_beds_have_right_answers(catalog: Catalog) -> None:
    """Without a fault nearly all views are answered, and rightly."""
    for bed in (identified, acquired):
        answers, wrong = bed(catalog, None, 6)
        assert answers >= 5, bed.__name__
        assert wrong == 0, bed.__name__
    named, wrong = reassociated(catalog, None, 6)
    assert named > 100
    assert wrong == 0


@pytest.mark.parametrize("fault", FAULTS)
def test_no_wrong_answer(catalog: Catalog, fault: str) -> None:
    for bed in (identified, acquired, reassociated):
        if bed is not reassociated or fault in AT_A_POSE:
            assert bed(catalog, fault, FEW)[1] == 0, bed.__name__


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("bed", [identified, acquired])
def test_no_wrong_answer_of_many(catalog: Catalog, bed, fault: str, many: int) -> None:
    assert bed(catalog, fault, many)[1] <= many // 1000


@pytest.mark.slow
@pytest.mark.parametrize("fault", AT_A_POSE)
def test_one_rim_of_a_thousand_is_given_a_wrong_crater(catalog: Catalog, fault: str, many: int) -> None:
    """Each view has twelve rims or more."""
    assert reassociated(catalog, fault, many)[1] <= 12 * many // 1000
