"""The page on troubleshooting has an entry for each warning, and quotes only messages that the code has."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/howto/troubleshooting.md").read_text(encoding="utf-8")
# Modules whose messages all need an entry.
OF_WARNINGS = (
    "catalogs/common_shift.py",
    "evaluation/truth_check.py",
    "pipeline/input_warnings.py",
    "pipeline/warnings.py",
    "resection/caveats.py",
    "resection/efficient.py",
    "resection/intrinsics.py",
    "resection/robust.py",
)
# Shorter texts are parts of messages.
SHORTEST = 40
# Shorter phrases would be found in messages that they do not mean.
SHORTEST_PHRASE = 10


def texts(module: Path) -> Iterator[str]:
    """Texts in a module's functions, without docstrings; what is inserted is `{}`."""
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            for statement in body:
                yield from _texts(statement)


def _texts(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.JoinedStr):
        parts = [part.value if isinstance(part, ast.Constant) else "{}" for part in node.values]
        yield "".join(map(str, parts))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    else:
        for child in ast.iter_child_nodes(node):
            yield from _texts(child)


def phrases() -> list[str]:
    """What the page quotes."""
    return re.findall(r'"([^"]+)"', re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL))


@functools.cache
def all_texts() -> str:
    """Texts of all modules."""
    return "\n".join(text for module in (ROOT / "craternav_fg").rglob("*.py") for text in texts(module))


@pytest.mark.parametrize("module", OF_WARNINGS)
def test_each_warning_has_an_entry(module: str) -> None:
    messages = [text for text in texts(ROOT / "craternav_fg" / module) if len(text) >= SHORTEST]
    assert messages
    assert not [text for text in messages if not any(phrase in text for phrase in phrases())]


def test_what_the_page_quotes_is_said() -> None:
    assert not [phrase for phrase in phrases() if phrase not in all_texts()]
    assert not [phrase for phrase in phrases() if len(phrase) < SHORTEST_PHRASE]
