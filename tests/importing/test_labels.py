"""What is missing in a cube's label, or not what it should be, is named."""

from pathlib import Path

import pytest

from craternav_fg.errors import InputError
from craternav_fg.importing.labels import CubeLabel

LABEL = CubeLabel(Path("a.cub"), b"", {"IsisCube": {"Core": {"Base": "0.5", "Scale": "nan", "Lines": None}}})


def test_groups_are_found_or_named():
    assert LABEL.group("IsisCube", "Core")["Base"] == "0.5"
    for names in (("Table",), ("IsisCube", "Kernels"), ("IsisCube", "Core", "Base", "Lines")):
        expected = rf"^a\.cub: expected {'/'.join(names)} in the label, found none"
        with pytest.raises(InputError, match=expected):
            LABEL.group(*names)
    with pytest.raises(InputError, match=r"expected a group IsisCube/Core/Base in the label, found 0\.5"):
        LABEL.group("IsisCube", "Core", "Base")


def test_numbers_are_finite_or_refused():
    core = LABEL.group("IsisCube", "Core")
    assert LABEL.number(core, "Base") == 0.5
    for name, found in (("Scale", "'nan'"), ("Lines", "none"), ("Samples", "none")):
        with pytest.raises(InputError, match=rf"^a\.cub: {name}: expected a number .*, found {found}"):
            LABEL.number(core, name)
