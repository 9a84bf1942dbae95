"""Scenario files in TOML: the whole scenario, and how it is found and read."""

import difflib
import importlib.resources
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from craternav_fg.config import BodySection, Section, read_toml, validate
from craternav_fg.errors import InputError
from craternav_fg.motion.settings import MotionSection
from craternav_fg.simulation.scenario_tables import (
    FORMER,
    CameraSection,
    CraterFile,
    CraterList,
    ExpectedSection,
    FaultsSection,
    ImuSection,
    InitialErrorSection,
    MeasurementSection,
    PublishedCraters,
    RandomCraters,
    RenderSection,
    SunSection,
    TerrainSection,
    TrajectorySection,
)
from craternav_fg.simulation.sensor_tables import check_sensor

# Environment variable with the folder of public files.
DATA_VARIABLE = "CRATERNAV_DATA"
# Tables and keys that name files: one, or a list.
_FILES = (("craters", "path"), ("craters", "heights"), ("terrain", "dem"))


class Scenario(Section):
    """One simulated case."""

    seed: Annotated[int, Field(ge=0)]
    """With the number of a trial, it determines all random numbers."""
    body: BodySection
    camera: CameraSection
    imu: ImuSection | None = None
    """Omitted if there is a table [motion]."""
    motion: MotionSection | None = None
    """If given, there is no IMU, and the lander follows this model with simulated process noise."""
    trajectory: TrajectorySection
    sun: SunSection
    initial_error: InitialErrorSection
    craters: Annotated[
        RandomCraters | CraterFile | CraterList | PublishedCraters, Field(discriminator="source")
    ]
    terrain: TerrainSection | None = None
    """Required for images and for random craters."""
    render: RenderSection | None = None
    """If given, the data set holds images."""
    measurements: MeasurementSection | None = None
    """If given, the data set holds simulated measurements and no images."""
    sensors: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """By name: the keys of the sensor's `sensor.yaml`, and a table `simulation`, see `SensorSimulation`."""
    faults: FaultsSection = Field(default_factory=FaultsSection)
    data: dict[str, str] = Field(default_factory=dict)
    """Files of the data folder that the scenario needs, and the public products that hold them."""
    expected: dict[str, ExpectedSection] = Field(default_factory=dict)
    """Expected results of the scenario, by estimator."""

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
        if self.craters.source == "published":
            if self.render is None:
                raise ValueError("published craters need a table [render]: only images show their true rims")
            if self.terrain is None or self.terrain.dem is None:
                raise ValueError("published craters need the elevation model that shows them: [terrain] dem")
        if self.terrain is None and (self.render is not None or self.craters.source == "random"):
            raise ValueError("expected a table [terrain] for [render] and for random craters")
        if self.measurements is None and (
            self.faults.wrong_match_share > 0.0 or self.faults.without_sun or self.faults.craterless_s
        ):
            raise ValueError("wrong_match_share, without_sun and craterless_s need a table [measurements]")
        return self

    def files(self) -> tuple[str, ...]:
        """Return the paths of the files that the scenario reads."""
        found: list[str] = []

        def noted(file: str) -> str:
            found.append(file)
            return file

        self.located(noted)
        return tuple(found)

    def located(self, place: Callable[[str], str]) -> "Scenario":
        """Replace the paths of files.

        Parameters
        ----------
        place : callable
            Returns the path to read for a path in the file.

        Returns
        -------
        Scenario
        """
        changed: dict[str, Any] = {}
        for table, key in _FILES:
            section = changed.get(table, getattr(self, table))
            if getattr(section, key, None) is not None:
                value = _placed(getattr(section, key), place)
                changed[table] = section.model_copy(update={key: value})
        return self.model_copy(update=changed)

    def with_data(self, folder: Path | None = None) -> "Scenario":
        """Find the public files that the scenario needs.

        Parameters
        ----------
        folder : Path, optional
            Folder of the files; by default that of the environment variable `CRATERNAV_DATA`.

        Returns
        -------
        Scenario
            With the paths of the files.

        Raises
        ------
        InputError
            When one is missing.
        """
        named = os.environ.get(DATA_VARIABLE)
        if folder is None and named:
            folder = Path(named)

        def found(file: str) -> str:
            if file not in self.data:
                return file
            if folder is not None and (folder / file).is_file():
                return str((folder / file).resolve())
            where = "no data folder is given" if folder is None else f"not in {folder}"
            problem = f"the scenario needs {self.data[file]}: {where} (--data FOLDER or {DATA_VARIABLE}"
            raise InputError(
                Path(file), f"{problem}; the documentation's page 'Real ground from public data' tells more)"
            )

        return self.located(found)


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario from a file, or a built-in scenario.

    Parameters
    ----------
    name : str or Path
        Path of a TOML file, or name of a built-in scenario.

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
    A table [measurements] replaces a base's [render] and vice versa. Paths are relative to the file that
    has them.
    """
    return _with_base(_find(name))


def _find(name: str | Path) -> Path:
    path = Path(name)
    if path.suffix != ".toml" and not path.is_file():
        path = built_in_scenarios().get(str(name), path)
        if path.suffix != ".toml":
            near = difflib.get_close_matches(str(name), built_in_scenarios(), 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            known = ", ".join(built_in_scenarios())
            raise InputError(path, f"not found{hint}: expected a TOML file or one of the scenarios {known}")
    return path


def _with_base(path: Path) -> Scenario:
    """Read a scenario that may hold only its differences from another."""
    text, data = read_toml(path)
    files = [(path, data)]
    while "base" in files[-1][1]:
        base = files[-1][1].pop("base")
        if not isinstance(base, str):
            raise InputError(path, f"expected the name of a scenario, found {base!r}", column="base")
        beside = files[-1][0].parent / base
        found = beside if beside.suffix == ".toml" else _find(base)
        if any(found.resolve() == file.resolve() for file, _ in files):
            raise InputError(path, f"is its own base, by way of {found}", column="base")
        files.append((found, read_toml(found)[1]))
    public = {name for _, tables in files if isinstance(tables.get("data"), dict) for name in tables["data"]}
    for file, tables in files:
        _locate(tables, file.parent, public)
    for _, under in files[1:]:
        # A scenario that differs from its base has other figures.
        under.pop("expected", None)
        for given, other in (("measurements", "render"), ("render", "measurements")):
            if given in data:
                under.pop(other, None)
        _drop_other_names(under, data)
        data = _merged(under, data)
    return validate(path, data, Scenario, text=text)


def _drop_other_names(under: dict[str, Any], over: dict[str, Any]) -> None:
    """Remove keys of a base that a scenario states under their former or present names."""
    for table, names in FORMER.items():
        below, above = under.get(table), over.get(table)
        if isinstance(below, dict) and isinstance(above, dict):
            for present, former in names.items():
                for given, other in ((present, former), (former, present)):
                    if given in above:
                        below.pop(other, None)


def _locate(tables: dict[str, Any], folder: Path, public: set[str]) -> None:
    """Replace the paths in the tables of a file, but for those of public files."""
    for table, key in _FILES:
        section = tables.get(table)
        if isinstance(section, dict) and section.get(key):
            section[key] = _placed(
                section[key], lambda file: file if file in public else str((folder / file).resolve())
            )


def _placed(files: Any, place: Callable[[str], str]) -> Any:
    """Replace a path or a list of paths; what is neither stays, and is refused where the file is checked."""
    if isinstance(files, str):
        return place(files)
    if isinstance(files, list | tuple):
        return type(files)(place(file) if isinstance(file, str) else file for file in files)
    return files


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
    """Return the paths of the scenarios that come with the package, by name."""
    folder = importlib.resources.files("scenarios")
    return {
        Path(entry.name).stem: Path(str(entry))
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith(".toml")
    }
