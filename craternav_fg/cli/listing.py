"""Commands that list estimators, sensors and scenarios."""

import json
from collections.abc import Mapping

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import JsonOption
from craternav_fg.cli.terminal import out, say
from craternav_fg.estimators.instruments import CAMERA_AND_IMU
from craternav_fg.estimators.registry import DESCRIPTIONS, ON_REQUEST
from craternav_fg.estimators.registry import estimators as all_estimators
from craternav_fg.sensors.point_features import NAME as FEATURES
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.sensors.registry import sensors as all_sensors
from craternav_fg.simulation.scenario_file import built_in_scenarios


@app.command(epilog=example("estimators --json"))
def estimators(as_json: JsonOption = False) -> None:
    """List the estimators, including those of other packages."""
    found = {}
    for name, make in all_estimators().items():
        if name in DESCRIPTIONS:
            found[name] = DESCRIPTIONS[name] + (" (on request)" if name in ON_REQUEST else "")
        else:
            one = type(make())
            found[name] = f"{_sentence(one)} (on request; {_package(one)})"
    _show(found, as_json)


@app.command(epilog=example("sensors --json"))
def sensors(as_json: JsonOption = False) -> None:
    """List the sensors, including those of other packages."""
    found = {
        name: f"{_sentence(kind)} (mav0/{name}0; {_package(kind)})" for name, kind in all_sensors().items()
    }
    found.update({one.name: _sentence(type(one)) for one in CAMERA_AND_IMU})
    found[FEATURES] = f"{_sentence(FeatureTracks)} (mav0/{FEATURES}0; craternav_fg)"
    _show(found, as_json)


@app.command(epilog=example("scenarios --json"))
def scenarios(as_json: JsonOption = False) -> None:
    """List the built-in scenarios."""
    found = {}
    for name, path in sorted(built_in_scenarios().items()):
        comment = []
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith("#"):
                break
            comment.append(line.removeprefix("#").strip())
        found[name] = " ".join(comment)
    _show(found, as_json)


def _sentence(kind: type) -> str:
    """First sentence of a class's docstring."""
    return (kind.__doc__ or "").strip().split("\n")[0].removesuffix(".")


def _package(kind: type) -> str:
    return kind.__module__.split(".")[0]


def _show(found: Mapping[str, str], as_json: bool) -> None:
    if as_json:
        out.print_json(json.dumps(dict(found)))
        return
    width = max(map(len, found))
    for name, text in found.items():
        say(f"{name:{width}}  {text}")
