"""Pages of the documentation that are made from the code, and equations as MathML.

A hook of mkdocs. The reference of the command line comes from the commands, the API from
`craternav_fg.__all__`, and options, sensors and scenarios from their classes.
"""

import ast
import html
import inspect
import itertools
import re
import textwrap
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from typer.cli import get_docs_for_click

import craternav_fg
from craternav_fg.cli.app import every_command
from craternav_fg.pipeline.options_file import default_options
from craternav_fg.sensors.point_features import FeatureSettings
from craternav_fg.sensors.registry import SHIPPED
from craternav_fg.simulation.scenario_file import Scenario

# Public names in the order of the page; `tests/test_site.py` compares them with `craternav_fg.__all__`.
API_GROUPS = {
    "Data": ("Dataset", "Body", "Camera", "Catalog", "FrameMeasurement", "RimSet", "Trajectory"),
    "Reconstruction": ("reconstruct", "Reconstruction", "FrontEndOptions", "compare", "read_run"),
    "Estimators": (
        "ESTIMATORS", "Estimator", "BatchSmoother", "OnlineSmoother", "FixedLagSmoother",
        "GraphOptions", "BatchOptions", "DistributedEkf", "EkfOptions",
    ),
    "One image": ("detect", "identify", "TripleIndex", "KnownAttitude", "solve_pose"),
    "Simulation and campaigns": (
        "load_scenario", "Scenario", "simulate", "montecarlo", "CampaignOptions", "read_campaign",
    ),
    "Results": ("metrics", "plot", "report"),
    "Sensors": ("Sensor",),
    "Errors": ("CraternavError", "InputError", "EstimationError"),
}  # fmt: skip

API_HEAD = """# Python API

```python
import craternav_fg as cn
```

These names are the public interface. A module is imported when one of its names is first used, so the
import itself is fast. `cn.__version__` is the version, here {version}.

Other modules can be imported as well, as some pages show, but may change between versions.

"""
OPTIONS_HEAD = """# Options file

An options file is a TOML file for the front end and the estimators. Missing keys keep their defaults. The
file below lists every key with its default. Each comment is the first sentence of the documentation of the
class.

"""
SENSORS_HEAD = """# Sensor files

A sensor other than the camera and the IMU has a folder `mav0/NAME0` with two files. `sensor.yaml` holds its
settings. `data.csv` holds its samples: `#timestamp [ns]` and the columns below, one row per sample, with
stamps that increase strictly and lie within the descent.

"""
FEATURES_HEAD = """## `mav0/features0`

Point features tracked from image to image, without a map.

"""
FEATURES_COLUMNS = """Columns of `data.csv`: `timestamp [ns]` (of a frame), `track_id` (an integer, the same
in all images of a point), `x [px]`, `y [px]` (distorted pixels of the image).
"""
SCENARIO_HEAD = """# Scenario file

A scenario is a TOML file that `craternav simulate`, `demo` and `montecarlo` read. Copy a built-in one from
the folder `scenarios`, or write `base = "NAME"` and only the differences. Units are in the names of the keys.
Keys without one are shares, ratios or counts, unless the description has the unit.

"""


@event_priority(100)
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_content(content: str, **_: object) -> str:
    """Turn equations into MathML, so that no script is needed, and let names in tables break.

    Equations are marked by pymdownx.arithmatex.
    """
    content = re.sub(r"<td[^>]*>.*?</td>", _breaking, content, flags=re.DOTALL)
    content = re.sub(r'<span class="arithmatex">\\\((.*?)\\\)</span>', _inline, content, flags=re.DOTALL)
    return re.sub(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', _block, content, flags=re.DOTALL)


def _breaking(cell: re.Match[str]) -> str:
    """Allow breaks behind the marks in the code of a cell, for narrow screens, but none within an option."""
    text = re.sub(r"<code>(--[\w-]+)</code>", r'<code class="option">\1</code>', cell.group())
    return re.sub(
        r"<code>[^<]*</code>",
        lambda code: re.sub(r"(?<=\w[_/.])(?=\w)", "<wbr>", code.group()),
        text,
    )


def _inline(found: re.Match[str]) -> str:
    return convert(html.unescape(found.group(1)))


def _block(found: re.Match[str]) -> str:
    return f'<div class="equation">{convert(html.unescape(found.group(1)), display="block")}</div>'


def pages() -> dict[str, str]:
    """Return the text of each generated page by its path."""
    return {
        "reference/cli.md": "".join(_commands()),
        "reference/api.md": "".join(_api()),
        "reference/options.md": "".join(_options()),
        "reference/sensors.md": "".join(_sensors()),
        "reference/scenario.md": "".join(_scenario()),
    }


def _commands() -> Iterator[str]:
    group = every_command()
    text = get_docs_for_click(obj=group, ctx=typer.Context(group), name="craternav", title="Command line")
    # typer cuts the sentences in its lists of commands short.
    for command in _subcommands(group):
        line = f"* `{command.name}`: "
        text = text.replace(f"{line}{command.get_short_help_str()}\n", f"{line}{command.help}\n")
    # An example is a console block: copied with a click, and easy to see.
    yield re.sub(r"^Example: (craternav .*)$", r"```console\n$ \1\n```", text, flags=re.MULTILINE)


def _subcommands(group: Any) -> Iterator[Any]:
    for command in getattr(group, "commands", {}).values():
        yield command
        yield from _subcommands(command)


def _api() -> Iterator[str]:
    yield API_HEAD.format(version=craternav_fg.__version__)
    for title, names in API_GROUPS.items():
        yield f"## {title}\n\n"
        for name in names:
            yield f"::: craternav_fg.{name}\n\n"


def _options() -> Iterator[str]:
    yield OPTIONS_HEAD
    yield f"```toml\n{default_options()}```\n"


def _sensors() -> Iterator[str]:
    yield SENSORS_HEAD
    # Not those of other packages that this environment happens to hold.
    for name, kind in sorted((kind.name, kind) for kind in SHIPPED):
        yield f"## `mav0/{name}0`\n\n{_first_sentence(kind)}\n\n"
        yield _table(kind.Settings)
        columns = kind.columns(kind.Settings(sensor_type=name))
        head = ", ".join(f"`{column.name}{f' [{column.unit}]' if column.unit else ''}`" for column in columns)
        yield f"Columns of `data.csv`: {head}.\n\n"
    yield FEATURES_HEAD
    yield _table(FeatureSettings)
    yield FEATURES_COLUMNS


def _scenario() -> Iterator[str]:
    yield SCENARIO_HEAD
    seen: set[type] = set()
    yield from _section("Top level", Scenario, seen)


def _section(title: str, kind: type[BaseModel], seen: set[type]) -> Iterator[str]:
    """Return the keys of a table, and then those of the tables inside it."""
    seen.add(kind)
    said = "" if kind is Scenario else f"{_first_sentence(kind)}\n\n"
    yield f"## {title}\n\n{said}{_table(kind)}"
    for name, field in kind.model_fields.items():
        inner = [one for one in _models(field.annotation) if one not in seen]
        for one in inner:
            # A title is `[path]`, with or without its source.
            path = name if kind is Scenario else f"{title.split(']')[0].strip('`[')}.{name}"
            # Tables of one name differ by the value of a key.
            key = next((key for key in ("source", "model") if key in one.model_fields), None)
            values = get_args(one.model_fields[key].annotation) if key else ()
            suffix = f', {key} = "{values[0]}"' if values else ""
            yield from _section(f"`[{path}]`{suffix}", one, seen)


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for part in get_args(kind):
        yield from _models(part)


def _table(kind: type[BaseModel]) -> str:
    """Keys of a model: what is expected, the default and the description of each."""
    said = _attribute_docs(kind)
    rows = ["| key | value | default | |", "|---|---|---|---|"]
    for name, field in kind.model_fields.items():
        value = _kind(field.annotation) + _limits(field.metadata)
        if field.default is PydanticUndefined and field.default_factory is None:
            default = "required"
        elif field.default is None or isinstance(field.default, BaseModel) or field.default_factory:
            default = ""
        else:
            default = f"`{_written(field.default)}`"
        rows.append(f"| `{name}` | {value} | {default} | {said.get(name, '')} |")
    return "\n".join(rows) + "\n\n"


def _kind(kind: Any) -> str:
    """Name the values that a key takes, as a user writes them in TOML or YAML."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _kind(parts[0])
    if origin is Literal:
        return " or ".join(f"`{part}`" for part in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_kind(part) for part in parts if part is not type(None)))
    if origin is tuple:
        count = "" if Ellipsis in parts else f"{len(parts)} × "
        return f"list of {count}{_kind(parts[0])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "table"
    named = {float: "number", int: "integer", str: "text", bool: "true or false"}
    return named.get(kind, "table")


def _limits(metadata: list[Any]) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found = [
        f"{sign} {getattr(one, name):g}"
        for one in metadata
        for name, sign in signs.items()
        if getattr(one, name, None) is not None
    ]
    return f" {', '.join(found)}" if found else ""


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]"
    return {True: "true", False: "false"}.get(value, str(value)) if isinstance(value, bool) else f"{value}"


def _attribute_docs(kind: type[BaseModel]) -> dict[str, str]:
    """Literals below the fields of a class and of those it derives from."""
    out: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        if not issubclass(one, BaseModel) or one.__module__.startswith("pydantic"):
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(one))).body[0].body
        for member, below in itertools.pairwise(body):
            if (
                isinstance(member, ast.AnnAssign)
                and isinstance(below, ast.Expr)
                and isinstance(below.value, ast.Constant)
            ):
                out[member.target.id] = " ".join(str(below.value.value).split())
    return out


def _first_sentence(kind: type) -> str:
    return (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
