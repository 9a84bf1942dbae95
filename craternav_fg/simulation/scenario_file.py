"""Scenario files in TOML: the whole scenario, and how it is found and read."""

import difflib
import importlib.resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from craternav_fg.config import BodySection, Section, read_toml, validate
from craternav_fg.errors import InputError
from craternav_fg.motion.settings import MotionSection
from craternav_fg.simulation.scenario_tables import (
    CameraSection,
    CraterFile,
    CraterList,
    ExpectedSection,
    FaultsSection,
    ImuSection,
    InitialErrorSection,
    MeasurementSection,
    RandomCraters,
    RenderSection,
    SunSection,
    TerrainSection,
    TrajectorySection,
)
from craternav_fg.simulation.sensor_tables import check_sensor


class Scenario(Section):
    """One simulated case."""

    seed: Annotated[int, Field(ge=0)]
    body: BodySection
    camera: CameraSection
    imu: ImuSection | None = None
    """Left out with a table [motion]."""
    motion: MotionSection | None = None
    """If given, there is no IMU: the lander moves as this model says, with a draw of its process noise."""
    trajectory: TrajectorySection
    sun: SunSection
    initial_error: InitialErrorSection
    craters: Annotated[RandomCraters | CraterFile | CraterList, Field(discriminator="source")]
    terrain: TerrainSection | None = None
    """Required for images and for random craters."""
    render: RenderSection | None = None
    """If given, the data set holds images."""
    measurements: MeasurementSection | None = None
    """If given, the data set holds simulated measurements and no images."""
    sensors: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """By name: the keys of the sensor's `sensor.yaml`, and a table `simulation`, see `SensorSimulation`."""
    faults: FaultsSection = Field(default_factory=FaultsSection)
    expected: dict[str, ExpectedSection] = Field(default_factory=dict)
    """By estimator: the figures that the case is expected to have."""

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scenario":
        if (self.render is None) == (self.measurements is None):
            raise ValueError("expected either a table [render] or a table [measurements]")
        if (self.imu is None) == (self.motion is None):
            raise ValueError("expected either a table [imu] or a table [motion]")
        if (self.trajectory.end is None) == (self.motion is None):
            raise ValueError("expected a table [trajectory.end] without [motion], and none with it")
        for name, table in self.sensors.items():
            check_sensor(name, table)
        if self.terrain is None and (self.render is not None or self.craters.source == "random"):
            raise ValueError("expected a table [terrain] for [render] and for random craters")
        if self.measurements is None and (
            self.faults.wrong_matches > 0.0 or self.faults.without_sun or self.faults.craterless_s
        ):
            raise ValueError("wrong_matches, without_sun and craterless_s need a table [measurements]")
        return self


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario from a file, or a built-in one by its name.

    Parameters
    ----------
    name : str or Path
        Path of a TOML file, or the stem of one in the package `scenarios`.

    Returns
    -------
    Scenario

    Raises
    ------
    InputError
        When there is no such scenario, or it is wrong (see `load_toml`).

    Notes
    -----
    A file with `base = "NAME"` holds the differences from that scenario: a built-in one, or a file beside it.
    A table [measurements] replaces a base's [render] and vice versa.
    """
    path = _find(name)
    scenario = _with_base(path)
    if isinstance(scenario.craters, CraterFile):
        resolved = str((path.parent / scenario.craters.path).resolve())
        scenario = scenario.model_copy(update={"craters": CraterFile(source="file", path=resolved)})
    if scenario.terrain is not None and scenario.terrain.dem is not None:
        resolved = str((path.parent / scenario.terrain.dem).resolve())
        terrain = scenario.terrain.model_copy(update={"dem": resolved})
        scenario = scenario.model_copy(update={"terrain": terrain})
    return scenario


def _find(name: str | Path) -> Path:
    path = Path(name)
    if path.suffix != ".toml" and not path.is_file():
        path = built_in_scenarios().get(str(name), path)
        if path.suffix != ".toml":
            near = difflib.get_close_matches(str(name), built_in_scenarios(), 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            known = ", ".join(built_in_scenarios())
            raise InputError(path, f"expected a TOML file or one of the built-in scenarios {known}{hint}")
    return path


def _with_base(path: Path) -> Scenario:
    """Read a scenario that may hold only its differences from another."""
    text, data = read_toml(path)
    seen = [path]
    while "base" in data:
        base = data.pop("base")
        if not isinstance(base, str):
            raise InputError(path, f"expected the name of a scenario, found {base!r}", column="base")
        beside = seen[-1].parent / base
        seen.append(beside if beside.suffix == ".toml" else _find(base))
        if seen[-1] in seen[:-1]:
            raise InputError(path, f"is its own base, by way of {seen[-1]}", column="base")
        _, under = read_toml(seen[-1])
        # A scenario that differs from its base has other figures.
        under.pop("expected", None)
        for given, other in (("measurements", "render"), ("render", "measurements")):
            if given in data:
                under.pop(other, None)
        data = _merged(under, data)
    return validate(path, data, Scenario, text=text)


def _merged(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Merge tables key by key; other values are those of `over`."""
    out = dict(under)
    for key, value in over.items():
        below = under.get(key)
        out[key] = value
        # Craters of another source have other keys: they replace the whole table.
        if (
            isinstance(value, dict)
            and isinstance(below, dict)
            and value.get("source", below.get("source")) == below.get("source")
        ):
            out[key] = _merged(below, value)
    return out


def built_in_scenarios() -> dict[str, Path]:
    """Give the paths of the scenarios that come with the package, by name."""
    folder = importlib.resources.files("scenarios")
    return {
        Path(entry.name).stem: Path(str(entry))
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith(".toml")
    }
