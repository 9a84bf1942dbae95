"""Detection on many images: files, resuming, what cannot be read, and what the command says."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from craternav_fg.detection import images
from craternav_fg.detection.images import Where, detect_images
from craternav_fg.detection.settings import DetectionSettings, Method
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.simulation.scenes import Ground, scene
from tests.campaign import inline
from tests.cli.calls import call

SETTINGS = DetectionSettings(Method.TEMPLATE)
HERE = Where(1)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Five images, the third damaged."""
    folder = tmp_path_factory.mktemp("frames")
    image = scene(3, Ground(size_px=320)).image
    paths = [folder / f"frame{k}.png" for k in range(5)]
    for k, path in enumerate(paths):
        cv2.imwrite(str(path), np.rot90(image, k))
    paths[2].write_bytes(paths[2].read_bytes()[:-3000])
    return paths


@pytest.fixture
def here(monkeypatch):
    """Work without other processes."""
    monkeypatch.setattr(images, "processes", inline.processes)


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.*"))}


def timeless(folder):
    """Contents without what depends on the clock."""
    kept = {name: data for name, data in files(folder).items() if not name.endswith((".json", "summary.csv"))}
    records = [json.loads(path.read_text()) for path in sorted((folder / "rims").glob("*.json"))]
    return kept, [{**record, "seconds": 0.0} for record in records]


def test_each_image_has_its_files_and_a_row(frames, tmp_path, here):
    steps = []
    rows = detect_images(frames, tmp_path / "out", SETTINGS, HERE, progress=lambda *step: steps.append(step))
    assert steps == [("images", k, 5) for k in range(6)]
    with (tmp_path / "out" / "summary.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [row["image"] for row in table] == [str(path) for path in frames]
    for k, (row, found) in enumerate(zip(table, rows, strict=True)):
        assert row["rims"] == ("" if found["rims"] is None else str(found["rims"]))
        if k == 2:
            assert "cannot be read as an image" in row["error"]
            assert not (tmp_path / "out" / "rims" / "frame2.csv").exists()
            continue
        lines = (tmp_path / "out" / "rims" / f"frame{k}.csv").read_text().splitlines()
        assert len(lines) - 1 == found["rims"] >= 3
        assert cv2.imread(str(tmp_path / "out" / "rims" / f"frame{k}_overlay.png")) is not None
    # The image is turned by 90 deg to the left from one to the next, and the sun with it.
    sun = [rows[k]["sun_deg"] for k in (0, 1, 3, 4)]
    turned = np.mod(np.subtract(sun[0], sun) + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(np.mod(turned + 45.0, 360.0) - 45.0, [0.0, 90.0, 270.0, 0.0], atol=3.0)


def test_what_is_done_is_kept_and_a_changed_image_is_done_again(frames, tmp_path, here, monkeypatch):
    paths = [tmp_path / path.name for path in frames[:2]]
    for old, new in zip(frames, paths, strict=False):
        new.write_bytes(old.read_bytes())
    folder = tmp_path / "out"
    detect_images(paths[:1], folder, SETTINGS, HERE)
    first = files(folder)
    asked = []
    inner = images._detect
    monkeypatch.setattr(images, "_detect", lambda task: (asked.append(task.path), inner(task))[1])
    rows = detect_images(paths, folder, SETTINGS, HERE)
    assert asked == [str(paths[1])]
    assert rows[0]["rims"] >= 3
    assert {
        name: data for name, data in files(folder).items() if name in first and name != "summary.csv"
    } == {name: data for name, data in first.items() if name != "summary.csv"}
    whole = timeless(folder)
    # An image that has changed, and one whose table is gone.
    cv2.imwrite(str(paths[0]), np.full((300, 300), 90, np.uint8))
    (folder / "rims" / "frame1.csv").unlink()
    rows = detect_images(paths, folder, SETTINGS, HERE)
    assert sorted(asked[1:]) == sorted(map(str, paths))
    assert rows[0]["rims"] == 0
    assert timeless(folder)[0]["rims/frame1.csv"] == whole[0]["rims/frame1.csv"]
    # By force all that is asked for, and nothing else stays.
    asked.clear()
    detect_images(paths[1:], folder, SETTINGS, HERE, force=True)
    assert asked == [str(paths[1])]
    assert [path.name for path in (folder / "rims").glob("*.csv")] == ["frame1.csv"]


def test_pixels_of_the_declared_value_are_holes(frames, tmp_path, here, monkeypatch):
    path, tags, searched = tmp_path / "frame.tif", ImageFileDirectory_v2(), []
    tags[42113] = "0"
    image = cv2.imread(str(frames[0]), cv2.IMREAD_GRAYSCALE)
    image[:100] = 0
    Image.fromarray(image).save(path, tiffinfo=tags)
    detect = DetectionSettings.detect

    def spied(self, pixels, sun_rad):
        searched.append(pixels)
        return detect(self, pixels, sun_rad)

    monkeypatch.setattr(DetectionSettings, "detect", spied)
    detect_images([path], tmp_path / "out", SETTINGS, HERE)
    np.testing.assert_array_equal(searched[0][..., 1] == 0, image == 0)


def test_other_options_are_refused_in_one_line_without_force(frames, tmp_path, here):
    folder = tmp_path / "out"
    detect_images(frames[:1], folder, SETTINGS, HERE)
    before = files(folder)
    other = DetectionSettings(Method.TEMPLATE, min_radius_px=20.0)
    with pytest.raises(
        InputError, match=r"was made with min_radius_px 8\.0, not 20\.0: use --force"
    ) as caught:
        detect_images(frames[:2], folder, other, HERE)
    assert "\n" not in str(caught.value)
    assert files(folder) == before
    detect_images(frames[1:2], folder, other, HERE, force=True)
    assert sorted(path.name for path in (folder / "rims").iterdir()) == [
        "frame1.csv", "frame1.json", "frame1_overlay.png",
    ]  # fmt: skip


def test_a_folder_of_something_else_and_two_images_of_one_name(frames, tmp_path, here):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    with pytest.raises(InputError, match=r"is not empty and holds no detection\.json"):
        detect_images(frames[:1], tmp_path / "mine", SETTINGS, HERE, force=True)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]
    twin = tmp_path / "frame0.tif"
    with pytest.raises(InputError, match=r"frame0\.tif: has the name of .*frame0\.png"):
        detect_images([frames[0], twin], tmp_path / "out", SETTINGS, HERE)
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_there_leaves_nothing(frames, tmp_path):
    with pytest.raises(CraternavError, match="scheduler moon: expected an address"):
        detect_images(frames[:1], tmp_path / "out", SETTINGS, Where(1, "moon"))
    assert not (tmp_path / "out").exists()


def test_command_with_one_damaged_image_of_five(frames, tmp_path, here):
    folder = tmp_path / "out"
    done = call("detect", *frames, "-o", folder, "--method", "template", "--workers", 1)
    assert done.code == 2
    assert done.out.splitlines()[0].endswith(" rims in 4 of 5 images")
    assert done.out.splitlines()[1] == str(folder / "summary.csv")
    lines = done.err.splitlines()
    assert len(lines) == 2
    assert f"{frames[2]}: cannot be read as an image" in lines[0]
    assert "1 of 5 images failed, see the warnings above; the others are done" in lines[1]
    good = [path for k, path in enumerate(frames) if k != 2]
    done = call("detect", *good, "-o", folder, "--method", "template", "--workers", 1, "--json")
    assert (done.code, done.err) == (0, "")
    assert [row["error"] for row in json.loads(done.out)["images"]] == [None] * 4


def test_a_table_is_no_folder_for_several_images(frames, tmp_path):
    done = call("detect", *frames[:2], "-o", tmp_path / "rims.csv")
    assert done.code == 2
    assert "rims.csv: expected a folder for the results of 2 images" in done.err
    done = call("detect", *frames[:2], "-o", tmp_path / "x", "--workers", 2, "--scheduler", "tcp://a:1")
    assert done.code == 2
    assert "expected --workers or --scheduler, found both" in done.err


@pytest.mark.slow
def test_two_processes_give_what_one_gives(frames, tmp_path):
    good: list[Path] = [path for k, path in enumerate(frames) if k != 2]
    settings = DetectionSettings()
    for count in (1, 2):
        detect_images(good, tmp_path / str(count), settings, Where(count))
    assert timeless(tmp_path / "1") == timeless(tmp_path / "2")
