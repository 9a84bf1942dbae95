"""What the command line and the package import before anything is computed."""

import ast
import importlib
import os
import pkgutil
import subprocess
import sys
import types
from collections.abc import Sequence

import pytest

import craternav_fg

HEAVY = ("numba", "gtsam", "cv2", "scipy", "matplotlib", "pyarrow", "pandas", "pydantic", "numpy")


def imported_by(program: str, modules: Sequence[str] = HEAVY) -> list[str]:
    """Those of some modules that a Python program has imported at its end."""
    ending = f"\nimport sys\nprint([name for name in {modules!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program + ending], capture_output=True, text=True, check=True
    )
    return list(ast.literal_eval(done.stdout.splitlines()[-1]))


def cpu_s(program: str, enough: float) -> float:
    """CPU time of a Python program with its start, s: the least of three runs, or one that is enough."""
    least = float("inf")
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL, check=True)
        after = os.times()
        spent = after.children_user - before.children_user + after.children_system - before.children_system
        least = min(least, spent)
        if least < enough:
            break
    return least


def command_line(*arguments: str) -> str:
    return (
        f"import sys\nsys.argv = {['craternav', *arguments]!r}\n"
        "from craternav_fg.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass"
    )


def test_the_package_imports_nothing_before_a_name_is_used() -> None:
    program = "import craternav_fg as cn"
    assert imported_by(program) == []
    assert cpu_s(program, 0.3) < 0.3


@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ()])
def test_the_overview_imports_no_command(arguments: tuple[str, ...]) -> None:
    assert imported_by(command_line(*arguments)) == []
    assert cpu_s(command_line(*arguments), 0.5) < 0.5


@pytest.mark.parametrize(("chosen", "threads"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_another_number_is_chosen(
    monkeypatch: pytest.MonkeyPatch, chosen: str | None, threads: str
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if chosen is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", chosen)
    # numpy is imported after that: `test_the_overview_imports_no_command`.
    program = command_line("--version") + "\nimport os\nprint(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == threads


WRONG = [
    ("reconstruct", "no-folder"),
    ("reconstruct", "--no-such-option"),
    ("simulate", "no-scenario", "-o", "no-folder"),
    ("demo", "--scenario", "no-scenario", "-o", "no-folder"),
    ("catalog", "info", "no-catalogue"),
    ("compare", "no-folder"),
]


def test_wrong_arguments_are_refused_before_anything_that_draws_is_imported() -> None:
    # One after the other in one process: the first that imports it is named.
    programs = [
        command_line(*arguments) + f"\nprint({arguments!r}, 'matplotlib' in sys.modules)"
        for arguments in WRONG
    ]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(programs)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [f"{arguments!r} False" for arguments in WRONG]


def test_a_command_imports_its_own_module_only() -> None:
    loaded = "\nprint(sorted(m for m in sys.modules if m.startswith('craternav_fg.cli.')))"
    done = subprocess.run(
        [sys.executable, "-c", command_line("catalog", "info", "--help") + loaded],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    names = {name.rsplit(".", 1)[1] for name in ast.literal_eval(done.stdout.splitlines()[-1])}
    assert {"catalogs", "catalog_import"} <= names
    assert not names & {"descents", "campaigns", "reproduction", "benchmark"}


@pytest.mark.parametrize("name", craternav_fg.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert not isinstance(getattr(craternav_fg, name), types.ModuleType)
    assert name in dir(craternav_fg)


def test_no_module_hides_a_public_name() -> None:
    modules = {module.name for module in pkgutil.iter_modules(craternav_fg.__path__)}
    assert not modules & set(craternav_fg.__all__)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'reconstuct'"):
        _ = craternav_fg.reconstuct


def test_every_module_is_an_attribute_of_its_package() -> None:
    for package in pkgutil.walk_packages(craternav_fg.__path__, "craternav_fg."):
        if package.ispkg and package.name != "craternav_fg.cli":
            assert hasattr(importlib.import_module(package.name), "__getattr__"), package.name
