"""The notebooks run from top to bottom, the first and the last on what the tests make."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from craternav_fg.campaign import run
from craternav_fg.campaign.run import CampaignOptions
from tests import descents
from tests.campaign import inline
from tests.cli.calls import craternav
from tests.cli.test_command_line import short_scenario

NOTEBOOKS = Path(__file__).parent.parent / "notebooks"


def execute(name: str) -> None:
    notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()


def test_01_descent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = craternav("demo", "--scenario", short_scenario(tmp_path), "-o", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    monkeypatch.setenv("CRATERNAV_RUN", str(tmp_path / "run"))
    execute("01_descent.ipynb")


def test_02_measurement_equations() -> None:
    execute("02_measurement_equations.ipynb")


def test_03_static_pose() -> None:
    execute("03_static_pose.ipynb")


def test_04_ekf_vs_smoother(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = craternav("reproduce", "fig17", "--descents", "2", "-o", tmp_path / "figures")
    assert done.returncode == 0, done.stderr
    monkeypatch.setenv("CRATERNAV_REPRODUCTION", str(tmp_path / "figures"))
    execute("04_ekf_vs_smoother.ipynb")


def test_05_monte_carlo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "processes", inline.processes)
    chosen = CampaignOptions(trials=6, estimators=("smoother", "online", "ekf", "dead_reckoning"))
    run.montecarlo(descents.scenario(duration_s=20.0), tmp_path / "campaign", chosen)
    monkeypatch.setenv("CRATERNAV_CAMPAIGN", str(tmp_path / "campaign"))
    execute("05_monte_carlo.ipynb")


def test_06_lost_in_space(monkeypatch: pytest.MonkeyPatch) -> None:
    # On synthetic craters, whatever lies beside the project.
    monkeypatch.setenv("CRATERNAV_CATALOG", "none")
    execute("06_lost_in_space.ipynb")


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda p: p.stem)
def test_notebooks_keep_their_outputs_and_stay_small(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs for cell in code[1:])
    assert path.stat().st_size < 300_000
    assert sum(cell.source.count("\n") + 1 for cell in code) <= 150
