"""The notebooks run from top to bottom in an empty folder, and use the public interface alone."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import nbformat
import pytest
from nbclient import NotebookClient

import craternav_fg
from tests.shared_data import shared

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
MAX_IMPORTS = 3
# The quick tests have six minutes, the notebooks take as long: the quick tests run one, and see that what
# the others call exists and takes what they pass.
QUICK = "01_descent"
# Files beside the project without which a notebook ends at its first cell.
NEEDED = {"09_real_ground": ("lu1319381.parquet", "gld100/gld100_256ppd_southern_highlands.tif")}
EXECUTED = [
    pytest.param(path, marks=() if path.stem == QUICK else pytest.mark.slow, id=path.stem)
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


def tree_of(path: Path) -> ast.Module:
    lines = "\n".join(cell.source for cell in code_of(path)).splitlines()
    return ast.parse("\n".join(line for line in lines if not line.startswith("%")))


def calls_of(path: Path) -> Iterator[tuple[ast.Call, object]]:
    """Calls of the package's functions, and what they call; a name that does not exist is an error."""
    known: dict[str, object] = {"cn": craternav_fg}

    def meant(node: ast.expr) -> object:
        if isinstance(node, ast.Name):
            return known.get(node.id)
        if isinstance(node, ast.Attribute) and isinstance(of := meant(node.value), ModuleType | type):
            return getattr(of, node.attr)
        return None

    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                pairs = (
                    zip(target.elts, node.value.elts, strict=True)
                    if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                    else [(target, node.value)]
                )
                known.update({one.id: meant(of) for one, of in pairs if isinstance(one, ast.Name)})
        if isinstance(node, ast.Attribute):
            meant(node)
        if isinstance(node, ast.Call) and callable(called := meant(node.func)):
            yield node, called


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_what_they_call_exists_and_takes_what_they_pass(path: Path) -> None:
    count = 0
    for call, called in calls_of(path):
        if any(isinstance(argument, ast.Starred) for argument in call.args):
            continue
        named = {word.arg: None for word in call.keywords if word.arg}
        bind = inspect.signature(called).bind_partial if len(named) < len(call.keywords) else None
        try:
            (bind or inspect.signature(called).bind)(*call.args, **named)
        except TypeError as error:
            pytest.fail(f"{ast.unparse(call)}: {error}")
        count += 1
    assert count >= 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_they_use_the_public_interface(path: Path) -> None:
    tree = tree_of(path)
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
