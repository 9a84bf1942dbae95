"""A wrong spin of the body is told by what gyro and rims show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate


@pytest.mark.parametrize("twice", [False, True])
def test_it_is_refused_by_what_gyro_and_rims_show(tmp_path: Path, twice: bool) -> None:
    """The smoother searched for minutes, and its message did not name the spin."""
    data = Dataset.open(simulate("measured_descent", tmp_path / "data"))
    assert data.measurements is not None
    if twice:
        # Two rims are matched to one crater: one of them must be wrong.
        first, *others = data.measurements
        craters = first.rims.craters.copy()
        craters[1] = craters[0]
        doubled = replace(first, rims=replace(first.rims, craters=craters))
        data = replace(data, measurements=(doubled, *others))
    spin = np.array(data.body.spin_rad_s)
    x, y, z = (float(one) for one in spin + np.array([0.0, 1e-3, 0.0]))
    wrong = replace(data, body=replace(data.body, spin_rad_s=(x, y, z)))
    with pytest.raises(InputError, match=r"dataset\.toml: spin_rad_s: expected about \[(.*)\] by") as refused:
        reconstruct(wrong, ["smoother"])
    found = str(refused.value).split("[")[1].split("]")[0]
    np.testing.assert_allclose([float(one) for one in found.split(",")], spin, atol=3e-5)
