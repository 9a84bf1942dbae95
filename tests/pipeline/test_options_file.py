"""Options from a TOML file: all of them, each to its place; what is wrong is one clear line."""

import itertools
import re
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from craternav_fg.errors import CraternavError, InputError
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.correlated_errors import RimErrorOptions
from craternav_fg.estimators.gnc import GncOptions
from craternav_fg.estimators.registry import ESTIMATORS, estimator
from craternav_fg.pipeline.options_file import FORMER, OptionsFile, default_options
from craternav_fg.vision.arcs import ArcOptions
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.point_tracks import PointTrackOptions
from craternav_fg.vision.sun import SunOptions
from factors.custom import Loss
from factors.kernels import robust


def read(tmp_path: Path, text: str) -> OptionsFile:
    path = tmp_path / "options.toml"
    path.write_text(text, encoding="utf-8")
    return OptionsFile(path)


def leaves(options: Any, where: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every field below a dataclass."""
    for field in fields(options):
        value = getattr(options, field.name)
        if is_dataclass(value):
            yield from leaves(value, (*where, field.name))
        else:
            yield (*where, field.name), value


def test_the_printed_defaults_are_the_defaults(tmp_path: Path) -> None:
    file = read(tmp_path, default_options())
    assert file.front_end == GuidedOptions()
    for name in ESTIMATORS:
        ours, default = file.estimator(name), estimator(name)
        assert ours.name == default.name
        if hasattr(default, "options"):
            assert asdict(ours.options) == asdict(default.options)


def test_every_option_is_printed_below_a_comment() -> None:
    text = default_options()
    tables = tomllib.loads(text)
    for where, options in (
        (("front_end",), GuidedOptions()),
        *((("estimators", name), estimator(name).options) for name in ("smoother", "ekf", "gnc_smoother")),
    ):
        for path, _ in leaves(options):
            table: Any = tables
            for key in (*where, *path):
                assert key in table, (where, path)
                table = table[key]
    lines = text.splitlines()
    bare = [
        line for before, line in itertools.pairwise(lines)
        if "=" in line and not line.startswith("#") and not before.startswith("#")
    ]  # fmt: skip
    assert bare == []


def test_comments_have_the_words_of_the_file() -> None:
    """A docstring's None is "none" in a file."""
    comments = [line for line in default_options().splitlines() if line.startswith("#")]
    assert not [line for line in comments if re.search(r"\bNone\b", line)]
    assert [line for line in comments if '"none": never' in line]


@pytest.mark.parametrize(("path", "value"), list(leaves(GuidedOptions())), ids=lambda v: str(v)[:40])
def test_each_number_of_the_front_end_arrives(tmp_path: Path, path: tuple[str, ...], value: Any) -> None:
    new = [2.0 * one for one in value] if isinstance(value, tuple) else value + 1
    *tables, key = path
    file = read(tmp_path, f"[{'.'.join(('front_end', *tables))}]\n{key} = {new}\n")
    found = dict(leaves(file.front_end))
    assert found[path] == (tuple(new) if isinstance(value, tuple) else new)
    assert {k: v for k, v in found.items() if k != path} == {
        k: v for k, v in leaves(GuidedOptions()) if k != path
    }


def test_the_options_of_estimators_arrive(tmp_path: Path) -> None:
    file = read(
        tmp_path,
        """
[estimators.smoother]
rims = "los"
rim_errors = "none"
loss.kind = "cauchy"
crater_freedom = "none"
calibration.time_offset_sigma_s = 0.02
[estimators.gnc_smoother]
growth_factor = 2
[estimators.gnc_smoother.graph]
keyframe_s = 0.5
[estimators.ekf]
gate_sigmas = "none"
measurement = "points"
[estimators.fixed_lag]
lag_s = 12
""",
    )
    smoother = file.estimator("smoother").options
    assert (smoother.rims, smoother.rim_errors, smoother.loss.kind) == ("los", None, robust.CAUCHY)
    assert smoother.crater_freedom is None
    assert smoother.calibration.time_offset_sigma_s == 0.02
    gnc = file.estimator("gnc_smoother").options
    assert (gnc.growth_factor, gnc.graph.keyframe_s) == (2.0, 0.5)
    assert file.estimator("ekf").options.gate_sigmas is None
    assert file.estimator("ekf").options.measurement == "points"
    assert file.estimator("fixed_lag").lag_s == 12.0
    assert file.estimator("online").options == estimator("online").options


@pytest.mark.parametrize(
    ("text", "line", "column", "problem"),
    [
        ("[frontend]", 1, "frontend", "unknown table, expected front_end or estimators"),
        ("[front_end]\nmargin = 3.0", 2, "front_end.margin", "did you mean margin_px"),
        ("[front_end]\nmargin_px = '3'", 2, "front_end.margin_px", "expected a valid number, found '3'"),
        ("[front_end]\nmargin_px = true", 2, "front_end.margin_px", "expected a valid number, found True"),
        ("[front_end]\nmargin_px = -3", 2, "front_end.margin_px", "expected a number of 0 or more, found -3"),
        ("[front_end]\nmargin_px = nan", 2, "front_end.margin_px", "found nan"),
        ("[front_end]\nfirst_reach = [1.0]", 2, "front_end.first_reach", "a list of 2 numbers, found [1.0]"),
        ("[front_end]\nfirst_reach = [1.0, 'a']", 2, "front_end.first_reach", "number, found 'a'"),
        (
            "[front_end]\nfirst_reach = [1.0, 0.1]\nfirst_reach_px = 1.0", 2, "front_end.first_reach",
            "the former name of first_reach_px and first_reach_share, and first_reach_px is given, too",
        ),
        (
            "[estimators.smoother.loss]\nscale_sigmas = 3.0\nscale = 2.0",
            3, "estimators.smoother.loss.scale",
            "is the former name of scale_sigmas, and scale_sigmas is given, too",
        ),
        ("[front_end]\nfit = 3", 2, "front_end.fit", "expected a table, found 3"),
        ("[front_end.fit]\nmin_points = 3.5", 2, "front_end.fit.min_points", "found 3.5"),
        ("[estimators.smother]", 1, "estimators.smother", "did you mean smoother"),
        ("[estimators.smoother]\nrims = 'chrt'", 2, "estimators.smoother.rims", "found 'chrt'"),
        ("[estimators.smoother]\nkeyframe_s = 0", 2, "estimators.smoother.keyframe_s", "positive"),
        ("[estimators.smoother.loss]\nkind = 1", 2, "estimators.smoother.loss.kind", "none, huber"),
        ("[estimators.smoother.loss]\nscale = 0", 2, "estimators.smoother.loss.scale", "positive"),
        ("[estimators.ekf]\niterations = 0", 2, "estimators.ekf.iterations", "expected 1 or more, found 0"),
        ("[estimators.online]\ncrater_freedom = 3.0", 2, "estimators.online.crater_freedom", "unknown key"),
        ("[estimators.fixed_lag.calibration]", 1, "estimators.fixed_lag.calibration", "unknown key"),
        (
            "[estimators.gnc_smoother.graph]\ncalibration = 1", 2,
            "estimators.gnc_smoother.graph.calibration", "unknown key",
        ),
        (
            "[estimators.smoother_los]\ncrater_freedom = 3", 2, "estimators.smoother_los.crater_freedom",
            "needs rims='chart'",
        ),
        ("[estimators.online_los.rim_errors]\ndecay = 1", 1, "estimators.online_los.rim_errors", "'chart'"),
        ("[estimators.dead_reckoning]\nlag_s = 3", 2, "estimators.dead_reckoning.lag_s", "has no options"),
        ("[estimators.fixed_lag]\nlag_s = 'long'", 2, "estimators.fixed_lag.lag_s", "found 'long'"),
        ("[estimators]\nsmoother = 1", 2, "estimators.smoother", "expected a table"),
        ("front_end = 1", 1, "front_end", "expected a table"),
        ("estimators = 1", 1, "estimators", "expected a table"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, text: str, line: int, column: str, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{tmp_path / 'options.toml'}:{line}: {column}: ")
    assert problem in message


_PARENTS = {
    GuidedOptions: "front_end",
    EdgeOptions: "front_end.edges",
    ArcOptions: "front_end.arcs",
    SunOptions: "front_end.sun",
    PointTrackOptions: "front_end.points",
    Loss: "estimators.smoother.loss",
    RimErrorOptions: "estimators.smoother.rim_errors",
    Calibration: "estimators.smoother.calibration",
    GncOptions: "estimators.gnc_smoother",
}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, names in FORMER.items() for name in names], ids=str
)
def test_former_names_are_read(tmp_path: Path, kind: type, name: str) -> None:
    """A key by its former name does what it does by its present one, and the former name is free."""
    keys = FORMER[kind][name]
    assert name not in {field.name for field in fields(kind)}
    values = [1.7 + k for k in range(len(keys))]
    head = f"[{_PARENTS[kind]}]\n"
    one = read(tmp_path, f"{head}{name} = {values[0] if len(keys) == 1 else values}\n")
    other = read(tmp_path, head + "".join(f"{k} = {v}\n" for k, v in zip(keys, values, strict=True)))
    assert one.front_end == other.front_end
    assert (one.front_end != GuidedOptions()) == _PARENTS[kind].startswith("front_end")
    for estimator_name in ("smoother", "gnc_smoother"):
        options = [file.estimator(estimator_name).options for file in (one, other)]
        assert options[0] == options[1]
        named = _PARENTS[kind].split(".")[1:2] == [estimator_name]
        assert (options[0] != estimator(estimator_name).options) == named


def test_an_unknown_estimator_of_printed_defaults_is_an_error() -> None:
    with pytest.raises(CraternavError, match="did you mean smoother"):
        default_options(["smother"])
