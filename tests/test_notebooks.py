"""The notebooks run from top to bottom in an empty folder, and use the public interface alone."""

import ast
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.shared_data import shared

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
MAX_IMPORTS = 3
# The quick tests have six minutes; these five take four.
SLOW = (
    "02_measurement_equations", "04_ekf_vs_smoother", "06_lost_in_space", "07_apollo15", "09_real_ground",
)  # fmt: skip
# Files beside the project without which a notebook ends at its first cell.
NEEDED = {"09_real_ground": ("lu1319381.parquet", "gld100/gld100_256ppd_southern_highlands.tif")}
EXECUTED = [
    pytest.param(path, marks=pytest.mark.slow if path.stem in SLOW else (), id=path.stem)
    for path in NOTEBOOKS
]  # fmt: skip


def code_of(path: Path) -> list[nbformat.NotebookNode]:
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


@pytest.mark.parametrize("path", EXECUTED)
def test_they_run_anywhere_without_earlier_commands(path: Path, tmp_path: Path) -> None:
    for name in NEEDED.get(path.stem, ()):
        shared(name)
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_they_use_the_public_interface(path: Path) -> None:
    lines = "\n".join(cell.source for cell in code_of(path)).splitlines()
    tree = ast.parse("\n".join(line for line in lines if not line.startswith("%")))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    ours = [ast.unparse(node) for node in imports if "craternav_fg" in ast.unparse(node)]
    assert ours == ["import craternav_fg as cn"]
    assert len(imports) <= MAX_IMPORTS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_they_keep_their_outputs_and_stay_small(path: Path) -> None:
    code = code_of(path)
    # The first may import and make the data only.
    assert all(cell.outputs for cell in code[1:])
    assert path.stat().st_size < 300_000
    assert sum(cell.source.count("\n") + 1 for cell in code) <= 150
    assert any('"dpi": 110' in cell.source for cell in code)


def test_the_page_on_apollo_15_states_the_figures_of_its_notebook() -> None:
    cells = code_of(next(path for path in NOTEBOOKS if path.stem == "07_apollo15"))
    printed = "".join(output.get("text", "") for cell in cells for output in cell.outputs)
    page = (NOTEBOOKS[0].parents[1] / "docs" / "howto" / "apollo15.md").read_text(encoding="utf-8")
    for row, line in (
        ("| smoother minus SPICE, mean of six frames |", "mean east, north, up:"),
        ("| scatter about the mean |", "scatter:"),
    ):
        stated = re.findall(r"(−?\d+) m", page.partition(row)[2])[:3]
        found = re.findall(r"(-?\d+)\.", printed.partition(line)[2])[:3]
        assert [int(text.replace("−", "-")) for text in stated] == [int(text) for text in found]
