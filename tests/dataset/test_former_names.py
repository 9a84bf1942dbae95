"""Columns and keys of data sets that have former names: files with them are read, and none has both."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from craternav_fg.dataset import Dataset, layout, write_dataset
from craternav_fg.errors import InputError
from craternav_fg.motion.coast import coast
from craternav_fg.motion.settings import FORMER as KEYS
from craternav_fg.motion.white_acceleration import white_acceleration
from craternav_fg.motion.white_jerk import white_jerk
from tests.dataset.samples import random_measurements, recording

COLUMNS = {
    (layout.TILTS, "tilt_rad"): "tilt [rad]",
    (layout.TILTS, "sigma_rad"): "sigma [rad]",
    (layout.TILTS, "x_normalised"): "u",
    (layout.TILTS, "y_normalised"): "v",
    (layout.ARCS, "points_normalised"): "points",
    (layout.ARCS, "sigmas_normalised"): "sigmas",
    (layout.ARCS, "correlated_sigma_normalised"): "correlated_sigma",
    (layout.RIMS, "correlated"): "persistent",
    (layout.RIMS, "slope_contrast"): "gain",
}


def _folder(tmp_path: Path, **changes) -> Path:
    rng = np.random.default_rng(1)
    given = dataclasses.replace(recording(rng), measurements=random_measurements(rng), **changes)
    return write_dataset(tmp_path / "data", given)


def _rename(path: Path, name: str, other: str) -> None:
    if path.suffix == ".csv":
        head, rows = path.read_text().split("\n", 1)
        cells = [other if cell.removeprefix("#") == name else cell for cell in head.split(",")]
        path.write_text(f"{','.join(cells)}\n{rows}")
    else:
        table = pq.read_table(path)
        pq.write_table(
            table.rename_columns([other if one == name else one for one in table.column_names]), path
        )


def _values(folder: Path) -> list[np.ndarray]:
    frames = Dataset.open(folder).measurements
    tilts = [np.array([f.sun.tilt_rad, f.sun.sigma_rad, *f.sun.point]) for f in frames if f.sun is not None]
    arcs = [part for f in frames for part in (*f.arcs.points, *f.arcs.sigmas, f.arcs.correlated_sigmas)]
    sets = [f.rims for f in frames]
    rims = [
        *(one.correlated for one in sets if one.correlated is not None),
        *(one.quality.slope_contrast for one in sets if one.quality is not None),
    ]
    assert rims
    assert tilts
    assert arcs
    return [*tilts, *arcs, *rims]


@pytest.mark.parametrize(("file", "name"), COLUMNS)
def test_a_column_by_its_former_name_is_read(tmp_path: Path, file: str, name: str) -> None:
    folder = _folder(tmp_path)
    expected = _values(folder)
    _rename(folder / file, name, COLUMNS[file, name])
    for one, other in zip(_values(folder), expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("name", "spare", "former"),
    [("tilt_rad", "direction_x", "tilt"), ("sigmas_normalised", "correlated_sigma_normalised", "sigmas")],
)
def test_a_column_by_both_names_is_refused(tmp_path: Path, name: str, spare: str, former: str) -> None:
    folder = _folder(tmp_path)
    file = layout.TILTS if name.endswith("rad") else layout.ARCS
    _rename(folder / file, spare, former)
    with pytest.raises(InputError, match=rf"{re.escape(file)}.*{name}: expected each column once") as caught:
        Dataset.open(folder)
    assert "\n" not in str(caught.value)


def test_another_unit_of_a_former_column_is_refused(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    _rename(folder / layout.TILTS, "tilt_rad", "tilt [deg]")
    with pytest.raises(InputError, match=r"expected the unit \[rad\], found \[deg\]"):
        Dataset.open(folder)


@pytest.mark.parametrize(
    "motion", [coast(2e-5), white_acceleration(0.5), white_jerk(1e-3)], ids=lambda m: m.name
)
@pytest.mark.parametrize("name", KEYS)
def test_a_key_of_the_motion_by_its_former_name(tmp_path: Path, motion, name: str) -> None:
    folder = _folder(tmp_path, imu=None, imu_noise=None, motion=motion)
    path = folder / layout.DESCRIPTION
    text = path.read_text()
    if name not in text:
        return
    path.write_text(text.replace(name, KEYS[name]))
    assert getattr(Dataset.open(folder).motion, name) == getattr(motion, name)
    path.write_text(text.replace("\nmodel =", f"\n{KEYS[name]} = 0.1\nmodel ="))
    problem = rf"toml:\d+: motion\.{KEYS[name]}: is the former name of {name}, which is given, too"
    with pytest.raises(InputError, match=problem):
        Dataset.open(folder)
