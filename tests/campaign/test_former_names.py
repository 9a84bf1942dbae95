"""Campaigns of earlier versions are read under the estimators' present names."""

import json
from pathlib import Path

import pyarrow as pa

from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.trial import FILTERED_BOUND, SCHEMA, SMOOTHED_BOUND, TrialResult, _parquet
from craternav_fg.campaign.write import CampaignFolder
from tests.campaign.test_summary import estimate, rows

FORMER, PRESENT = "calibrating_smoother", "self_calibrating_smoother"
FIGURES = {
    "trajectories": 1,
    "converged": 1,
    "position_final_mean_m": 3.0,
    "position_final_rms_m": 3.0,
    "attitude_final_mean_deg": 0.1,
    "rms_over_pcrb": None,
    "anees": 6.0,
    "time_per_trial_s": 2.0,
}


def test_former_names_are_read_as_the_present_ones(tmp_path: Path) -> None:
    bounds = (FILTERED_BOUND, SMOOTHED_BOUND)
    table = estimate(0, FORMER, 3.0, 0.1, 6.0)
    table += [row for name in bounds for row in rows(0, name, pose_sigma=[1.0] * 6)]
    columns = {field.name: [row.get(field.name) for row in table] for field in SCHEMA}
    folder = CampaignFolder(tmp_path, {"estimators": [FORMER, "mapping_smoother"]})
    with folder.open():
        failures = {"mapping_smoother": "mapping_smoother: no convergence"}
        folder.add(
            TrialResult(0, _parquet(pa.table(columns, schema=SCHEMA), 0, None, failures), {FORMER: 2.0}, None)
        )
        counts = {"trials": 1, "failed": 0, "wall_s": 2.0}
        folder.write_summary({**counts, "estimators": {FORMER: FIGURES}})
    campaign = read_campaign(tmp_path)
    assert campaign.identity["estimators"] == [PRESENT, "map_refining_smoother"]
    assert set(campaign.table["estimator"].to_pylist()) == {PRESENT, *bounds}
    assert list(campaign.failures[0]) == ["map_refining_smoother"]
    assert campaign.times_s == {0: {PRESENT: 2.0}}
    assert campaign.summary["estimators"] == {PRESENT: FIGURES}
    # What is on disk stays as it was written.
    assert FORMER in json.loads((tmp_path / "summary.json").read_text())["estimators"]


def test_a_campaign_under_former_names_goes_on(tmp_path: Path) -> None:
    with CampaignFolder(tmp_path, {"estimators": [FORMER]}).open():
        pass
    assert FORMER in (tmp_path / "campaign.toml").read_text()
    # Another campaign's folder would be refused.
    assert CampaignFolder(tmp_path, {"estimators": [PRESENT]}).numbers() == set()
