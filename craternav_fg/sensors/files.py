"""A sensor's folder in a data set: `mav0/NAME0/sensor.yaml` and `data.csv`, read, checked and written."""

import json
from pathlib import Path

import numpy as np

from craternav_fg.config import read_text, validate
from craternav_fg.sensors.protocol import Sensor, Surroundings
from craternav_fg.sensors.yaml_files import dump_yaml, mounting, parse_yaml
from craternav_fg.tables import Column, read_table, write_table
from factors.arrays import IntArray

STAMP = "timestamp"
SETTINGS, DATA = "sensor.yaml", "data.csv"
_STAMP_COLUMN = Column(STAMP, "integer", unit="ns")


def folder_of(name: str) -> str:
    """Folder of a sensor in a data set."""
    return f"mav0/{name}0"


def read_sensor(
    folder: Path, kind: type[Sensor], surroundings: Surroundings, begin_ns: int, end_ns: int
) -> Sensor:
    """Read a sensor's log.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    kind : type
        The sensor's class.
    surroundings : Surroundings
    begin_ns, end_ns : int
        Begin and end of the descent: stamps outside are refused.

    Returns
    -------
    Sensor

    Raises
    ------
    InputError
        When a file is missing or wrong: names file, line, column, what was expected and found.
    """
    here = folder / folder_of(kind.name)
    text = read_text(here / SETTINGS)
    settings = validate(here / SETTINGS, parse_yaml(here / SETTINGS, text), kind.Settings, text=text)
    mounting(here / SETTINGS, text, settings.T_BS.data)
    columns = kind.columns(settings)
    table = read_table(here / DATA, (_STAMP_COLUMN, *columns))
    table.require_increasing(STAMP)
    stamps: IntArray = table.columns[STAMP]
    for row in np.flatnonzero((stamps < begin_ns) | (stamps > end_ns)).tolist():
        table.fail(
            row, STAMP, f"expected a stamp within the descent, {begin_ns} to {end_ns} ns, found {stamps[row]}"
        )
    sensor = kind(settings, stamps, table.numbers(*(column.name for column in columns)), surroundings)
    for row in range(len(sensor)):
        problem = sensor.fault(row)
        if problem is not None:
            table.fail(row, *problem)
    return sensor


def write_sensor(folder: Path, sensor: Sensor) -> None:
    """Write a sensor's log into a data set; numbers read back exactly.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    sensor : Sensor
    """
    here = folder / folder_of(sensor.name)
    here.mkdir(parents=True)
    plain = json.loads(sensor.settings.model_dump_json(exclude_none=True))
    (here / SETTINGS).write_text(dump_yaml(plain), encoding="utf-8")
    columns = sensor.columns(sensor.settings)
    write_table(here / DATA, (_STAMP_COLUMN, *columns), [sensor.stamps_ns, *sensor.values.T], comment=True)
