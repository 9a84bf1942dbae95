"""`craternav detect`: its files, and what it says of bad input."""

import csv
import json
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from craternav_fg.simulation.scenes import Ground, scene
from tests.cli.calls import call

HEADER = [
    "ellipseCenterX(px)", "ellipseCenterY(px)", "ellipseSemimajor(px)", "ellipseSemiminor(px)",
    "ellipseRotation(deg)", "inputImage", "crater_classification", "traced",
]  # fmt: skip


@pytest.fixture(scope="module")
def one():
    return scene(3, Ground(size_px=640))


def detect(*arguments):
    """Exit code, standard output and standard error of the command."""
    done = call("detect", *arguments)
    return done.code, done.out, done.err


@pytest.mark.parametrize("method", ["template", "network", "canny"])
def test_table_json_and_overlay_agree(one, tmp_path, method):
    path, table = tmp_path / "frame.png", tmp_path / "out" / "rims.csv"
    cv2.imwrite(str(path), one.image)
    code, output, _ = detect(path, "-o", table, "--method", method, "--json")
    assert code == 0
    result = json.loads(output)
    with table.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == HEADER
    assert len(rows) - 1 == len(result["rims"]) >= 5
    for row, rim in zip(rows[1:], result["rims"], strict=True):
        assert row[5:] == ["frame.png", "-1", str(int(rim["traced"]))]
        keys = ("center_x_px", "center_y_px", "semi_major_px", "semi_minor_px", "rotation_deg")
        assert [float(cell) for cell in row[:5]] == [rim[key] for key in keys]
        assert -90.0 <= rim["rotation_deg"] <= 90.0
        assert 0.0 < rim["quality"] <= 1.0
        assert 0.0 < rim["center_sigma_px"] < 5.0
    off_deg = (result["sun_angle_deg"] - np.rad2deg(one.sun_angle_rad) + 180.0) % 360.0 - 180.0
    assert abs(off_deg) < 12.0
    assert result["detect_ms"] > 0.0
    overlay = cv2.imread(result["overlay"])
    assert overlay.shape == (640, 640, 3)
    # Colour where the rims are, none off them.
    colour = np.ptp(overlay.astype(int), axis=2) > 20
    best = result["rims"][0]
    turn, tilt = np.linspace(0.0, 2.0 * np.pi, 60), np.deg2rad(best["rotation_deg"])
    u, v = best["semi_major_px"] * np.cos(turn), best["semi_minor_px"] * np.sin(turn)
    x = np.rint(best["center_x_px"] + u * np.cos(tilt) - v * np.sin(tilt)).astype(int)
    y = np.rint(best["center_y_px"] + u * np.sin(tilt) + v * np.cos(tilt)).astype(int)
    assert colour[y, x].mean() > 0.9
    assert colour.mean() < 0.2


def test_in_words(one, tmp_path):
    path = tmp_path / "frame.tif"
    cv2.imwrite(str(path), one.image.astype(np.uint16) * 257)
    code, output, _ = detect(path, "-o", tmp_path / "rims.csv", "--min-radius-px", 15, "--min-quality", 0.9)
    assert code == 0
    assert "rims, the sun towards " in output
    assert str(tmp_path / "rims_overlay.png") in output
    cv2.imwrite(str(path), np.full((300, 300), 90, np.uint8))
    code, output, _ = detect(path, "-o", tmp_path / "rims.csv", "--force")
    assert code == 0
    assert output.startswith("no rims: all pixels have one value\n")
    assert (tmp_path / "rims.csv").read_text(encoding="utf-8") == ",".join(HEADER) + "\n"


def test_wrong_sun_holds_with_a_warning(one, tmp_path):
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), one.image)
    wrong = (np.rad2deg(one.sun_angle_rad) + 180.0) % 360.0
    code, output, error = detect(path, "-o", tmp_path / "rims.csv", "--sun-deg", wrong, "--json")
    assert code == 0
    assert error.count("\n") == 1
    assert f"warning: {path}: the sun is given at {wrong:.0f} deg in the image" in error
    off_deg = (json.loads(output)["sun_angle_deg"] - wrong + 180.0) % 360.0 - 180.0
    assert abs(off_deg) < 0.1
    code, _, error = detect(path, "-o", tmp_path / "rims.csv", "--sun-deg", wrong - 180.0, "--force")
    assert (code, error) == (0, "")


def _text(path):
    path.write_text("no image", encoding="utf-8")


def _cut(path):
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (99, 99), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[:-3000])


def _huge(path):
    Image.new("1", (6000, 6000)).save(path)


def _header_of_60000(path):
    """A PNG that states 60,000 x 60,000 px and holds none of them."""
    size = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunks = [
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in ((b"IHDR", size), (b"IDAT", zlib.compress(b"")))
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


def _cut_tiff(path):
    noise = np.random.default_rng(0).integers(0, 255, (99, 99), dtype=np.uint8)
    Image.fromarray(noise).save(path, format="TIFF")
    path.write_bytes(path.read_bytes()[:-5000])


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: None, "file is missing"),
        (lambda path: path.mkdir(), "found a folder"),
        (lambda path: path.write_bytes(b""), "cannot be read as an image"),
        (_text, "cannot be read as an image"),
        (_cut, "cannot be read as an image"),
        (_huge, "6000 x 6000 px are more than 25 million: crop it, or name a folder (-o FOLDER)"),
        (_header_of_60000, "more than 25 million pixels: crop it"),
        (_cut_tiff, "cannot be read as an image"),
    ],
    ids=["missing", "folder", "empty", "text", "cut", "huge", "header", "cut TIFF"],
)
def test_what_is_no_image_is_one_line(tmp_path, write, message):
    path = tmp_path / "frame.png"
    write(path)
    code, output, error = detect(path, "-o", tmp_path / "rims.csv")
    assert (code, output) == (2, "")
    assert error.count("\n") == 1
    assert f"{path}: " in error
    assert message in error
    assert not (tmp_path / "rims.csv").exists()


def test_table_and_overlay_appear_both_or_neither(one, tmp_path):
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), one.image)
    overlay = tmp_path / "rims_overlay.png"
    overlay.mkdir()
    code, _, said = detect(path, "-o", tmp_path / "rims.csv")
    assert code == 2
    assert "rims_overlay.png" in said
    assert sorted(tmp_path.iterdir()) == [path, overlay]


@pytest.mark.parametrize("method", ["template", "network"])
def test_an_empty_result_says_why(tmp_path, method):
    path = tmp_path / "frame.tif"
    rng = np.random.default_rng(0)
    images = {
        "no rims: 3 x 3 px are too small for a radius of 8 px\n": rng.integers(
            0, 255, (3, 3), dtype=np.uint8
        ),
        "no rims: the image has no data\n": np.full((99, 99), np.nan, np.float32),
        "no rims: nothing looks like a lit crater": rng.integers(90, 110, (99, 99), dtype=np.uint8),
    }
    for reason, image in images.items():
        cv2.imwrite(str(path), image)
        code, output, _ = detect(path, "-o", tmp_path / "rims.csv", "--method", method, "--force")
        assert code == 0
        assert output.startswith(reason)


def test_pixels_of_the_declared_value_are_no_data(tmp_path):
    path, tags = tmp_path / "frame.tif", ImageFileDirectory_v2()
    tags[42113] = "90"
    Image.fromarray(np.full((99, 99), 90, np.uint8)).save(path, tiffinfo=tags)
    code, output, _ = detect(path, "-o", tmp_path / "rims.csv")
    assert code == 0
    assert output.startswith("no rims: the image has no data\n")


def test_a_palette_is_read_as_grey(one, tmp_path):
    grey, palette = tmp_path / "grey.png", tmp_path / "palette.png"
    cv2.imwrite(str(grey), one.image)
    image = Image.fromarray(one.image)
    image.putpalette([level for level in range(256) for _ in range(3)])
    assert image.mode == "P"
    image.save(palette)
    tables = []
    for path in (grey, palette):
        assert detect(path, "-o", path.with_suffix(".csv"))[0] == 0
        with path.with_suffix(".csv").open(newline="", encoding="utf-8") as stream:
            tables.append([[float(cell) for cell in row[:5]] for row in list(csv.reader(stream))[1:]])
    assert len(tables[0]) >= 5
    np.testing.assert_allclose(tables[1], tables[0], atol=0.01)


def test_the_image_is_not_overwritten(one, tmp_path):
    path = tmp_path / "rims_overlay.png"
    cv2.imwrite(str(path), one.image)
    before = path.read_bytes()
    for output in (path, tmp_path / "rims.csv"):
        code, _, error = detect(path, "-o", output)
        assert code == 2
        assert "would be overwritten" in error
    assert path.read_bytes() == before


@pytest.mark.parametrize("sun", ["nan", "inf"])
def test_the_sun_is_a_direction(one, tmp_path, sun):
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), one.image)
    code, _, error = detect(path, "-o", tmp_path / "rims.csv", "--sun-deg", sun)
    assert code == 2
    assert "expected an angle in degrees" in error
