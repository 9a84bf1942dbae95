"""A catalogue improved by the images of descents: simulated rims of a map whose errors are known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import read_parquet, write_parquet
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import points_on
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import Calibration, map_sigmas
from craternav_fg.mapping.apply_errors import RunOutcome, apply_errors
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_tables import FaultsSection
from craternav_fg.simulation.scenes import MOON
from tests.cli.calls import call
from tests.descents import problem, scenario

SHARE = 0.02
TRIALS = 4
FAULTS = FaultsSection(map_place_share=SHARE, map_size_share=SHARE, map_height_share=SHARE)


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Map, truth and the errors that the smoother finds."""
    folder = tmp_path_factory.mktemp("map")
    calibration = Calibration(
        map_place_sigma_share=SHARE, map_height_sigma_share=SHARE, map_size_sigma_share=SHARE
    )
    out = []
    for trial in range(TRIALS):
        p, _ = problem(folder, scenario(duration_s=60.0, faults=FAULTS), trial)
        right, _ = problem(folder, scenario(duration_s=60.0), trial)
        found = BatchSmoother(BatchOptions(calibration=calibration)).estimate(p).calibrated
        out.append((p.catalog, right.catalog, found.map_errors))
    return out


def relative_centres(catalog):
    """Without the shift that all have in common, which no image shows."""
    return catalog.centres - catalog.centres.mean(axis=0)


def test_refined_rims_are_closer_to_the_truth_and_err_as_they_say(trials):
    before, after, sizes_before, sizes_after, normalised, normalised_sizes = ([] for _ in range(6))
    for mapped, truth, errors in trials:
        found = apply_errors(mapped, errors)
        assert set(found.outcomes) == {RunOutcome.REFINED}
        radius_m = np.sqrt(mapped.semi_major_m * mapped.semi_minor_m)
        before.append((relative_centres(mapped) - relative_centres(truth)) / radius_m[:, None])
        after.append((relative_centres(found.catalog) - relative_centres(truth)) / radius_m[:, None])
        off = np.einsum("nij,ni->nj", truth.gRl, truth.centres - found.catalog.centres)
        normalised.append(off / found.sigma_m)
        for catalog, sizes in ((mapped, sizes_before), (found.catalog, sizes_after)):
            sizes.append(np.log(catalog.semi_major_m / truth.semi_major_m))
        normalised_sizes.append(sizes_after[-1] / found.catalog.errors.size_share)
        # The errors that are left are smaller than those of the map.
        assert np.all(found.catalog.errors.place_m < SHARE * radius_m)
    rms = [float(np.sqrt(np.mean(np.square(part)))) for part in (before, after, sizes_before, sizes_after)]
    assert rms[1] < 0.75 * rms[0]
    assert rms[3] < 0.6 * rms[2]
    for part in (normalised, normalised_sizes):
        count = np.size(part)
        low, high = chi2.ppf([0.001, 0.999], count) / count
        assert low < np.mean(np.square(part)) < high


def test_errors_of_shape_move_the_rim_as_they_are_defined(trials):
    mapped = trials[0][0]
    error = np.array([0.02, -0.03, 0.01, 0.04, 0.03, -0.02])
    found = apply_errors(mapped, {1: (error, np.full(6, 0.01))}).catalog
    a, b = mapped.semi_major_m[1], mapped.semi_minor_m[1]
    rim = points_on(np.array([0.0, 0.0, np.log(a), 0.0, np.log(b)]), 90)
    stretch = np.array([[1.04, 0.03], [0.03, 0.98]])
    plane = np.column_stack([rim @ stretch.T, np.zeros(90)]) + np.sqrt(a * b) * error[:3]
    points = mapped.centres[1] + plane @ mapped.gRl[1].T
    # In the corrected rim's own frame they are a distance of one semi-axis away.
    local = (points - found.centres[1]) @ found.gRl[1]
    unit = np.hypot(local[:, 0] / found.semi_major_m[1], local[:, 1] / found.semi_minor_m[1])
    np.testing.assert_allclose(unit, 1.0, atol=2e-6)
    assert np.abs(local[:, 2]).max() < 0.2


def test_others_keep_their_numbers_and_the_common_shift_stays(trials):
    mapped = trials[0][0]
    n = len(mapped)
    stated = MapErrors(np.full(n, 5.0), np.full(n, 0.01), np.full(n, 5.0))
    shift = CommonShift.of_source(n, 80.0, 20.0)
    known = replace(mapped, errors=stated, common_shift=shift)
    far = (np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), np.full(6, 1e-3))
    near = (np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]), np.full(6, 1e-3))
    found = apply_errors(known, {0: far, 2: near})
    assert found.counts() == {
        "refined": 1, "not seen in the images": n - 2, "the correction is beyond the catalogue's errors": 1,
    }  # fmt: skip
    others = np.arange(n) != 2
    np.testing.assert_array_equal(found.catalog.centres[others], known.centres[others])
    np.testing.assert_array_equal(found.catalog.errors.place_m[others], 5.0)
    assert found.catalog.errors.place_m[2] < 3.0
    np.testing.assert_array_equal(found.catalog.common_shift.place_m, shift.place_m)


@pytest.mark.parametrize("sigma", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("number", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_corrected_rims_show_how_far_the_others_are_off(number, sigma):
    """Their estimates shrink to the prior the more, the less the images show of them."""
    n, prior = 100, 0.02
    radius_m = np.linspace(500.0, 2000.0, n)
    zero = np.zeros(n)
    mapped = Catalog(
        tuple(map(str, range(n))), zero, np.linspace(0.0, 1.0, n), radius_m, radius_m, zero, zero, MOON
    )
    stated = []
    for trial in range(200):
        rng = np.random.default_rng([number, trial])
        true = prior * rng.standard_normal((number, 6))
        share = prior**2 / (prior**2 + sigma**2)
        estimates = share * (true + sigma * rng.standard_normal((number, 6)))
        left = np.full(6, np.sqrt(share) * sigma)
        errors = apply_errors(mapped, {row: (one, left) for row, one in enumerate(estimates)}).catalog.errors
        place, height = (
            errors.place_m[number:] / radius_m[number:],
            errors.height_m[number:] / radius_m[number:],
        )
        np.testing.assert_allclose(place, place[0])
        stated.append([place[0], errors.size_share[-1], height[0]])
    # On the safe side, and closer to the truth the more craters show it.
    mean = np.sqrt(np.mean(np.square(stated), axis=0)) / prior
    assert (mean > 0.97).all()
    assert (mean < (1.3 if number == 8 else 1.05)).all()


def test_few_corrected_rims_show_nothing_of_the_others(trials):
    mapped = trials[0][0]
    radius_m = np.sqrt(mapped.semi_major_m * mapped.semi_minor_m)
    exact = (np.full(6, 1e-4), np.full(6, 1e-4))
    errors = apply_errors(mapped, {2: exact}).catalog.errors
    others = np.arange(len(mapped)) != 2
    assert (errors.place_m[others] > 0.05 * radius_m[others]).all()
    assert (errors.height_m[others] > 0.05 * radius_m[others]).all()
    assert (errors.size_share[others] > 0.05).all()


def test_stated_errors_are_the_prior(trials):
    mapped = trials[0][0]
    radius_m = np.sqrt(mapped.semi_major_m * mapped.semi_minor_m)
    options = Calibration(map_place_sigma_share=0.01, map_height_sigma_share=0.02, map_size_sigma_share=0.03)
    rows = np.array([3, 1])
    np.testing.assert_allclose(map_sigmas(mapped, rows, options)[:, 2], 0.02)
    stated = MapErrors(0.1 * radius_m, np.full(len(mapped), 0.3), np.arange(len(mapped)) * radius_m)
    found = map_sigmas(replace(mapped, errors=stated), rows, options)
    np.testing.assert_allclose(found[:, :3], [[0.1, 0.1, 3.0], [0.1, 0.1, 1.0]])
    np.testing.assert_allclose(found[:, [3, 5]], 0.3)


def test_the_command(tmp_path):
    data = Dataset.open(simulate(scenario(duration_s=60.0, faults=FAULTS), tmp_path / "data", trial=0))
    folder, run = tmp_path / "data", tmp_path / "run"
    options = ("-e", "map_refining_smoother,ekf")
    assert call("reconstruct", folder, "-o", run, *options).code == 0
    map_of, better = tmp_path / "map.parquet", tmp_path / "better.parquet"
    write_parquet(map_of, data.catalog)
    result = call("catalog", "refine", map_of, "--run", run, "-o", better, "--json")
    assert result.code == 0, result.err
    values = json.loads(result.out)
    assert values["outcomes"] == {"refined": len(data.catalog)}
    refined = read_parquet(better, None)
    assert refined.errors is not None
    assert np.abs(refined.height_m - data.catalog.height_m).max() > 1.0
    # Once more from the same run would correct twice.
    again = call("catalog", "refine", better, "--run", run, "-o", tmp_path / "x.parquet")
    assert again.code == 2
    assert "expected the same" in again.err
    both = call("catalog", "refine", map_of, "-o", tmp_path / "x.parquet")
    assert both.code == 2
    assert "expected one of --dem, --run and --posed-images" in both.err
    metrics = json.loads((run / "metrics.json").read_text())
    del metrics["estimators"]["map_refining_smoother"]["calibrated"]
    (run / "metrics.json").write_text(json.dumps(metrics))
    without = call("catalog", "refine", map_of, "--run", run, "-o", tmp_path / "x.parquet")
    assert without.code == 2
    assert "reconstruct with -e map_refining_smoother" in without.err
