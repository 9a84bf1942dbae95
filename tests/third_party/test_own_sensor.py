"""The sensor that the documentation builds, from the page itself."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.sensors.protocol import ATTITUDE, POSITION, SensorState, Surroundings
from tests.third_party.test_plugins import SCENARIO, in_turn

PAGE = Path(__file__).resolve().parents[2] / "docs/tutorials/own_sensor.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.fixture(scope="module")
def module() -> str:
    (text,) = blocks("python")
    return text


def test_it_is_about_eighty_lines(module: str) -> None:
    assert len(module.splitlines()) <= 85


def test_its_derivatives_are_right(module: str) -> None:
    names: dict[str, object] = {"__name__": "beacon"}
    exec(compile(module, "beacon.py", "exec"), names)
    Beacon, Settings = names["Beacon"], names["BeaconSettings"]
    mounting = {"data": (1.0, 0, 0, 0.5, 0, 1.0, 0, -0.2, 0, 0, 1.0, 0.3, 0, 0, 0, 1.0)}
    settings = Settings(position_g_m=(1.7374e6, 0.0, 0.0), bias_sigma_m=2.0, T_BS=mounting)  # type: ignore[operator]
    ground = Surroundings(Body("Moon", 1.7374e6, 4.9e12, (0.0, 0.0, 0.0)), lambda gP: 0.0)
    sensor = Beacon(settings, np.array([0]), np.array([[9e3]]), ground)  # type: ignore[operator]
    gTb = frames.pose(frames.rotation_exp(np.array([0.3, -0.5, 0.2])), np.array([1.7464e6, 2e3, -3e3]))

    def error(turn: np.ndarray, step: np.ndarray, bias: float) -> np.ndarray:
        moved = gTb @ frames.pose(frames.rotation_exp(turn), np.zeros(3))
        moved[:3, 3] += step
        return sensor.linearise(0, SensorState(0, moved, np.zeros(3), np.zeros(3)), np.array([bias])).error

    found = sensor.linearise(0, SensorState(0, gTb, np.zeros(3), np.zeros(3)), np.array([1.0]))
    zero, h = np.zeros(3), 1e-3
    for axis in np.eye(3):
        numeric = (error(h * axis, zero, 1.0) - error(-h * axis, zero, 1.0)) / (2 * h)
        np.testing.assert_allclose(found.jacobian[:, ATTITUDE] @ axis, numeric, atol=1e-6)
        numeric = (error(zero, axis, 1.0) - error(zero, -axis, 1.0)) / 2
        np.testing.assert_allclose(found.jacobian[:, POSITION] @ axis, numeric, atol=1e-6)
    np.testing.assert_allclose(found.bias_jacobian[:, 0], error(zero, zero, 1.5) - error(zero, zero, 0.5))


def test_it_is_found_simulated_and_estimated(module: str, tmp_path: Path) -> None:
    package = tmp_path / "my_lander"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "beacon.py").write_text(module, encoding="utf-8")
    about = tmp_path / "my_lander-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-lander\nVersion: 1.0\n")
    entry, scenario = blocks("toml")
    named = tomllib.loads(entry)["project"]["entry-points"]["craternav_fg.sensors"]
    lines = [f"{name} = {place}\n" for name, place in named.items()]
    (about / "entry_points.txt").write_text("[craternav_fg.sensors]\n" + "".join(lines))
    table = scenario[scenario.index("[sensors.beacon]") :]
    short = SCENARIO[: SCENARIO.index("[sensors.sun_sensor]")]
    (tmp_path / "beacon.toml").write_text(short + table, encoding="utf-8")
    listed, simulated, done = in_turn(
        tmp_path,
        ["sensors", "--json"],
        ["simulate", tmp_path / "beacon.toml", "-o", tmp_path / "data"],
        ["reconstruct", tmp_path / "data", "-o", tmp_path / "run", "-e", "smoother,ekf", "--json"],
    )
    assert "beacon" in json.loads(listed.out)
    assert simulated.code == 0, simulated.err
    assert done.code == 0, done.err
    # The files of the page's own log hold what the simulated ones hold.
    (settings,), (log,) = blocks("yaml"), blocks("text")
    sensor = tmp_path / "data/mav0/beacon0"
    assert set(yaml.safe_load(settings)) <= set(yaml.safe_load((sensor / "sensor.yaml").read_text()))
    assert log.splitlines()[0] == (sensor / "data.csv").read_text().splitlines()[0]
    (sensor / "sensor.yaml").write_text(settings)
    (found,) = in_turn(tmp_path, ["reconstruct", tmp_path / "data", "-o", tmp_path / "own", "-e", "ekf"])
    assert found.code == 0, found.err
    nis = json.loads(done.out)["innovations"]["nis"]["beacon"]
    assert nis["low"] < nis["mean"] < nis["high"]
