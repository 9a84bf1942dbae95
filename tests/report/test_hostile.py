"""Runs from elsewhere: whatever their names say, a report runs no script of theirs."""

import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from craternav_fg.errors import InputError
from craternav_fg.reports.run_page import run_page
from craternav_fg.reports.svg import inline_svg
from craternav_fg.runs.read import read_run
from tests.report.conftest import changed


def test_a_page_of_hostile_names_has_one_script(hostile_page: Path) -> None:
    html = hostile_page.read_text(encoding="utf-8")
    # The data, Plotly and the page's own: of these three the last one runs.
    assert html.count("<script") == 3
    assert html.count("<script>") == 1
    assert "&lt;script&gt;" in html
    assert "<img src=x" not in html
    # The picture, and the enlarged one.
    assert html.count("<img ") == 2
    assert "onload=alert(1)>" not in html


def test_a_drawing_has_a_plain_name() -> None:
    with pytest.raises(ValueError, match="expected lower-case letters"):
        inline_svg(Figure(), 'bounds-"><script>')


def test_a_name_of_lines_is_refused(made_run: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(made_run, run)
    changed(run / "states.parquet", "estimator", lambda name: name.replace("ekf", "e\nkf"))
    with pytest.raises(InputError, match=r"states\.parquet: estimator: expected an estimator's name of"):
        read_run(run)


@pytest.mark.parametrize("name", ["states.parquet", "residuals.parquet"])
def test_columns_are_checked(name: str, made_run: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(made_run, run)
    table = pq.read_table(run / name)
    for column in table.column_names:
        if table[column].null_count:
            # May be missing, or has no values in this run.
            continue
        for spoilt in (
            table.drop_columns([column]),
            table.set_column(table.column_names.index(column), column, pa.array([b"x"] * len(table))),
            table.append_column(column, table[column]),
        ):
            pq.write_table(spoilt, run / name)
            with pytest.raises(InputError, match=rf"{name}: {column}: "):
                run_page(read_run(run))
    pq.write_table(table.append_column("another", table["estimator"]), run / name)
    run_page(read_run(run))
    pq.write_table(table.filter(pc.not_equal(table["estimator"], "ekf")), run / name)
    if name == "states.parquet":
        with pytest.raises(InputError, match="expected the estimators of"):
            read_run(run)
