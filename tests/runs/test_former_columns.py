"""Runs of earlier versions are read under today's names of columns and estimators."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from craternav_fg.runs.read import read_residuals
from craternav_fg.runs.store import RESIDUALS


def test_the_slope_contrast_is_read_under_its_former_name(tmp_path: Path) -> None:
    pq.write_table(pa.table({"crater_id": ["A"], "gain": [0.7], "rms_px": [0.2]}), tmp_path / RESIDUALS)
    assert read_residuals(tmp_path).to_pylist() == [{"crater_id": "A", "slope_contrast": 0.7, "rms_px": 0.2}]


def test_estimators_are_read_under_their_present_names(tmp_path: Path) -> None:
    former = ["smoother", "calibrating_smoother", "mapping_smoother"]
    pq.write_table(pa.table({"estimator": former, "chi2": [1.0, 2.0, 3.0]}), tmp_path / RESIDUALS)
    table = read_residuals(tmp_path)
    assert table["estimator"].to_pylist() == [
        "smoother", "self_calibrating_smoother", "map_refining_smoother"
    ]  # fmt: skip
