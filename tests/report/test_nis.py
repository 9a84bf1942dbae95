"""The report's table of innovations agrees with the warnings of the run."""

import numpy as np
import pytest

from craternav_fg.evaluation.innovations import Innovations
from craternav_fg.pipeline import warnings
from craternav_fg.reports.page import Table
from craternav_fg.reports.run_page import nis_blocks


@pytest.mark.parametrize("images", [False, True])
@pytest.mark.parametrize("mean", [0.5, 1.05, 1.2, 1.45, 1.6, 2.5, 12.0])
@pytest.mark.parametrize("count", [4, 100, 5000])
def test_the_report_marks_the_sensors_that_warnings_name(mean: float, count: int, images: bool) -> None:
    """Before, the report marked those above 3, and warnings began from 1.1 and 1.5."""
    one = Innovations(
        ("imu",) * count, np.arange(count), np.full(count, mean), np.ones(count, dtype=np.int64)
    )
    named = warnings.inconsistent_sensors("ekf", one, {}, images=images)
    table, _ = nis_blocks({"filter": "ekf", "images": images, "nis": one.as_dict()})
    assert isinstance(table, Table)
    (cells,) = [cells for _, cells in table.rows]
    assert cells[1].concern == cells[4].concern == any("contradicts" in text for text in named)
    assert (cells[4].text == "contradicts the others") == cells[4].concern
