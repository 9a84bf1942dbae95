"""Runs of earlier versions are read under today's names of columns and estimators."""

from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from craternav_fg.runs.read import read_residuals
from craternav_fg.runs.store import RESIDUALS
from tests.runs.tables import residuals


def write(path: Path, estimators: list[str], **columns: Any) -> None:
    pq.write_table(residuals(estimators, **columns), path / RESIDUALS)


def test_the_slope_contrast_is_read_under_its_former_name(tmp_path: Path) -> None:
    write(tmp_path, ["smoother"], gain=[0.7], rms_px=[0.2])
    table = read_residuals(tmp_path)
    assert table["slope_contrast"].to_pylist() == [0.7]
    assert table["rms_px"].to_pylist() == [0.2]


def test_estimators_are_read_under_their_present_names(tmp_path: Path) -> None:
    write(tmp_path, ["smoother", "calibrating_smoother", "mapping_smoother"])
    table = read_residuals(tmp_path)
    assert table["estimator"].to_pylist() == [
        "smoother", "self_calibrating_smoother", "map_refining_smoother"
    ]  # fmt: skip
