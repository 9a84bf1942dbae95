"""What the documents tell a reader to type works: console blocks and Python blocks, page by page.

A page's blocks run in order in a folder that holds the demo, with fewer and smaller images. Every command is
parsed in the quick tests; the slow ones run them.
"""

import itertools
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from craternav_fg.catalogs.files import write_catalog
from craternav_fg.cli.app import every_command
from tests.catalogs.population import power_law_population
from tests.catalogs.test_dem import write
from tests.catalogs.test_import import MOON
from tests.cli.calls import call

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
# Set up and run elsewhere: `make demo` is the fixture, its environment that of the tests.
ELSEWHERE = ("make", "source")
# Programs whose options are not checked.
OTHER_PROGRAMS = ("python ", ".venv/bin/", "pip ", "make ")
# The demo's descent at an eighth of the cost: half as many images, of a quarter of the pixels.
SMALL = """
base = "lunar_descent"
[camera]
width_px = 512
height_px = 512
[trajectory]
frame_interval_s = 8.0
[craters]
min_apparent_px = 24.0
max_apparent_px = 150.0
"""


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Language and text of each block of a page."""
    for found in BLOCK.finditer((ROOT / page).read_text(encoding="utf-8")):
        # A line that ends in a backslash goes on.
        yield found.group(2), re.sub(r"\\\n\s*", " ", found.group(3))


def commands(text: str) -> Iterator[tuple[list[str], list[str]]]:
    """Words of each command of a console block, and the lines that it is said to print."""
    words: list[str] = []
    printed: list[str] = []
    for line in text.splitlines():
        if line.lstrip().startswith("$ "):
            if words:
                yield words, printed
            words, printed = shlex.split(line.lstrip()[2:], comments=True), []
        elif line.strip():
            printed.append(line.strip())
    if words:
        yield words, printed


def all_commands() -> list[tuple[str, list[str]]]:
    found = []
    for page in PAGES:
        for language, text in blocks(page):
            if language == "console":
                found += [(page, words) for words, _ in commands(text)]
            elif language == "sh":
                lines = [shlex.split(line, comments=True) for line in text.splitlines()]
                found += [(page, words) for words in lines if words and words[0] == "craternav"]
    return found


@pytest.mark.parametrize(
    ("page", "words"), [pytest.param(*one, id=f"{one[0]}: {shlex.join(one[1])}") for one in all_commands()]
)
def test_commands_parse(page: str, words: list[str]) -> None:
    if words[0] != "craternav":
        assert words[0] in (*ELSEWHERE, "evo_ape"), page
        return
    command = every_command()
    context = typer.Context(command)
    rest = words[1:]
    while hasattr(command, "get_command"):
        name, command = rest[0], command.get_command(context, rest[0])
        assert command is not None, f"no command {name}"
        rest = rest[1:]
    if "--help" not in rest:
        command.make_context(words[1], rest)


def options(command: Any) -> Iterator[str]:
    for parameter in command.params:
        yield from parameter.opts
    for inner in getattr(command, "commands", {}).values():
        yield from options(inner)


@pytest.mark.parametrize("page", PAGES)
def test_options_that_the_text_names_exist(page: str) -> None:
    known = {*options(every_command()), "--help"}
    prose = BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    codes = [code for code in re.findall(r"`([^`]+)`", prose) if not code.startswith(OTHER_PROGRAMS)]
    quoted = [word for code in codes for word in re.split(r"[ ,|]+", code)]
    assert not [word for word in quoted if re.fullmatch(r"--[a-z][a-z0-9-]+", word) and word not in known]


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    (folder / "small.toml").write_text(SMALL)
    done = call("demo", "--scenario", folder / "small.toml", "-o", folder / "demo")
    assert done.code == 0, done.err
    return folder / "demo"


def tables(folder: Path) -> None:
    """Write the tables of craters that the pages import, in Robbins' columns and in others."""
    catalog = power_law_population(np.random.default_rng(5), MOON, 3000, (2e3, 60e3))
    write_catalog(folder / "lunar_crater_database_robbins_2018.csv", catalog)
    lines = ["PHI,LAMBDA,SIZE"]
    for latitude_deg, longitude_deg in itertools.product(range(-60, 61, 20), range(5, 360, 30)):
        lines.append(f"{latitude_deg},{longitude_deg},{3000 + 10 * longitude_deg}")
    (folder / "mine.csv").write_text("\n".join(lines) + "\n")
    write(folder / "moon.tif", np.zeros((360, 720), dtype=np.float32))


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder as the pages expect it, but for the demo."""
    monkeypatch.chdir(tmp_path)
    tables(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def run(words: list[str], printed: list[str]) -> None:
    words = ["small.toml" if word == "lunar_descent" else word for word in words]
    if words[0] in ELSEWHERE or words[:2] == ["craternav", "demo"]:
        return
    if words[0] == "craternav":
        done = call(*words[1:])
        code, said = done.code, done.out + done.err
    else:
        program = Path(sys.executable).with_name(words[0])
        process = subprocess.run([program, *words[1:]], capture_output=True, text=True, check=False)
        code, said = process.returncode, process.stdout + process.stderr
    refused = any(line.startswith("craternav: ") for line in printed)
    assert code == (2 if refused else 0), f"{shlex.join(words)}: {said}"
    flat = " ".join(said.split())
    assert not [line for line in printed if " ".join(line.split()) not in flat], said


def has_work(page: str) -> bool:
    return any(language in ("console", "python") for language, _ in blocks(page))


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if has_work(page)])
def test_blocks_run(page: str, workspace: Path, request: pytest.FixtureRequest) -> None:
    written = (ROOT / page).read_text(encoding="utf-8")
    if "runs/demo" in written:
        shutil.copytree(request.getfixturevalue("demo"), workspace / "runs/demo")
    if "runs/data" in written and "-o runs/data" not in written:
        assert call("simulate", "measured_descent", "-o", "runs/data").code == 0
    names: dict[str, object] = {}
    for language, text in blocks(page):
        file = re.match(r"# ([\w.]+\.toml)\n", text)
        if file:
            Path(file.group(1)).write_text(text)
        if language == "console":
            for words, printed in commands(text):
                run(words, printed)
        if language == "python":
            exec(compile(text, page, "exec"), names)
