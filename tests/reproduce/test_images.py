"""Table 2 and fig. 10 from a few rendered images."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from craternav_fg.ellipse import axes_of_chart
from craternav_fg.reproduce import run, table2, table2_trials
from craternav_fg.reproduce.canny_rim import canny_rim
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED
from craternav_fg.simulation.flat_scenes import CAMERA
from craternav_fg.simulation.paper_scenes import four_craters

FEW = ReproduceOptions(images=2, workers=1)


@pytest.fixture(scope="module")
def coefficient_data() -> pa.Table:
    return table2_trials.simulate(FEW)


def test_canny_edges_lie_inside_the_crest() -> None:
    one = four_craters(1)
    true = one.ellipses_px
    for k, row in enumerate(one.craters):
        chart = canny_rim(one, int(row))
        assert chart is not None
        x, y, a, b, _ = axes_of_chart(chart[None])[0]
        assert np.hypot(x - true[k, 0], y - true[k, 1]) < 3.0
        assert true[k, 2] - 4.0 < a < true[k, 2] + 0.2
        assert true[k, 3] - 4.0 < b < true[k, 3] + 0.2


def test_coefficients_have_the_errors_of_their_ellipses(coefficient_data: pa.Table) -> None:
    """Near-circular rims: A and C err with the axes' difference, D and E on the axis with the centre."""
    columns = {name: coefficient_data[name].to_numpy() for name in coefficient_data.column_names}
    assert len(columns["image"]) == 10
    found = np.isfinite(columns["guided_A"])
    assert found.mean() >= 0.8
    size = np.sqrt(columns["semi_major_px"] * columns["semi_minor_px"])[found]
    axes = np.hypot(columns["guided_semi_major_px"], columns["guided_semi_minor_px"])[found]
    assert np.all(np.abs(columns["guided_A"][found]) < 3.0 * axes / size + 1e-2)
    # D = -2 A u: a centre error of e px on the axis is one of 2 A e / f, A of about 0.7.
    shift = np.hypot(columns["guided_D_central"], columns["guided_E_central"])[found]
    expected = 2.0 * np.sqrt(0.5) * columns["guided_centre_px"][found] / CAMERA.fx_px
    assert np.median(shift / expected) == pytest.approx(1.0, abs=0.15)
    assert np.nanmedian(np.abs(columns["canny_semi_minor_px"])) > 0.4


def test_table2_has_a_row_for_each_coefficient_and_altitude(coefficient_data: pa.Table) -> None:
    result = table2.table2(coefficient_data, FEW)
    shown = [row for row in result.rows if row.headline]
    assert len(shown) == 6 * (5 + 1)
    printed = {(row.quantity, row.condition): row.paper for row in shown}
    assert printed["standard deviation of B", "20 km, 2 images"] == 8.59e-3
    assert printed["standard deviation of F", "in Qn, against all altitudes"] == pytest.approx(1.5e-8**0.5)
    for row in shown:
        assert row.efficient is None or 1e-6 < row.efficient < 0.1
    assert "out of line" in next(row.verdict for row in shown if row.condition.startswith("50 km"))
    assert "nan" not in result.note


def test_fig10_is_written_with_its_rows(tmp_path: Path) -> None:
    results = run.reproduce(("fig10",), FEW)
    run.write(tmp_path, results, FEW)
    rows = json.loads((tmp_path / "reproduction.json").read_text())
    count = rows[0]
    assert (count["quantity"], count["efficient"], count["corrected"]) == ("craters found", 4.0, 4.0)
    ours = [row["efficient"] for row in rows[1:]]
    theirs = [row["as_printed"] for row in rows[1:]]
    assert max(ours) < 0.4
    assert np.mean(theirs) > 3.0 * np.mean(ours)
    assert {path.name for path in tmp_path.iterdir()} == {
        "fig10.png", "fig10.parquet", "reproduction.json", "reproduction.md",
    }  # fmt: skip


def test_the_same_seed_gives_the_same_images() -> None:
    batch = table2_trials.Batch(50, 1, 0, 1)
    first, again = table2_trials.run_batch(batch), table2_trials.run_batch(batch)
    np.testing.assert_equal(first, again)
    other = table2_trials.run_batch(table2_trials.Batch(50, 2, 0, 1))
    assert other[0]["semi_major_px"] != first[0]["semi_major_px"]
    assert {CANNY, BLIND, GUIDED} == {name.split("_")[0] for name in first[0] if name.endswith("_central")}
