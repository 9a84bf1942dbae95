"""`craternav check`: what a data set holds, or its first fault."""

import json

from craternav_fg.dataset import layout
from tests.cli.calls import call
from tests.dataset.conftest import folder, rims_folder, with_images, with_rims  # noqa: F401


def test_a_data_set_with_images_is_summarised(folder):  # noqa: F811
    (folder.path / "mav0/radar0").mkdir()
    done = call("check", folder.path)
    assert done.code == 0
    lines = {line.split()[0]: " ".join(line.split()[1:]) for line in done.out.splitlines()}
    assert lines["body"] == 'Moon "test", sphere of 1737.4 km'
    assert lines["frames"] == "3 over 0.4 s"
    assert lines["images"] == "3 of 64 x 48 px"
    assert lines["IMU"] == "100 Hz"
    assert lines["catalogue"] == (
        "2 craters, diameters 1.8 to 2.47 km, with heights, exact, unless the rims show otherwise"
    )
    assert (lines["initial"], lines["truth"], lines["a-priori"]) == ("given", "given", "none")
    assert "warning: not used: mav0/radar0: unknown sensor" in done.err


def test_copies_of_images_are_told(folder):  # noqa: F811
    first, second, _ = sorted((folder.path / layout.IMAGES).glob("*.png"))
    second.write_bytes(first.read_bytes())
    done = call("check", folder.path)
    assert done.code == 0
    assert f"{second.name} (same pixels as {first.name})" in done.err


def test_a_data_set_with_rims_as_json(rims_folder):  # noqa: F811
    done = call("check", rims_folder.path, "--json")
    values = json.loads(done.out)
    assert values["rims_per_frame"] == [0, 1, 2]
    assert (values["arcs"], values["sun_tilts"], values["images"]) == (2, 2, None)
    assert done.err == ""
    assert "3 measured, 0 to 2 in a frame; 2 arcs, 2 sun tilts" in call("check", rims_folder.path).out


def test_the_first_fault_is_one_line(folder):  # noqa: F811
    (folder.path / layout.IMU_DATA).unlink()
    done = call("check", folder.path)
    assert (done.code, done.out) == (2, "")
    assert done.err == f"craternav: {folder.path / layout.IMU_DATA}: file is missing\n"
