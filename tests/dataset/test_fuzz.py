"""However a data set is spoilt: it opens, or one line says what is wrong."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError

JUNK = [
    "nan",
    "inf",
    "-1",
    "1e400",
    '"',
    "[",
    "{}",
    "\x00",
    "é",
    ",",
    "\n",
    "\r",
    "#",
    " ",
    "1_0",
    ": ",
    "\ufeff",
]


@pytest.mark.parametrize("kind", ["with_images", "with_rims"])
@settings(
    max_examples=120,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_spoilt_data_sets_are_refused_or_read(kind, data, request):
    folder = request.getfixturevalue(kind)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    path = data.draw(st.sampled_from(files))
    whole = path.read_bytes()
    at = data.draw(st.integers(0, len(whole)))
    cut = data.draw(st.sampled_from([0, 1, 5, 40, len(whole)]))
    junk = data.draw(st.one_of(st.sampled_from(JUNK).map(str.encode), st.binary(max_size=3)))
    path.write_bytes(whole[:at] + junk + whole[at + cut :])
    try:
        opened = Dataset.open(folder)
        if opened.measurements is None:
            for frame in range(len(opened)):
                opened.image(frame)
    except InputError as error:
        message = str(error)
    else:
        message = str(folder)
    finally:
        path.write_bytes(whole)
    assert message.startswith(str(folder))
    assert "\n" not in message
