"""The generated pages of the documentation: every public name, command, option and key."""

import importlib.util
import re
import types
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import pytest
import typer
import yaml

import craternav_fg
from craternav_fg.campaign.trial import SCHEMA
from craternav_fg.cli.app import every_command
from craternav_fg.dataset import layout
from craternav_fg.evaluation.metrics import Metrics
from craternav_fg.runs import schemas
from craternav_fg.sensors import registry
from craternav_fg.sensors.protocol import SensorSettings
from craternav_fg.sensors.ranging import Ranging

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("mkdocs", reason="needs the extra docs")
griffe = pytest.importorskip("griffe")
GitIgnoreSpec = pytest.importorskip("pathspec.gitignore").GitIgnoreSpec


@pytest.fixture(scope="module")
def generate() -> types.ModuleType:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs/_generate.py")
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    assert spec.loader is not None
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages(generate: types.ModuleType) -> dict[str, str]:
    return generate.pages()


def test_names_in_tables_may_break(generate: types.ModuleType) -> None:
    text = "<p><code>a_b</code></p><td>x_y <code>ab_c/d.csv</code> <code>_e</code></td>"
    expected = "<p><code>a_b</code></p><td>x_y <code>ab_<wbr>c/<wbr>d.<wbr>csv</code> <code>_e</code></td>"
    assert generate.on_page_content(text) == expected
    option = "<td><code>--a-b</code></td>"
    assert generate.on_page_content(option) == '<td><code class="option">--a-b</code></td>'


def test_every_public_name_is_in_the_reference(pages: dict[str, str]) -> None:
    named = re.findall(r"^::: craternav_fg\.(\w+)$", pages["reference/api.md"], flags=re.MULTILINE)
    assert sorted(named) == sorted(set(craternav_fg.__all__) - {"__version__"})


def test_every_command_is_in_the_reference(pages: dict[str, str]) -> None:
    group = every_command()
    for name in group.list_commands(typer.Context(group)):
        assert f"## `craternav {name}`" in pages["reference/cli.md"]
    assert "--overlay-every" in pages["reference/cli.md"]
    assert "$ craternav demo -o runs/demo" in pages["reference/cli.md"]


def test_keys_have_their_kind_limits_default_and_description(pages: dict[str, str]) -> None:
    scenario = pages["reference/scenario.md"]
    assert "| `seed` | integer ≥ 0 | required |" in scenario
    assert "| `irregularity_share` | number ≥ 0, ≤ 0.1 | `0.0` | RMS deviation of the rims" in scenario
    assert '## `[craters]`, source = "random"' in scenario
    assert "## `[trajectory.start]`" in scenario


def test_every_sensor_is_in_the_reference(pages: dict[str, str]) -> None:
    for kind in registry.SHIPPED:
        assert f"## `mav0/{kind.name}0`" in pages["reference/sensors.md"]
    assert "`range [m]`" in pages["reference/sensors.md"]


def test_sensors_of_other_packages_are_not(
    generate: types.ModuleType, pages: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They belong to this machine, and need not even have defaults."""

    class BeaconSettings(SensorSettings):
        sensor_type: Literal["beacon"]
        position_m: float

    class Beacon(Ranging):
        name = "beacon"
        Settings = BeaconSettings

    monkeypatch.setattr(registry, "plugins", lambda group: [SimpleNamespace(value=Beacon)])
    assert "beacon" in registry.sensors()
    assert generate.pages()["reference/sensors.md"] == pages["reference/sensors.md"]


def test_every_column_of_a_data_set_is_described() -> None:
    text = (ROOT / "docs/reference/dataset.md").read_text(encoding="utf-8")
    columns = [
        *layout.CAMERA_COLUMNS, *layout.IMU_COLUMNS, *layout.TRUTH_COLUMNS, *layout.SUN_COLUMNS,
        *layout.TILT_COLUMNS,
    ]  # fmt: skip
    assert not [column.name for column in columns if f"`{column.name}`" not in text]
    files = [layout.DESCRIPTION, layout.CRATERS, layout.LARGE_CRATERS, layout.SUN, layout.RIMS, layout.ARCS]
    assert not [name for name in files if f"`{name}`" not in text]


def test_every_column_of_the_results_is_described() -> None:
    text = (ROOT / "docs/reference/outputs.md").read_text(encoding="utf-8")
    tables = (schemas.STATES, schemas.COVARIANCES, schemas.RESIDUALS, schemas.RESIDUALS_OF_IMAGES, SCHEMA)
    names = {name for table in tables for name in table.names} | {field.name for field in fields(Metrics)}
    assert not [name for name in sorted(names) if f"`{name}`" not in text]


def test_types_in_docstrings_stay_as_they_are() -> None:
    """Without the extension, griffe reads choices as a sum of names, and a shape as a call."""
    options = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["plugins"][2]
    (extension,) = options["mkdocstrings"]["handlers"]["python"]["options"]["extensions"]
    code = '''
def measure(rims, P):
    """Measure.

    Parameters
    ----------
    rims : {"chart", "los+shape"}
    P : ndarray, shape (n, 3)
        Places.
    """
'''
    extensions = griffe.load_extensions(str(ROOT / extension))
    module = griffe.visit("measuring", Path("measuring.py"), code, extensions=extensions)
    parameters = module["measure"].docstring.parse("numpy")[1].value
    assert [str(parameter.annotation) for parameter in parameters] == [
        'one of "chart", "los+shape"', "ndarray of shape (n, 3)",
    ]  # fmt: skip


def test_no_module_becomes_a_page() -> None:
    """The notebooks' converter takes Python files for notebooks."""
    ignored = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["exclude_docs"].split()
    spec = GitIgnoreSpec.from_lines(ignored)
    modules = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").glob("**/*.py")]
    modules += [f"notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.py")]
    assert not [path for path in modules if not spec.match_file(path)]


def test_every_page_is_in_the_navigation(pages: dict[str, str]) -> None:
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    found = set(leaves(nav))
    written = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    notebooks = {f"notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert found == written | notebooks | set(pages)


def leaves(nav: object) -> list[str]:
    if isinstance(nav, dict):
        return [leaf for part in nav.values() for leaf in leaves(part)]
    if isinstance(nav, list):
        return [leaf for part in nav for leaf in leaves(part)]
    return [str(nav)]
