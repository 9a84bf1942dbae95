"""Estimates from groups: values and standard errors of cases whose answer is known."""

import numpy as np
import pytest

from craternav_fg.calibration.likelihood import Parameter, Scale, estimate, gaussian_cost
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.errors import EstimationError


def test_a_mean_and_a_standard_deviation():
    rng = np.random.default_rng(0)
    groups = rng.normal(3.0, 0.5, (200, 10))

    def costs(values):
        mean, sigma = values
        return np.sum(np.log(sigma) + 0.5 * ((groups - mean) / sigma) ** 2, axis=1)

    values, errors = estimate(costs, [Parameter(2.0, Scale.LINEAR, 0.1), Parameter(1.0)])
    np.testing.assert_allclose(values, [groups.mean(), groups.std()], rtol=2e-3)
    np.testing.assert_allclose(errors, [0.5 / np.sqrt(2000), 0.5 / np.sqrt(4000)], rtol=0.2)


def test_groups_whose_members_err_alike_tell_less():
    """Each group's members share an error, which the likelihood does not know: the sandwich does."""
    rng = np.random.default_rng(1)
    groups = 0.3 * rng.normal(size=(300, 1)) + 0.1 * rng.normal(size=(300, 8))

    def costs(values):
        return 0.5 * np.sum((groups - values[0]) ** 2, axis=1)

    _, errors = estimate(costs, [Parameter(0.0, Scale.LINEAR, 0.1)])
    assert errors[0] == pytest.approx(np.sqrt((0.3**2 + 0.1**2 / 8) / 300), rel=0.1)


def test_a_share():
    draws = np.random.default_rng(2).uniform(size=(50, 40)) < 0.2

    def costs(values):
        return -np.sum(np.where(draws, np.log(values[0]), np.log1p(-values[0])), axis=1)

    values, errors = estimate(costs, [Parameter(0.5, Scale.LOGIT)])
    assert values[0] == pytest.approx(draws.mean(), rel=1e-2)
    assert errors[0] == pytest.approx(np.sqrt(0.2 * 0.8 / 2000), rel=0.3)


def test_what_the_data_do_not_determine_is_no_estimate():
    with pytest.raises(EstimationError, match="no maximum"):
        estimate(lambda values: np.array([values[0], values[0]]), [Parameter(1.0, Scale.LINEAR, 0.1)])


def test_gaussian_cost_against_a_drawn_density():
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    draws = np.random.default_rng(3).multivariate_normal(np.zeros(2), covariance, 20_000)
    # The mean of -ln p is the entropy, ln(2 pi e) + ln det / 2, less the constant that is left out.
    entropy = 1.0 + 0.5 * np.log(np.linalg.det(covariance))
    assert gaussian_cost(draws, covariance).mean() == pytest.approx(entropy, abs=0.03)
    assert gaussian_cost(draws, 3.0 * covariance).mean() > entropy + 0.3


@pytest.mark.parametrize(
    ("relation", "shipped", "holds"),
    [
        (Relation.FITTED, 1.29, True),
        (Relation.FITTED, 1.31, False),
        (Relation.FITTED, 0.69, False),
        (Relation.EXACT, 1.09, True),
        (Relation.EXACT, 1.11, False),
        (Relation.AT_LEAST, 5.0, True),
        (Relation.AT_LEAST, 0.69, False),
        (Relation.KEPT, 9.0, True),
    ],
)
def test_relations(relation, shipped, holds):
    assert Regenerated("x", shipped, 1.0, 0.1, relation, known=1.2).holds == holds


def test_a_kept_value_must_still_differ_as_it_is_said_to():
    assert not Regenerated("x", 9.0, 1.0, 0.1, Relation.KEPT, known=1.4).holds
