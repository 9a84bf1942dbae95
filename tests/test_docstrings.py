"""Public docstrings say what an array is (shape, unit, frame), what is raised, and which equation is meant.

numpydoc's own validation knows sections, not arrays: it cannot tell that a parameter is an array without a
shape. What is read here is the source, so a module that cannot be imported is checked as well.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(
    path.relative_to(ROOT).as_posix()
    for package in ("craternav_fg", "factors")
    for path in (ROOT / package).rglob("*.py")
)
ARRAY = re.compile(r"Array\b|ArrayLike|NDArray|ndarray")
SHAPE = re.compile(r"\bshapes?\b|\((?:\.\.\.|\w+)(?:, ?(?:\.\.\.|[\w +*]+))*,?\)")
EQUATION = re.compile(r"\beqs?\.? ?\(\d")
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)

Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(tree: ast.Module) -> Iterator[tuple[str, Function, bool]]:
    """Public functions and methods with their names, and whether each is a property or fixed by Python."""
    for node in tree.body:
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node.name, node, False
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, Function) and not method.name.startswith("_"):
                    marks = {ast.unparse(mark).split(".")[-1] for mark in method.decorator_list}
                    yield f"{node.name}.{method.name}", method, bool(marks & {"property", "cached_property"})


def sections(text: str) -> dict[str, str]:
    """Sections of a numpydoc docstring by name."""
    parts = SECTION.split(text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def entry(section: str, name: str) -> str | None:
    """What a section says of a name: its line and the indented ones below it."""
    found = re.search(rf"^(?:[\w, *]*\W)?\*{{0,2}}{name}\b.*(?:\n(?:[ ]+.*|))*", section, re.MULTILINE)
    return found.group(0) if found else None


def raised(node: Function) -> set[str]:
    """Names of the exceptions that a function's own body raises: not those of functions inside it."""
    names: set[str] = set()
    todo: list[ast.AST] = list(node.body)
    while todo:
        here = todo.pop()
        if isinstance(here, Function | ast.Lambda | ast.ClassDef):
            continue
        if isinstance(here, ast.Raise) and here.exc is not None:
            made = here.exc.func if isinstance(here.exc, ast.Call) else here.exc
            name = ast.unparse(made).split(".")[-1]
            if name[:1].isupper():
                names.add(name)
        todo.extend(ast.iter_child_nodes(here))
    return names


def faults(name: str, node: Function, is_property: bool) -> Iterator[str]:
    text = ast.get_docstring(node) or ""
    found = sections(text)
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    arrays = [a.arg for a in arguments if a.annotation and ARRAY.search(ast.unparse(a.annotation))]
    returns = ast.unparse(node.returns) if node.returns else ""
    gives = bool(ARRAY.search(returns)) and not returns.startswith(("Iterator", "Callable"))
    if arrays and "Parameters" not in found:
        yield f"{name}: no Parameters section"
    elif arrays:
        for argument in arguments:
            said = None if argument.arg in ("self", "cls") else entry(found["Parameters"], argument.arg)
            if argument.arg not in ("self", "cls") and said is None:
                yield f"{name}: parameter {argument.arg} is not described"
            elif argument.arg in arrays and said is not None and not SHAPE.search(said):
                yield f"{name}: parameter {argument.arg} has no shape"
    if gives and is_property and not SHAPE.search(text):
        yield f"{name}: no shape of what it returns"
    if gives and not is_property:
        if "Returns" not in found:
            yield f"{name}: no Returns section"
        elif not SHAPE.search(found["Returns"]):
            yield f"{name}: Returns has no shape"
    for exception in sorted(raised(node)):
        if exception not in found.get("Raises", ""):
            yield f"{name}: raises {exception}, which Raises does not say"
    if EQUATION.search(text) and "10.1017/S0373463318000966" not in found.get("References", ""):
        yield f"{name}: names an equation, and References does not name the paper (its DOI) and the equation"


@pytest.mark.parametrize("module", MODULES)
def test_public_docstrings_are_complete(module: str) -> None:
    tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
    found = [fault for item in public(tree) for fault in faults(*item)]
    assert not found, "\n".join([f"{module}: {len(found)}", *found])


def test_the_check_sees_what_is_missing() -> None:
    source = '''
def turn(gRb: FloatArray, angle_rad: float) -> FloatArray:
    """Turn as eq. (26) says."""
    raise ValueError(angle_rad)
'''
    (item,) = public(ast.parse(source))
    assert [fault.split(": ", 1)[1].split(",")[0] for fault in faults(*item)] == [
        "no Parameters section",
        "no Returns section",
        "raises ValueError",
        "names an equation",
    ]
