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
DOI = "10.1017/S0373463318000966"
ARRAY = re.compile(r"Array\b|ArrayLike|NDArray|ndarray")
# (n,), (..., 3), (5 n, 6), (k + 1, 2): a number of one word in parentheses is no shape.
SIZE = r"(?:\.\.\.|\d+ \w+|\w+(?: ?[+*-] ?\w+)?)"
SHAPE = re.compile(rf"\({SIZE}?,(?: ?{SIZE},?)*\)|\bshape \(\)|\b(?:same|any|their) shape\b|\bshape of\b")
# A unit, or a quantity that has none or whose units are defined elsewhere (chart, pose, covariance of ...).
UNIT = re.compile(
    r"(?<![\w`/'])(?:m|km|px|rad|deg|s|ns|ms|us|Hz|m/s|rad/s|m/s\^2|m\^2|m\^3/s\^2|e-|%|NEES|NIS)(?![\w`/'])"
    r"|\b(?i:pixels?|radii|radius|sigmas?|units?|unit-norm|normalised|whitened|dimensionless|bools?|booleans?"
    r"|ints?|integers?|uint\d+|index|indices|indexes|rows?|numbers?|counts?|masks?|identifiers?|grey|levels?"
    r"|brightness|probabilit\w+|likelihoods?|shares?|weights?|ratios?|fractions?|quality|qualities|scales?"
    r"|cosines?|poses?|mounting|rotations?|attitudes?|quaternions?|directions?|normals?|charts?|conics?"
    r"|covariances?|variances?|information|Jacobians?|derivatives?|slopes?|residuals?|correlations?"
    r"|whitening|whitens|written|error states?)\b"
)
UNIT_NAME = re.compile(
    r"_(?:m|km|px|rad|deg|s|ns|ms|us|hz|m_s|rad_s|deg_s|m2|share|ratio|rows|levels)$"
    r"|^(?:stamps?|rows?|index|indices|craters|visible|seen|inside|masks?)$"
)
FRAME = re.compile(
    r"\b(?i:in|of|to|from|into|axes) (?:g|b|c|l|i)\b|(?<!\w)[gbcli][TRPVLq][gbcl]?\b"
    r"|\b(?i:frames?|camera|body|images?|spheres?|east|any axes|twist|same|written)\b"
)
FRAME_NAME = re.compile(r"^[gbcli][TRPVAq][gbcl]?(?:_\w+)?$|_[gbcl]$")
# Described where another name is documented.
ELSEWHERE = re.compile(r"\b(?:as|from|see|by|of)\b[^.]*?`[\w.]+`", re.IGNORECASE)
SPATIAL = re.compile(r"\(3,\)|\((?:[\w.]+, )+3\)|\((?:[\w.]+, )*4, 4\)")
EQUATION = re.compile(r"\beqs?\.? ?\(\d")
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)

Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(tree: ast.Module) -> Iterator[tuple[str, Function, bool]]:
    """Public functions and methods with their names, and whether each is a property."""
    for node in tree.body:
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node.name, node, False
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, Function) and not method.name.startswith("_"):
                    marks = {ast.unparse(mark).split(".")[-1] for mark in method.decorator_list}
                    yield f"{node.name}.{method.name}", method, bool(marks & {"property", "cached_property"})


def public_classes(tree: ast.Module) -> Iterator[ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node


def sections(text: str) -> dict[str, str]:
    """Sections of a numpydoc docstring by name."""
    parts = SECTION.split(text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def entry(section: str, name: str) -> str | None:
    """What a section says of a name: the line that begins with it or a list with it, and what is indented."""
    other = r"\*{0,2}\w+"
    found = re.search(
        rf"^(?:{other}, )*\*{{0,2}}{name}\b(?:, {other})*(?: :.*)?\n?(?:\n?[ ]+.*|\n(?=[ ]))*",
        section,
        re.MULTILINE,
    )
    return found.group(0) if found else None


def array_faults(name: str, kind: str, said: str) -> Iterator[str]:
    """What the description of an array leaves out."""
    if not SHAPE.search(said):
        yield f"{kind} {name} has no shape"
        return
    # The name itself, or its quantity's name, must not count as a unit.
    text = re.sub(r"\bnd ?array\b|\barray_like\b|\bof (?:bool|int\w*|uint8)\b(?=, shape)", "", said)
    elsewhere = ELSEWHERE.search(text)
    integer = re.search(r"\bof (?:bool|u?int\w*)\b", said)
    if not (elsewhere or integer or UNIT_NAME.search(name) or FRAME_NAME.search(name) or UNIT.search(text)):
        yield f"{kind} {name} has no unit"
    if SPATIAL.search(said) and not (elsewhere or integer or FRAME_NAME.search(name) or FRAME.search(text)):
        yield f"{kind} {name} has no frame"


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


def parameter_faults(node: Function, section: str | None) -> Iterator[str]:
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    arrays = {a.arg for a in arguments if a.annotation and ARRAY.search(ast.unparse(a.annotation))}
    if not arrays:
        return
    if section is None:
        yield "no Parameters section"
        return
    for argument in arguments:
        said = entry(section, argument.arg)
        if argument.arg in ("self", "cls"):
            continue
        if said is None:
            yield f"parameter {argument.arg} is not described"
        elif argument.arg in arrays:
            yield from array_faults(argument.arg, "parameter", said)


def faults(name: str, node: Function, is_property: bool) -> Iterator[str]:
    text = ast.get_docstring(node) or ""
    found = sections(text)
    returns = ast.unparse(node.returns) if node.returns else ""
    gives = bool(ARRAY.search(returns)) and not returns.startswith(("Iterator", "Callable"))
    for fault in parameter_faults(node, found.get("Parameters")):
        yield f"{name}: {fault}"
    if gives and is_property:
        for fault in array_faults(node.name, "property", text):
            yield f"{name}: {fault}"
    elif gives and "Returns" not in found:
        yield f"{name}: no Returns section"
    elif gives and not SHAPE.search(found["Returns"]):
        yield f"{name}: Returns has no shape"
    for exception in sorted(raised(node)):
        if exception not in found.get("Raises", ""):
            yield f"{name}: raises {exception}, which Raises does not say"
    if EQUATION.search(text) and DOI not in found.get("References", ""):
        yield f"{name}: names an equation, and References does not name the paper (its DOI) and the equation"


def attribute_faults(node: ast.ClassDef) -> Iterator[str]:
    """Faults of a class's array attributes: described in its docstring, or by the literal below each."""
    found = sections(ast.get_docstring(node) or "")
    section = found.get("Attributes", "") + found.get("Parameters", "")
    for member, below in zip(node.body, [*node.body[1:], None], strict=True):
        if not isinstance(member, ast.AnnAssign) or not isinstance(member.target, ast.Name):
            continue
        name = member.target.id
        if name.startswith("_") or not ARRAY.search(ast.unparse(member.annotation)):
            continue
        said = entry(section, name)
        if said is None and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            said = str(below.value.value)
        if said is None:
            yield f"{node.name}: attribute {name} is not described"
        else:
            for fault in array_faults(name, "attribute", said):
                yield f"{node.name}: {fault}"


@pytest.mark.parametrize("module", MODULES)
def test_public_docstrings_are_complete(module: str) -> None:
    tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
    found = [fault for item in public(tree) for fault in faults(*item)]
    found += [fault for node in public_classes(tree) for fault in attribute_faults(node)]
    assert not found, "\n".join([f"{module}: {len(found)}", *found])


def found_in(source: str) -> list[str]:
    tree = ast.parse(source)
    out = [fault for item in public(tree) for fault in faults(*item)]
    return out + [fault for node in public_classes(tree) for fault in attribute_faults(node)]


def test_the_check_sees_what_is_missing() -> None:
    source = '''
def turn(gRb: FloatArray, angle_rad: float) -> FloatArray:
    """Turn as eq. (26) says."""
    raise ValueError(angle_rad)
'''
    assert [fault.split(": ", 1)[1].split(",")[0] for fault in found_in(source)] == [
        "no Parameters section",
        "no Returns section",
        "raises ValueError",
        "names an equation",
    ]


@pytest.mark.parametrize(
    ("said", "missing"),
    [
        ("points : ndarray, shape (n, 3)\n    In g, m.", None),
        ("points : ndarray, shape (n, 3)\n    As for `project`.", None),
        ("points : ndarray of int, shape (n, 3)\n    Corners of the triangles.", None),
        ("others, points : ndarray, shape (n, 3)\n    In the camera frame, normalised.", None),
        ("points : ndarray, shape (n, 3)\n    In g.", "no unit"),
        ("points : ndarray, shape (n, 3)\n    Places, m.", "no frame"),
        ("points : ndarray, shape (n, 2)\n    Places, m.", None),
        ("points : ndarray\n    In g (world), m.", "no shape"),
        ("others : ndarray, shape (n, 3)\n    Beside the points, in g, m.", "is not described"),
    ],
)
def test_the_check_of_an_array(said: str, missing: str | None) -> None:
    head, body = said.split("\n    ")
    entries = f"----------\n    {head}\n        {body}\n    "
    function = f'def f(points: FloatArray) -> None:\n    """Do.\n\n    Parameters\n    {entries}"""'
    attribute = f'class A:\n    """It.\n\n    Attributes\n    {entries}"""\n\n    points: FloatArray'
    for source in (function, attribute):
        found = found_in(source)
        assert len(found) == (missing is not None)
        assert not found or missing in found[0]
