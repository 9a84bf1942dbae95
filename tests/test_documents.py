"""README, CONTRIBUTING and docs name modules, files, commands and targets that exist."""

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

from craternav_fg.cli.app import every_command
from craternav_fg.estimators.registry import ESTIMATORS
from craternav_fg.reproduce.run import OTHERS
from craternav_fg.simulation.scenario_file import built_in_scenarios, load_scenario

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")),
]
PACKAGES = {path.parent.name for path in (ROOT / "craternav_fg").glob("*/__init__.py")}
MODULES = {path.stem for path in (ROOT / "craternav_fg").glob("*.py")}


@pytest.fixture(params=DOCUMENTS)
def text(request: pytest.FixtureRequest) -> str:
    return (ROOT / request.param).read_text(encoding="utf-8")


def exists(dotted: str) -> bool:
    """Whether a dotted name is a module of the packages, or is found in one."""
    parts = dotted.split(".")
    if parts[0] not in ("craternav_fg", "factors", "scenarios", "tests"):
        parts.insert(0, "craternav_fg")
    found: object = None
    for k, part in enumerate(parts):
        try:
            found = importlib.import_module(".".join(parts[: k + 1]))
        except ModuleNotFoundError:
            if not hasattr(found, part) and part not in getattr(found, "__dataclass_fields__", {}):
                return False
            found = getattr(found, part, None)
    return True


def test_no_merge_is_left_half_done(text: str) -> None:
    assert not re.findall(r"^(?:<{7}|={7}|>{7})(?: .*)?$", text, re.MULTILINE)


def test_dotted_names(text: str) -> None:
    names = set(re.findall(r"`((?:\w+\.)+\w+)(?:\([^`]*\))?`", text))
    ours = {name for name in names if name.split(".")[0] in {"craternav_fg", "factors", *PACKAGES, *MODULES}}
    endings = (".py", ".toml", ".yaml", ".csv", ".parquet", ".png", ".md", ".html")
    files = {name for name in ours if name.endswith(endings)}
    assert not [name for name in sorted(ours - files) if not exists(name)]


@functools.cache
def members() -> dict[str, set[str]]:
    """Names in the body of each class of the packages."""
    found: dict[str, set[str]] = {}
    for path in (*(ROOT / "craternav_fg").rglob("*.py"), *(ROOT / "factors").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                names = found.setdefault(node.name, set())
                names |= {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
                names |= {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
    return found


def test_members_of_classes(text: str) -> None:
    known = members()
    said = re.findall(r"`([A-Z]\w+)\.(\w+)", text)
    assert not [f"{name}.{member}" for name, member in said if member not in known.get(name, {member})]


def test_files_of_the_project(text: str) -> None:
    paths = re.findall(r"`((?:tests|scenarios|factors|craternav_fg|notebooks|docs|\.ci)/[\w/.]+)`", text)
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_links_of_the_readme() -> None:
    # Those between pages of the documentation are checked by `make docs`.
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if "://" not in link]
    assert links
    assert not [link for link in links if not (ROOT / link).exists()]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_bytes()) <= 8192


def test_python_blocks_compile(text: str) -> None:
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        compile(block, "block", "exec")


def test_code_blocks_import_what_exists(text: str) -> None:
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(node.module or "")
                assert not [alias.name for alias in node.names if not hasattr(module, alias.name)]


def test_commands_and_targets(text: str) -> None:
    said = set(re.findall(r"(?:`|^ {4}|^\$ |^)craternav (\w+)", text, flags=re.MULTILINE))
    assert said <= set(every_command().commands)
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    assert set(re.findall(r"(?:`|^ {4}|^\$ )make ([a-z-]+)", text, flags=re.MULTILINE)) <= targets


def test_estimators_and_scenarios() -> None:
    text = (ROOT / "docs/explanation/estimators.md").read_text(encoding="utf-8")
    table = text.split("| name |")[1].split("\n\n")[0]
    first_cells = " ".join(re.findall(r"^\|([^|]*)\|", table, flags=re.MULTILINE))
    assert sorted(re.findall(r"`(\w+)`", first_cells)) == sorted(ESTIMATORS)
    text = (ROOT / "docs/hard_cases.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(hard_\w+)`", text))
    assert named == {name for name in built_in_scenarios() if name.startswith("hard_")}


def test_hard_cases_are_as_their_scenarios_expect() -> None:
    """The page states two digits of the smoother's position RMS and ANEES, at least one behind the point."""
    text = (ROOT / "docs/hard_cases.md").read_text(encoding="utf-8")
    compared = 0
    for name, smoother in re.findall(r"^\| `(\w+)` \|[^|]*\| ([^|]+) \|", text, flags=re.MULTILINE):
        stated = [float(number) for number in re.findall(r"[\d.]+", smoother)[:2]]
        found = load_scenario(name).expected["smoother"]
        for number, figure in zip(stated, (found.position_rms_m, found.anees), strict=True):
            if figure is not None:
                assert abs(number - figure.mean) <= max(0.05 * figure.mean, 0.0051), name
                compared += 1
    assert compared >= 15


def test_figures_that_can_be_reproduced() -> None:
    text = (ROOT / "docs/howto/paper_figures.md").read_text(encoding="utf-8")
    assert not [name for name in OTHERS if f"| `{name}`" not in text]


def test_the_map_has_every_room() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("## Map")[1].split("### ")[0]
    first_cells = " ".join(re.findall(r"^\|([^|]*)\|", table, flags=re.MULTILINE))
    rooms = set(re.findall(r"`([\w.]+)`", first_cells))
    assert rooms == {*PACKAGES, *MODULES, "factors", "factors.kernels", "scenarios"} - {
        "__init__",
        "__main__",
    }
