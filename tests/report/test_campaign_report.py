"""The page of a campaign."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from craternav_fg.campaign import run
from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.run import montecarlo
from craternav_fg.campaign.summary import summarise
from craternav_fg.errors import InputError
from craternav_fg.reports.campaign_page import campaign_page
from craternav_fg.reports.page import Table, Text, write_page
from tests.campaign import inline
from tests.campaign.scene import options, small_scenario
from tests.cli.calls import call
from tests.report.conftest import NAMES, SCRIPT, changed
from tests.report.test_report import Reader, data_of


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign") / "c"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "processes", inline.processes)
        montecarlo(small_scenario(), folder, options(3))
    return folder


def test_the_summary_is_that_of_the_campaign(campaign: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    write_page(campaign_page(read_campaign(campaign)), out)
    reader = Reader()
    reader.feed(out.read_text("utf-8"))
    estimators = read_campaign(campaign).summary["estimators"]
    assert [row[0] for row in reader.tables[0][1:]] == list(estimators)
    for row in reader.tables[0][1:]:
        assert int(row[1]) == estimators[row[0]]["converged"]
        assert float(row[3].replace(",", "")) == pytest.approx(
            estimators[row[0]]["position_final_rms_m"], rel=6e-3
        )
    assert len(set(reader.identifiers)) == len(reader.identifiers)
    assert {"errors", "consistency", "final"} <= set(reader.identifiers)


def test_the_command_knows_a_campaign_from_a_run(campaign: Path) -> None:
    assert call("report", campaign).out.strip() == str(campaign / "report.html")
    assert call("report", campaign, "--recording", campaign / "r.rrd").code == 2


def test_an_unfinished_campaign_is_refused(campaign: Path, tmp_path: Path) -> None:
    summary = campaign / "summary.json"
    text = summary.read_text()
    summary.unlink()
    try:
        with pytest.raises(InputError, match="complete the campaign first"):
            campaign_page(read_campaign(campaign))
    finally:
        summary.write_text(text)


@pytest.mark.parametrize(("trials", "set_off"), [(3, False), (300, True)])
def test_an_anees_that_few_trials_explain_is_not_set_off(
    campaign: Path, trials: int, set_off: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = summarise(read_campaign(campaign))
    summary["trials"] = trials
    for values in summary["estimators"].values():
        values["anees"] = 8.0
    monkeypatch.setattr("craternav_fg.reports.campaign_page.summarise", lambda _: summary)
    (table,) = (b for b in campaign_page(read_campaign(campaign)).sections[0].blocks if isinstance(b, Table))
    anees = next(k for k, heading in enumerate(table.headings) if heading.startswith("ANEES"))
    assert {cells[anees].concern for _, cells in table.rows} == {set_off}


def test_a_campaign_that_is_being_extended_is_told(campaign: Path, tmp_path: Path) -> None:
    """The summary is of the trials that are there, not that of the file, which is of fewer."""
    folder = tmp_path / "c"
    shutil.copytree(campaign, folder)
    file = folder / "summary.json"
    written = json.loads(file.read_text())
    written["trials"] = 2
    for values in written["estimators"].values():
        values["trajectories"], values["position_final_rms_m"] = 2, 1e6
    file.write_text(json.dumps(written))
    page = campaign_page(read_campaign(folder))
    told, table = page.sections[0].blocks[:2]
    assert isinstance(told, Text)
    assert told.warning
    assert "this page is of the 3 trials that are there, summary.json of 2" in told.text
    assert page.subtitle.startswith("3 trials")
    assert isinstance(table, Table)
    assert "1,000,000" not in {cell.text for _, cells in table.rows for cell in cells}


def test_an_estimator_with_a_singular_covariance_in_one_trial_stays_on_the_page(
    campaign: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "c"
    shutil.copytree(campaign, folder)
    first = next(iter(read_campaign(campaign).summary["estimators"]))
    path = sorted((folder / "trials").glob("*.parquet"))[1]
    table = pq.read_table(path)
    of_first = np.array(table["estimator"].to_pylist()) == first
    nees = np.where(of_first, np.inf, table["nees"].to_numpy())
    column = table.schema.get_field_index("nees")
    pq.write_table(table.set_column(column, table.schema.field("nees"), pa.array(nees)), path)
    (rows,) = (
        block.rows for section in campaign_page(read_campaign(folder)).sections
        for block in section.blocks if isinstance(block, Table) and "The same in numbers" in block.caption
    )  # fmt: skip
    cells = dict(rows)[first]
    assert cells[0].text == f"{first} (2 of 3 trials)"
    assert all(np.isfinite(cell.key) for cell in cells[1:])
    # The summary has the same rule.
    values = summarise(read_campaign(folder))["estimators"][first]
    assert (values["anees_trials"], values["trajectories"]) == (2, 3)
    assert np.isfinite(values["anees"])
    (summary,) = (
        block for block in campaign_page(read_campaign(folder)).sections[0].blocks if isinstance(block, Table)
    )
    assert f"without a singular covariance: {first} 2 of 3." in summary.caption


def test_the_worst_trial_is_picked_first(campaign: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    found = read_campaign(campaign)
    write_page(campaign_page(found), out)
    spec = data_of(out)["charts"]["trial"]
    names = [trace["name"] for trace in spec["data"]]
    rows = found.table.filter(pc.equal(found.table["estimator"], names[0])).to_pylist()
    final_m = {row["trial"]: float(np.linalg.norm(row["position_error_m"])) for row in rows}
    assert spec["data"][0]["y"] == spec["picked"][0][0]
    assert [curve[-1] for curve in spec["picked"][0]] == pytest.approx(
        sorted(final_m.values(), reverse=True), rel=1e-3
    )
    worst = max(final_m, key=lambda trial: final_m[trial])
    assert f'<option value="0">trial {worst}: ' in out.read_text("utf-8")


def test_a_page_of_hostile_names_has_one_script(campaign: Path, tmp_path: Path) -> None:
    """Names of estimators, reasons of failures and the folder's own name, each a script."""
    folder = tmp_path / "<img src=x onerror=document.title=2>"
    shutil.copytree(campaign, folder)
    first = next(iter(read_campaign(campaign).summary["estimators"]))
    for path in folder.glob("*.toml"):
        path.write_text(path.read_text().replace(f'"{first}"', json.dumps(NAMES["ekf"])))
    for path in [*folder.glob("*.json"), *folder.glob("*.jsonl")]:
        path.write_text(path.read_text().replace(f'"{first}"', json.dumps(NAMES["ekf"])))
    for path in (folder / "trials").glob("*.parquet"):
        changed(path, "estimator", lambda name: NAMES["ekf"] if name == first else name)
        table = pq.read_table(path)
        metadata = {**table.schema.metadata, b"failures": json.dumps({NAMES["smoother"]: SCRIPT}).encode()}
        pq.write_table(table.replace_schema_metadata(metadata), path)
    out = tmp_path / "r.html"
    write_page(campaign_page(read_campaign(folder)), out)
    html = out.read_text(encoding="utf-8")
    assert html.count("<script>") == 1
    assert html.count("<script") == 3
    assert "alert(1)" in html
    for raw in ("<img src=x", "<svg onload", SCRIPT):
        assert raw not in html
