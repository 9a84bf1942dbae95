"""A catalogue improved by images whose poses are known."""

import json
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.store import read_parquet, write_parquet
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.mapping.apply_errors import RunOutcome, apply_errors
from craternav_fg.mapping.posed_images import (
    IMAGES_PER_VIEW,
    combined,
    map_errors_of_rims,
    rims_in_posed_images,
)
from craternav_fg.measurements import RimSet
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from factors.kernels import conic
from tests.cli.calls import call
from tests.descents import scenario
from tests.shared_data import FOLDER, shared

SHARE = 0.04


def moved(catalog, errors):
    """Move each rim by errors (n, 5), in radii and shares."""
    of_all = {
        row: (np.insert(error, 2, 0.0), np.full(6, 1e-6)) for row, error in enumerate(np.asarray(errors))
    }
    return replace(apply_errors(catalog, of_all).catalog, errors=None)


def relative_errors(catalog, truth):
    """Distances of the centres (n,) and logarithms of sizes (n,), in radii of the truth."""
    radius_m = np.sqrt(truth.semi_major_m * truth.semi_minor_m)
    off = np.linalg.norm(catalog.centres - truth.centres, axis=1) / radius_m
    return off, np.log(np.sqrt(catalog.semi_major_m * catalog.semi_minor_m) / radius_m)


@pytest.fixture(scope="module")
def analytic(tmp_path_factory):
    return Dataset.open(simulate(scenario(duration_s=20.0), tmp_path_factory.mktemp("analytic") / "data"))


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Rendered descent of nine images, whose catalogue is that of its ground."""
    case = load_scenario("lunar_descent")
    trajectory = case.trajectory.model_copy(update={"frame_interval_s": 25.0})
    case = case.model_copy(update={"trajectory": trajectory})
    return Dataset.open(simulate(case, tmp_path_factory.mktemp("flight") / "data"))


@pytest.fixture(scope="module")
def published(flight):
    """Its catalogue with errors of four per cent, which it states, and a common shift."""
    rng = np.random.default_rng(5)
    truth, n = flight.catalog, len(flight.catalog)
    shape = SHARE * rng.standard_normal((n, 1)) * [1.0, 0.0, 1.0]
    found = moved(truth, np.column_stack([SHARE * rng.standard_normal((n, 2)), shape]))
    radius_m = np.sqrt(found.semi_major_m * found.semi_minor_m)
    stated = MapErrors(SHARE * radius_m, np.full(n, SHARE), np.zeros(n))
    return replace(found, errors=stated, common_shift=CommonShift.of_source(n, 80.0, 20.0))


@pytest.fixture(scope="module")
def corrected(flight, published):
    calls = []
    found = rims_in_posed_images(
        published, [flight], progress=lambda done, total: calls.append((done, total))
    )
    return found, calls


def test_errors_follow_exactly_from_rims(analytic):
    rng = np.random.default_rng(1)
    n = len(analytic.catalog)
    for size in (0.01, 0.1, 0.2):
        errors = size * rng.uniform(-1.0, 1.0, (n, 5))
        truth = moved(analytic.catalog, errors)
        gTb = analytic.truth.gTb[3]
        charts, _, seen = conic.chart_jacobian(gTb, analytic.camera.bTc, truth.centres, truth.axes)
        assert seen.all()
        rims = RimSet(np.arange(n), charts, np.tile(np.eye(5), (n, 1, 1)))
        found = map_errors_of_rims(rims, gTb, analytic.camera, analytic.catalog)
        back = moved(analytic.catalog, found)
        # The moved rims are level at their own places: a tenth of a radius of 2 km turns them by 1e-4.
        radius_m = np.sqrt(truth.semi_major_m * truth.semi_minor_m)
        assert np.linalg.norm(back.centres - truth.centres, axis=1).max() < 3e-4 * radius_m.max()
        np.testing.assert_allclose(back.semi_major_m, truth.semi_major_m, rtol=3e-4)
        np.testing.assert_allclose(back.semi_minor_m, truth.semi_minor_m, rtol=3e-4)


def test_an_ellipse_that_is_no_rim_has_no_errors(analytic):
    charts = analytic.measurements[3].rims.chart[:1].copy()
    charts[:, 2:] += 3.0
    rims = RimSet(analytic.measurements[3].rims.craters[:1], charts, np.eye(5)[None])
    found = map_errors_of_rims(rims, analytic.truth.gTb[3], analytic.camera, analytic.catalog)
    assert np.isnan(found).all()
    assert map_errors_of_rims(RimSet.empty(), np.eye(4), analytic.camera, analytic.catalog).shape == (0, 5)


def test_single_images_of_a_later_flight_err_as_stated(analytic):
    """Errors that neighbouring images share, by blocks, drawn anew for the flight that is predicted."""
    rng = np.random.default_rng(2)
    rows, block = range(4000), int(IMAGES_PER_VIEW)
    catalog = analytic.catalog
    catalog = catalog.take(np.zeros(4000, dtype=np.int64))
    truth = 0.1 * rng.standard_normal((4000, 5))

    def images(row, blocks):
        return np.repeat(truth[row] + 0.03 * rng.standard_normal((blocks, 5)), block, axis=0)

    found = combined(catalog, {row: images(row, 1 + row % 4) for row in rows})
    later = np.array([images(row, 1)[0] for row in rows])
    in_plane = [0, 1, 3, 4, 5]
    normalised = np.array([(later[row] - found[row][0][in_plane]) / found[row][1][in_plane] for row in rows])
    assert 0.9 < np.mean(normalised**2) < 1.3
    # As seen in more images, so are they better known.
    sigma = np.array([found[row][1][0] for row in rows])
    by_count = [sigma[k::4].mean() for k in range(4)]
    assert sorted(by_count, reverse=True) == by_count


def test_a_crater_in_few_images_alone_is_not_corrected(analytic):
    few = {0: np.zeros((int(IMAGES_PER_VIEW), 5))}
    assert combined(analytic.catalog, few) == {}
    assert combined(analytic.catalog, {}) == {}


def test_one_wrong_rim_in_seven_hardly_counts(analytic):
    rng = np.random.default_rng(3)
    errors = 0.01 * rng.standard_normal((7, 5))
    errors[4] += 0.4
    error = combined(analytic.catalog, {0: errors})[0][0]
    assert np.abs(error[[0, 1, 3, 4, 5]]).max() < 0.02


def test_rims_come_to_where_the_images_show_them(flight, published, corrected):
    found, calls = corrected
    done = np.array([one is RunOutcome.REFINED for one in found.outcomes])
    assert np.count_nonzero(done) >= 20
    before, after = (relative_errors(one, flight.catalog) for one in (published, found.catalog))
    for one, other in zip(before, after, strict=True):
        assert np.median(np.abs(other[done])) < 0.25 * np.median(np.abs(one[done]))
    # Nothing is stated better than it is, and the rest is as it was.
    stated = found.catalog.errors.place_m / np.sqrt(found.catalog.semi_major_m * found.catalog.semi_minor_m)
    assert np.mean((after[0][done] / stated[done]) ** 2) < 2.5
    assert np.median(stated[done]) < 0.5 * SHARE
    np.testing.assert_array_equal(found.catalog.centres[~done], published.centres[~done])
    np.testing.assert_array_equal(found.catalog.errors.place_m[~done], published.errors.place_m[~done])
    assert set(found.catalog.common_shift.place_m[done]) == {0.0}
    assert set(found.catalog.common_shift.place_m[~done]) == {80.0}
    total = 2 * len(flight.image_paths)
    assert calls == [(k + 1, total) for k in range(total)]
    # The shift that is told is that from the first place to the last.
    off_m = np.linalg.norm(found.catalog.centres - published.centres, axis=1)
    np.testing.assert_allclose(np.linalg.norm(found.shift_m[done], axis=1), off_m[done], atol=1e-6)


def test_what_gives_no_poses_or_no_images_is_refused(analytic, flight, published):
    with pytest.raises(InputError, match="expected a ground truth: it gives the poses"):
        rims_in_posed_images(published, [replace(flight, truth=None)])
    with pytest.raises(InputError, match="expected images, found measured rims"):
        rims_in_posed_images(analytic.catalog, [analytic])
    with pytest.raises(InputError, match=r"expected a body of radius 1\.7374e\+06 m, found 1e\+06 m"):
        rims_in_posed_images(published, [replace(flight, body=replace(flight.body, radius_m=1e6))])


def test_the_command(flight, published, corrected, tmp_path):
    map_of, better = tmp_path / "map.parquet", tmp_path / "better.parquet"
    write_parquet(map_of, published)
    options = ("--posed-images", flight.path, "-o", better, "--json")
    result = call("catalog", "refine", map_of, *options)
    assert result.code == 0, result.err
    values = json.loads(result.out)
    assert values["outcomes"] == corrected[0].counts()
    written = read_parquet(better, None)
    place = {name: row for row, name in enumerate(corrected[0].catalog.identifiers)}
    rows = np.array([place[name] for name in written.identifiers])
    np.testing.assert_allclose(written.centres, corrected[0].catalog.centres[rows], atol=0.01)
    both = call("catalog", "refine", map_of, "--dem", map_of, "--posed-images", flight.path)
    assert both.code == 2
    assert "expected one of --dem, --run and --posed-images" in both.err


@pytest.mark.slow
def test_a_rehearsal_over_real_ground_halves_the_errors_of_a_later_flight(tmp_path):
    """Another trial of the scenario: other sensor noise, and other ground below the model's resolution."""
    shared("gld100/gld100_256ppd_posidonius.tif")
    shared("lu1319381.parquet")
    case = load_scenario("gld100_mixed").with_data(FOLDER)
    rehearsal, flight = (Dataset.open(simulate(case, tmp_path / f"{trial}", trial=trial)) for trial in (7, 1))
    seen = rims_in_posed_images(flight.catalog, [rehearsal]).catalog
    rms_m = []
    for catalog in (flight.catalog, seen):
        trajectory = reconstruct(replace(flight, catalog=catalog), ["smoother"]).trajectories["smoother"]
        rms_m.append(np.sqrt(np.mean(np.sum((trajectory.gP - flight.truth.gP) ** 2, axis=1))))
    assert rms_m[1] < 0.6 * rms_m[0]
