"""A short run with overlays of its frames, as a reader of a report has it."""

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.reports.page import write_page
from craternav_fg.reports.run_page import run_page
from craternav_fg.runs.execute import execute_run
from craternav_fg.runs.read import read_run
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario

ESTIMATORS = ("smoother", "ekf", "ekf_paper", "dead_reckoning")
SCRIPT = "<script>document.title='taken'</script>"
NAMES = {
    "smoother": f'"><img src=x onerror=document.title=1>{SCRIPT}',
    "ekf": "']; alert(1); ['$\\frac{$ </svg><svg onload=alert(1)>",
    "ekf_paper": "_{{ page }} & <b>",
}


@pytest.fixture(scope="session")
def made_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run; tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("report") / "run"
    folder.mkdir()
    data = simulate(scenario(duration_s=10.0), folder / "dataset")
    execute_run(Dataset.open(data), folder, ESTIMATORS, label="dataset", began_s=time.perf_counter())
    (folder / "overlays").mkdir()
    for number in range(3):
        picture = np.full((40, 1400, 3), 60 * number, np.uint8)
        cv2.imwrite(str(folder / "overlays" / f"frame_{number:04d}.png"), picture)
    return folder


def changed(path: Path, column: str, change: Callable[[str], str]) -> None:
    """Change the texts of a column of a Parquet file."""
    table = pq.read_table(path)
    values = pa.array([change(value) for value in table[column].to_pylist()])
    pq.write_table(table.set_column(table.column_names.index(column), column, values), path)


@pytest.fixture(scope="session")
def hostile_page(made_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of a run whose every name, text and identifier tries to be a script."""
    here = tmp_path_factory.mktemp("hostile")
    run = here / "<img src=x onerror=document.title=2>"
    shutil.copytree(made_run, run)
    for name in ("states.parquet", "residuals.parquet"):
        changed(run / name, "estimator", lambda name: NAMES.get(name, name))
    changed(run / "residuals.parquet", "crater_id", lambda one: f"{one}{SCRIPT}")
    text = (run / "metrics.json").read_text()
    metrics: dict[str, Any] = json.loads(text)
    for part in ("estimators", "times_s"):
        metrics[part] = {NAMES.get(name, name): each for name, each in metrics[part].items()}
    metrics["warnings"] = [SCRIPT, "{{ page }}"]
    nis = {"mean": 1.0, "low": 0.9, "high": 1.1, "dimension": 5}
    metrics["innovations"] = {"filter": SCRIPT, "nis": {SCRIPT: nis}}
    (run / "metrics.json").write_text(json.dumps(metrics))
    (run / "run.toml").write_text(f'dataset = "{SCRIPT}"\nestimators = []\n')
    for picture in list((run / "overlays").glob("*.png")):
        picture.rename(picture.with_name(f"a onerror=document.title=3 {SCRIPT.replace('/', '')}.png"))
    page = here / "report.html"
    write_page(run_page(read_run(run)), page)
    return page
