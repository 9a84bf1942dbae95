"""The methods whose cost is compared solve one problem."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

from craternav_fg.bench import scaling
from craternav_fg.bench.problems import Bench, make
from craternav_fg.bench.ratios import batch_graphs
from craternav_fg.estimators.optimise import levenberg_marquardt


@pytest.fixture(scope="module")
def bench() -> Bench:
    return make(12, 4)


def test_scipy_reaches_our_optimum(bench: Bench) -> None:
    ours, _, values = batch_graphs(bench)
    best = ours.error(levenberg_marquardt(ours, values).values)
    found = ours.error(scaling.sparse_gauss_newton(ours, values))
    assert best < 1e-6 * ours.error(values)
    assert found == pytest.approx(best, rel=1e-4)


def test_the_naive_factors_measure_what_ours_do(bench: Bench) -> None:
    ours, _, values = batch_graphs(bench)
    best = levenberg_marquardt(ours, values).values
    naive = scaling.naive_graph(bench, ours)
    of_frames = [ours.at(k) for k in range(ours.size()) if isinstance(ours.at(k), gtsam.CustomFactor)]
    of_craters = [naive.at(k) for k in range(naive.size()) if isinstance(naive.at(k), gtsam.CustomFactor)]
    assert (len(of_frames), len(of_craters)) == (12, 48)
    for number, factor in enumerate(of_frames):
        ours_ab = np.column_stack(factor.linearize(best).jacobian())
        rows = []
        for one in of_craters[4 * number : 4 * number + 4]:
            J, r = one.linearize(best).jacobian()
            # Our loss gives rims beyond 3.3 sigma less weight.
            rows.append(min(1.0, np.sqrt(3.3 / np.linalg.norm(r))) * np.column_stack([J, r]))
        theirs_ab = np.concatenate(rows)
        # Ours are turned into fewer rows, which changes no sum of products.
        scale = np.linalg.norm(theirs_ab, axis=0)
        ours_products, products = ((M / scale).T @ (M / scale) for M in (ours_ab, theirs_ab))
        assert ours_products == pytest.approx(products, abs=1e-6)


def test_costs_of_all_methods(tmp_path: Path) -> None:
    steps = []
    rows = scaling.scaling(lambda *step: steps.append(step), (4,), (2, 3))
    assert steps == [("problems", 1, 2), ("problems", 2, 2)]
    assert [(row["frames"], row["craters"]) for row in rows] == [(4, 2), (4, 3)]
    assert all(row[name] > 0.0 for row in rows for name in scaling.METHODS)
    scaling.write_figure(rows, tmp_path / "scaling.svg")
    assert (tmp_path / "scaling.svg").read_text().count("craters in a frame") >= 2
