"""What is missing in a cube's label, or not what it should be, is named."""

from pathlib import Path

import numpy as np
import pytest

from craternav_fg.errors import InputError
from craternav_fg.importing.labels import CubeLabel, read_label

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


TABLE = """
Object = Table
  Name = InstrumentPosition
  StartByte = 9
  Bytes = 32
  Records = 2
  {order}
  Group = Field
    Name = X
    Type = {kind}
    Size = 1
  End_Group
  Group = Field
    Name = Y
    Type = Double
    Size = 1
  End_Group
End_Object
End
"""


def cube(data: bytes, order: str = "", kind: str = "Double") -> CubeLabel:
    pvl = pytest.importorskip("pvl")
    return CubeLabel(Path("a.cub"), data, pvl.loads(TABLE.format(order=order, kind=kind)))


@pytest.mark.parametrize(("order", "kind"), [("", "<"), ("ByteOrder = Lsb", "<"), ("ByteOrder = Msb", ">")])
def test_tables_are_read_in_their_order_of_bytes(order, kind):
    numbers = [[1.0, -2.5], [1e-3, 7.0]]
    data = 8 * b"\xff" + np.array(numbers, dtype=f"{kind}f8").tobytes() + b"\xff"
    keywords, rows = cube(data, order).table("InstrumentPosition", 2)
    assert rows.tolist() == numbers
    assert keywords["Records"] == 2


def test_tables_that_cannot_be_read_are_refused():
    data = 8 * b"\0" + np.ones(4).tobytes()
    for read, problem in (
        (
            lambda: cube(data).table("InstrumentPointing", 2),
            "Pointing of .*, found InstrumentPosition",
        ),
        (lambda: cube(data, kind="Real").table("InstrumentPosition", 2), "fields of type Double"),
        (lambda: cube(data).table("InstrumentPosition", 3), "3 or more columns of 8 bytes, found 2 in 32"),
        (lambda: cube(data[:-1]).table("InstrumentPosition", 2), "truncated: expected 40 bytes, found 39"),
        (
            lambda: cube(data[:-8] + np.array(np.inf).tobytes()).table("InstrumentPosition", 2),
            "InstrumentPosition: expected finite numbers",
        ),
    ):
        with pytest.raises(InputError, match=problem):
            read()


def test_a_keyword_may_have_no_value(tmp_path):
    pytest.importorskip("pvl")
    path = tmp_path / "a.cub"
    path.write_text(
        "Object = IsisCube\n  Object = Core\n    Note =\n    Lines = 20\n  End_Object\nEnd_Object\nEnd\n"
    )
    label = read_label(path)
    assert label.number(label.group("IsisCube", "Core"), "Lines") == 20.0
