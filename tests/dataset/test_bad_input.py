"""Each way to spoil a data set gives one line that names the file, the place and what was found."""

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg.dataset import Dataset, layout
from craternav_fg.errors import InputError
from tests.dataset.samples import FRAMES_NS, START_NS

SECOND = int(FRAMES_NS[1])


def cell(name, line, column, value):
    """Spoil one cell of a CSV file."""

    def spoil(folder):
        def change(cells):
            cells[column] = value
            return [",".join(cells)]

        folder.edit_line(name, line, change)

    return spoil


def edit(name, old, new):
    return lambda folder: folder.edit(name, old, new)


def remove(name):
    return lambda folder: (folder.path / name).unlink()


def drop_lines(name, first, last):
    def spoil(folder):
        lines = (folder.path / name).read_text().splitlines()
        (folder.path / name).write_text("\n".join(lines[: first - 1] + lines[last:]) + "\n")

    return spoil


def image(name, change):
    path = f"{layout.IMAGES}/{name}.png"
    return lambda folder: (folder.path / path).write_bytes(change((folder.path / path).read_bytes()))


def encoded(shape, dtype=np.uint8):
    return lambda _: cv2.imencode(".png", np.zeros(shape, dtype))[1].tobytes()


def swap_axes(folder):
    def change(cells):
        cells[3], cells[4] = cells[4], cells[3]
        return [",".join(cells)]

    folder.edit_line(layout.CRATERS, 2, change)


TOML, CAM, IMU = layout.DESCRIPTION, layout.CAMERA_DATA, layout.IMU_DATA
CASES = {
    "no description": (remove(TOML), [TOML, "file is missing"]),
    "no camera": (remove(layout.CAMERA_SENSOR), [layout.CAMERA_SENSOR, "file is missing"]),
    "no frames' table": (remove(CAM), [CAM, "file is missing"]),
    "no IMU log": (remove(IMU), [IMU, "file is missing"]),
    "no craters": (remove(layout.CRATERS), [layout.CRATERS, "file is missing"]),
    "no sun": (remove(layout.SUN), [layout.SUN, "file is missing"]),
    "column missing": (edit(IMU, "a_RS_S_y [m s^-2],", ""), [f"{IMU}:1", "a_RS_S_y", "missing"]),
    "column too many": (edit(IMU, "a_RS_S_y [", "a_RS_S_q [m],a_RS_S_y ["), [f"{IMU}:1", "a_RS_S_q"]),
    "column twice": (edit(IMU, "a_RS_S_y [", "a_RS_S_x ["), [f"{IMU}:1", "a_RS_S_x", "twice"]),
    "other unit": (edit(IMU, "[rad s^-1]", "[deg s^-1]"), [f"{IMU}:1", "w_RS_S_x", "[deg s^-1]"]),
    "too few cells": (edit(IMU, f"\n{START_NS + 30_000_000},", "\n"), [f"{IMU}:4", "expected 7", "found 6"]),
    "no number": (cell(IMU, 7, 2, "fast"), [f"{IMU}:7", "w_RS_S_y", "'fast'"]),
    "empty cell": (cell(IMU, 7, 2, ""), [f"{IMU}:7", "w_RS_S_y", "''"]),
    "nan": (cell(IMU, 8, 3, "nan"), [f"{IMU}:8", "w_RS_S_z", "finite", "nan"]),
    "inf": (cell(IMU, 8, 4, "-inf"), [f"{IMU}:8", "a_RS_S_x", "finite", "-inf"]),
    "rate beyond reason": (cell(IMU, 8, 3, "1e20"), [f"{IMU}:8", "w_RS_S_z", "50 rad/s", "1e+20"]),
    "truth of no size": (
        cell(layout.TRUTH, 3, 1, "1e308"),
        [f"{layout.TRUTH}:3", "p_RS_R_x", "at most 1e+60", "1e+308"],
    ),
    "force beyond reason": (cell(IMU, 8, 4, "-1e30"), [f"{IMU}:8", "a_RS_S_x", "1000 m/s^2", "-1e+30"]),
    "stamp no integer": (cell(IMU, 9, 0, "1.5e18"), [f"{IMU}:9", "timestamp", "integer", "'1.5e18'"]),
    "stamp not in 64 bit": (cell(IMU, 9, 0, "9" * 25), [f"{IMU}:9", "timestamp", "integer"]),
    "stamp repeated": (cell(IMU, 9, 0, str(START_NS + 70_000_000)), [f"{IMU}:9", "timestamp", "previous"]),
    "stamp goes back": (cell(CAM, 3, 0, str(START_NS - 1)), [f"{CAM}:3", "timestamp", str(START_NS - 1)]),
    "IMU gap": (drop_lines(IMU, 12, 22), [f"{IMU}:12", "timestamp", "0.120 s", str(START_NS + 100_000_000)]),
    "stamps in microseconds": (
        edit(layout.IMU_SENSOR, "rate_hz: 100.0", "rate_hz: 0.1"),
        [IMU, "timestamp", "nanoseconds", "microseconds?"],
    ),
    "IMU log begins late": (drop_lines(IMU, 2, 9), [IMU, "over the frames", str(START_NS + 80_000_000)]),
    "IMU log ends early": (drop_lines(IMU, 39, 42), [IMU, "over the frames", str(FRAMES_NS[2])]),
    "IMU log of one row": (drop_lines(IMU, 3, 42), [IMU, "two rows", "1"]),
    "no frames": (drop_lines(CAM, 2, 4), [CAM, "one frame"]),
    "one image twice": (
        cell(CAM, 4, 1, f"{FRAMES_NS[0]}.png"),
        [f"{CAM}:4: filename", "each image once", f"'{FRAMES_NS[0]}.png' of line 2 again"],
    ),
    "image in another folder": (cell(CAM, 3, 1, "../x.png"), [f"{CAM}:3", "filename", "../x.png"]),
    "image missing": (remove(f"{layout.IMAGES}/{SECOND}.png"), [f"{SECOND}.png", "missing"]),
    "image truncated": (image(SECOND, lambda data: data[:-100]), [f"{SECOND}.png", "truncated"]),
    "image empty": (image(SECOND, lambda _: b""), [f"{SECOND}.png", "PNG"]),
    "image is a JPEG": (image(SECOND, lambda _: b"\xff\xd8\xff" + b"0" * 90), [f"{SECOND}.png", "PNG"]),
    "image of another size": (image(SECOND, encoded((64, 48))), [f"{SECOND}.png", "64 x 48", "48 x 64"]),
    "palette image": (
        image(SECOND, lambda data: data[:25] + b"\x03" + data[26:]),
        [f"{SECOND}.png", "8-bit grey", "palette"],
    ),
    "16-bit colour": (image(SECOND, encoded((48, 64, 3), np.uint16)), [f"{SECOND}.png", "16-bit colour"]),
    "image of 16 bit": (image(SECOND, encoded((48, 64), np.uint16)), [f"{SECOND}.png", "16-bit grey"]),
    "principal point outside": (
        edit(layout.CAMERA_SENSOR, "31.1", "131.1"),
        [f"{layout.CAMERA_SENSOR}:11", "intrinsics", "64 x 48", "131.1"],
    ),
    "focal length in metres": (
        edit(layout.CAMERA_SENSOR, "71.3", "0.05"),
        [f"{layout.CAMERA_SENSOR}:11", "intrinsics", "0.05"],
    ),
    "distortion that folds": (
        edit(layout.CAMERA_SENSOR, "[0.0, 0.0, 0.0, 0.0]\n", "[-1.5, 0.0, 0.0, 0.0]\n"),
        [f"{layout.CAMERA_SENSOR}:13", "distortion_coefficients", "folds inside the image"],
    ),
    "distortion of another model": (
        edit(layout.CAMERA_SENSOR, "radial-tangential", "double-sphere"),
        [f"{layout.CAMERA_SENSOR}:12", "distortion_model", "radial-tangential", "double-sphere"],
    ),
    "distortion of no model": (
        lambda folder: (
            edit(layout.CAMERA_SENSOR, "distortion_model: radial-tangential\n", "")(folder),
            edit(layout.CAMERA_SENSOR, "[0.0, 0.0, 0.0, 0.0]\n", "[-0.1, 0.0, 0.0, 0.0]\n")(folder),
        ),
        [f"{layout.CAMERA_SENSOR}:", "distortion_model", "found none"],
    ),
    "rational distortion": (
        edit(layout.CAMERA_SENSOR, "[0.0, 0.0, 0.0, 0.0]\n", "[0.1, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0]\n"),
        [f"{layout.CAMERA_SENSOR}:13", "distortion_coefficients", "4 or 5", "found 8"],
    ),
    "fisheye of five coefficients": (
        lambda folder: (
            edit(layout.CAMERA_SENSOR, "radial-tangential", "equidistant")(folder),
            edit(layout.CAMERA_SENSOR, "[0.0, 0.0, 0.0, 0.0]\n", "[0.1, 0.0, 0.0, 0.0, 0.0]\n")(folder),
        ),
        [f"{layout.CAMERA_SENSOR}:13", "distortion_coefficients", "expected 4", "fisheye", "found 5"],
    ),
    "blur of a hundred pixels": (
        edit(layout.CAMERA_SENSOR, "psf_sigma_px: 0.7", "psf_sigma_px: 100.0"),
        [f"{layout.CAMERA_SENSOR}:14", "psf_sigma_px", "less than or equal to 10"],
    ),
    "images of fewer bits than said": (
        edit(layout.CAMERA_SENSOR, "bit_depth: 8", "bit_depth: 12"),
        [f"{START_NS}.png", "16-bit grey", "8-bit grey"],
    ),
    "fisheye": (
        edit(layout.CAMERA_SENSOR, "pinhole", "omni"),
        [f"{layout.CAMERA_SENSOR}:", "camera_model", "'pinhole'", "omni"],
    ),
    "mounting no rotation": (
        edit(layout.IMU_SENSOR, "[1.0, 0.0,", "[2.0, 0.0,"),
        [f"{layout.IMU_SENSOR}:3", "T_BS", "rotation"],
    ),
    "IMU off the origin": (
        edit(layout.IMU_SENSOR, "[1.0, 0.0, 0.0, 0.0,", "[1.0, 0.0, 0.0, 0.5,"),
        [f"{layout.IMU_SENSOR}:3", "T_BS", "identity"],
    ),
    "noise in another unit": (
        edit(layout.IMU_SENSOR, "gyroscope_random_walk: 1.0e-09", "gyroscope_random_walk: 100.0"),
        [f"{layout.IMU_SENSOR}:", "gyroscope_random_walk", "less than or equal to 10"],
    ),
    "noise of zero": (
        edit(layout.IMU_SENSOR, "gyroscope_random_walk: 1.0e-09", "gyroscope_random_walk: 0.0"),
        [f"{layout.IMU_SENSOR}:", "gyroscope_random_walk", "greater than 0"],
    ),
    "no YAML": (edit(layout.IMU_SENSOR, "rate_hz", "  - ["), [layout.IMU_SENSOR, "YAML"]),
    "empty catalogue": (drop_lines(layout.CRATERS, 2, 3), [layout.CRATERS, "at least one crater"]),
    "negative axis": (
        cell(layout.CRATERS, 2, 3, "-2.0"),
        [f"{layout.CRATERS}:2", "DIAM_ELLI_MAJOR_IMG", "-2"],
    ),
    "swapped axes": (swap_axes, [f"{layout.CRATERS}:2", "DIAM_ELLI_MINOR_IMG", "2.469", "major"]),
    "crater twice": (
        cell(layout.CRATERS, 2, 0, '"B, the second"'),
        [f"{layout.CRATERS}:3", "CRATER_ID", "B, the"],
    ),
    "latitude out of range": (
        cell(layout.CRATERS, 2, 1, "91"),
        [f"{layout.CRATERS}:2", "LAT_ELLI_IMG", "-90 to 90", "91"],
    ),
    "sun not unit": (cell(layout.SUN, 3, 1, "0.5"), [f"{layout.SUN}:3", "s_x", "unit vector"]),
    "sun for a part only": (
        cell(layout.SUN, 3, 0, str(SECOND)),
        [layout.SUN, "over the frames", str(SECOND)],
    ),
    "truth's quaternion": (cell(layout.TRUTH, 3, 4, "2.0"), [f"{layout.TRUTH}:3", "q_RS_w", "unit"]),
    "truth for a part only": (drop_lines(layout.TRUTH, 4, 4), [layout.TRUTH, "over the frames"]),
    "no TOML": (edit(TOML, "[body]", "[body"), [TOML, "TOML", "line 3"]),
    "unknown key": (edit(TOML, "mu_m3_s2", "mu_km3_s2"), [f"{TOML}:6", "body.mu_km3_s2", "unknown key"]),
    "unknown table": (edit(TOML, "[initial]", "[extra]\n[initial]"), [f"{TOML}:9", "extra", "unknown key"]),
    "key missing": (
        edit(TOML, "position_sigma_m", "# "),
        [f"{TOML}:", "initial.position_sigma_m", "missing"],
    ),
    "number with underscores": (cell(IMU, 7, 2, "1_0"), [f"{IMU}:7", "w_RS_S_y", "1_0"]),
    "wrong type": (
        edit(TOML, "radius_m = 1737400.0", 'radius_m = "1737400"'),
        [f"{TOML}:5", "body.radius_m", "valid number", '"1737400"'],
    ),
    "boolean for a number": (
        edit(TOML, "position_sigma_m = 4000.0", "position_sigma_m = true"),
        [f"{TOML}:", "initial.position_sigma_m", "true"],
    ),
    "two numbers for three": (
        edit(TOML, "spin_rad_s = [1e-07, ", "spin_rad_s = ["),
        [f"{TOML}:7", "body.spin_rad_s", "missing"],
    ),
    "nan in TOML": (edit(TOML, "4000.0", "nan"), [f"{TOML}:", "initial.position_sigma_m", "finite"]),
    "negative sigma": (edit(TOML, "4000.0", "-1.0"), [f"{TOML}:", "position_sigma_m", "greater than 0"]),
    "future format": (
        lambda folder: folder.edit(TOML, "format_version = 1", "format_version = 2\nnew_key = 1"),
        [f"{TOML}:1: format_version", "expected 1", "found 2", "later"],
    ),
    "initial state not at the first frame": (
        edit(TOML, str(START_NS), str(SECOND)),
        [TOML, "initial.stamp_ns", str(START_NS), str(SECOND)],
    ),
    "attitude not unit": (
        edit(TOML, "attitude_wxyz = [", "attitude_wxyz = [1"),
        [f"{TOML}:12", "initial.attitude_wxyz", "unit quaternion"],
    ),
    "gravity in cubic kilometres": (
        edit(TOML, "mu_m3_s2 = 4902800118000.0", "mu_m3_s2 = 4902.800118"),
        [f"{TOML}:6: body.mu_m3_s2", "100 to 30000 kg/m^3", "found 3.34e-06", "km^3/s^2"],
    ),
    "gravity of another body": (
        edit(TOML, "mu_m3_s2 = 4902800118000.0", "mu_m3_s2 = 3.986e14"),
        [f"{TOML}:6: body.mu_m3_s2", "found 2.72e+05", "of another body?"],
    ),
    "position in kilometres": (
        edit(TOML, "position_m = [1750000.0", "position_m = [1750.0"),
        [f"{TOML}:11", "initial.position_m", "metres"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_named(case, folder):
    spoil, expected = CASES[case]
    Dataset.open(folder.path)
    spoil(folder)
    with pytest.raises(InputError) as caught:
        Dataset.open(folder.path)
    text = str(caught.value)
    assert text.startswith(str(folder.path))
    assert "\n" not in text
    for part in expected:
        assert part in text


def test_a_damaged_image_is_found_when_it_is_read(folder):
    path = folder.path / layout.IMAGES / f"{SECOND}.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    opened = Dataset.open(folder.path)
    opened.image(0)
    with pytest.raises(InputError, match=rf"{SECOND}\.png: image is damaged: a checksum"):
        opened.image(1)


def test_an_image_cut_in_the_middle_is_found_when_it_is_read(folder):
    path = folder.path / layout.IMAGES / f"{SECOND}.png"
    data = path.read_bytes()
    opened = Dataset.open(folder.path)
    path.write_bytes(data[: len(data) // 2] + data[-12:])
    with pytest.raises(InputError, match=rf"{SECOND}\.png: image is"):
        opened.image(1)


def test_images_are_not_needed_beside_rims(rims_folder):
    assert not (rims_folder.path / layout.IMAGES).exists()
    assert Dataset.open(rims_folder.path).measurements is not None


def spoiled(change, name=layout.RIMS):
    def spoil(folder):
        table = pq.read_table(folder.path / name).to_pylist()
        schema = pq.read_schema(folder.path / name)
        change(table)
        pq.write_table(pa.Table.from_pylist(table, schema), folder.path / name)

    return spoil


def set_cell(row, column, value, name=layout.RIMS):
    return spoiled(lambda rows: rows[row].__setitem__(column, value), name)


def set_arc(row, column, value):
    return set_cell(row, column, value, layout.ARCS)


def changed(change, name=layout.RIMS):
    return lambda folder: pq.write_table(change(pq.read_table(folder.path / name)), folder.path / name)


def floats(table, name):
    return table.set_column(table.column_names.index(name), name, table[name].cast(pa.float32()))


LISTS = pa.list_(pa.float64())


def of_type(table, name, values, kind):
    return table.set_column(table.column_names.index(name), name, pa.array(values, kind))


def with_a_name_that_is_no_text(folder):
    """Spoil the last place that names a column: the metadata of its chunk."""
    path = folder.path / layout.RIMS
    before, name, after = path.read_bytes().rpartition(b"crater_id")
    path.write_bytes(before + b"\xff" + name[1:] + after)


RIM_CASES = {
    "name of bytes": (with_a_name_that_is_no_text, [layout.RIMS, "is damaged"]),
    "no Parquet": (lambda f: (f.path / layout.RIMS).write_text("x"), [layout.RIMS, "Parquet"]),
    "unknown crater": (set_cell(1, "crater_id", "C"), [layout.RIMS, "crater_id", "row 2", "'C'"]),
    "unknown stamp": (set_cell(1, "timestamp", 5), [layout.RIMS, "timestamp", "5"]),
    "empty cell": (set_cell(1, "crater_id", None), [layout.RIMS, "crater_id", "empty"]),
    "nan": (set_cell(1, "chart", [0.0, 0.0, np.nan, 0.0, 0.0]), [layout.RIMS, "chart", "row 2"]),
    "no number": (set_cell(1, "chart", [0.0, 0.0, None, 0.0, 0.0]), [layout.RIMS, "chart", "row 2"]),
    "no ellipse": (set_cell(1, "chart", [0.0, 0.0, 1e30, 0.0, 0.0]), [layout.RIMS, "row 2", "an ellipse"]),
    "centre in pixels": (
        spoiled(lambda rows: rows[1].update(chart=[40.0, 20.0, *rows[1]["chart"][2:]])),
        [layout.RIMS, "chart", "row 2", "-0.443 to 0.454 by -0.354 to 0.321", "at 40, 20, in pixels?"],
    ),
    "rim outside the image": (
        set_cell(1, "chart", [0.1, 0.5, -3.0, 0.0, -3.0]),
        [layout.RIMS, "chart", "row 2", "found a rim at 0.1, 0.5"],
    ),
    "no size": (set_cell(1, "chart", [0.0, 0.0, 1e308, 0.0, 0.0]), [layout.RIMS, "row 2", "finite"]),
    "covariance": (
        set_cell(1, "covariance", [0.0] * 25),
        [layout.RIMS, "covariance", "row 2", "positive"],
    ),
    "rim twice": (spoiled(lambda rows: rows.append(rows[0])), [layout.RIMS, "row 1 again"]),
    "missing column": (changed(lambda t: t.drop_columns(["chart"])), [layout.RIMS, "chart", "missing"]),
    "unknown column": (
        changed(lambda t: t.append_column("colour", pa.nulls(len(t)))),
        [layout.RIMS, "colour", "unknown"],
    ),
    "lists of another length": (
        changed(lambda t: of_type(t, "chart", [*t["chart"].to_pylist()[:2], [0.0] * 4], LISTS)),
        [layout.RIMS, "chart", "row 3", "expected 5 values, found 4"],
    ),
    "lists of texts": (
        changed(lambda t: of_type(t, "chart", [["0"] * 5] * len(t), pa.list_(pa.string()))),
        [layout.RIMS, "chart", "fixed_size_list", "found list<"],
    ),
    "arcs of half points": (
        changed(lambda t: of_type(t, "points_normalised", [[[0.0]]] * len(t), pa.list_(LISTS)), layout.ARCS),
        [layout.ARCS, "points_normalised", "other lengths"],
    ),
    "single precision": (changed(lambda t: floats(t, "rms_px")), [layout.RIMS, "rms_px", "double", "float"]),
    "part too large": (set_cell(1, "correlated", [1.0] * 25), [layout.RIMS, "row 2", "less than"]),
    "part not finite": (set_cell(1, "shared", [np.inf] * 40), [layout.RIMS, "shared", "row 2", "finite"]),
    "part of some rims": (
        set_cell(1, "shared", None),
        [layout.RIMS, "shared", "row 2 has none"],
    ),
    "white part of estimators": (
        set_cell(2, "fused_white", [-1.0] * 25),
        [layout.RIMS, "fused_white", "row 3", "positive"],
    ),
    "white part of estimators too small": (
        spoiled(lambda rows: rows[2].update(fused_white=[0.4 * value for value in rows[2]["fused_white"]])),
        [layout.RIMS, "fused_white", "row 3", "at least the white part"],
    ),
    "quality of some rims": (set_cell(1, "rms_px", None), [layout.RIMS, "rms_px", "row 2 has none"]),
    "quality in part": (
        spoiled(lambda rows: [row.__setitem__("rms_px", None) for row in rows]),
        [layout.RIMS, "rms_px", "same rows as in slope_contrast"],
    ),
    "quality without a column": (
        changed(lambda t: t.drop_columns(["arc_share"])),
        [layout.RIMS, "arc_share", "missing beside slope_contrast"],
    ),
    "negative quality": (set_cell(2, "arc_share", -0.1), [layout.RIMS, "arc_share", "row 3", "-0.1"]),
    "arcs no Parquet": (lambda f: (f.path / layout.ARCS).write_text("x"), [layout.ARCS, "Parquet"]),
    "arc of a crater with a rim": (set_arc(1, "crater_id", "A-1"), [layout.ARCS, "crater_id", "'A-1'"]),
    "arc of an unknown crater": (set_arc(0, "crater_id", "C"), [layout.ARCS, "crater_id", "row 1", "'C'"]),
    "arc of an unknown stamp": (set_arc(0, "timestamp", 5), [layout.ARCS, "timestamp", "5"]),
    "arc twice": (spoiled(lambda rows: rows.append(rows[0]), layout.ARCS), [layout.ARCS, "once"]),
    "arc without points": (
        spoiled(lambda rows: rows[0].update(points_normalised=[], sigmas_normalised=[]), layout.ARCS),
        [layout.ARCS, "sigmas_normalised", "row 1", "0 points"],
    ),
    "arc with few sigmas": (
        set_arc(0, "sigmas_normalised", [1e-3]),
        [layout.ARCS, "sigmas_normalised", "row 1", "found 1 for 3"],
    ),
    "arc with sigma zero": (
        set_arc(0, "sigmas_normalised", [1e-3, 0.0, 1.0]),
        [layout.ARCS, "sigmas_normalised", "row 1", "more"],
    ),
    "arc not finite": (
        set_arc(0, "points_normalised", [[0.0, np.nan]] * 3),
        [layout.ARCS, "points_normalised", "row 1", "finite"],
    ),
    "arc in pixels": (
        set_arc(0, "points_normalised", [[40.0, 20.0], [41.0, 21.0], [43.0, 20.0]]),
        [layout.ARCS, "points_normalised", "row 1", "at 41.5, 20.5, in pixels?"],
    ),
    "arc of half points": (
        set_arc(0, "points_normalised", [[0.0, 1.0], None, None]),
        [layout.ARCS, "points_normalised", "row 1"],
    ),
    "negative correlated sigma": (
        set_arc(1, "correlated_sigma_normalised", -1.0),
        [layout.ARCS, "correlated_sigma_normalised", "row 2", "-1"],
    ),
    "tilt's sigma": (cell(layout.TILTS, 2, 2, "0.0"), [f"{layout.TILTS}:2", "sigma_rad", "0.0"]),
    "tilt's stamp": (cell(layout.TILTS, 2, 0, "7"), [f"{layout.TILTS}:2", "timestamp", "7"]),
    "tilt without direction": (
        lambda f: f.edit_line(layout.TILTS, 2, lambda cells: [",".join([*cells[:5], "0", "0", "0"])]),
        [f"{layout.TILTS}:2", "direction_x", "zero"],
    ),
    "tilt with half a direction": (
        edit(layout.TILTS, ",direction_z", ",comment"),
        [layout.TILTS, "comment"],
    ),
}


@pytest.mark.parametrize("case", RIM_CASES)
def test_bad_rims_are_named(case, rims_folder):
    spoil, expected = RIM_CASES[case]
    Dataset.open(rims_folder.path)
    spoil(rims_folder)
    with pytest.raises(InputError) as caught:
        Dataset.open(rims_folder.path)
    text = str(caught.value)
    assert text.startswith(str(rims_folder.path))
    assert "\n" not in text
    for part in expected:
        assert part in text


def test_names_of_images_that_are_not_read_may_be_alike(rims_folder):
    for line in (2, 3, 4):
        cell(CAM, line, 1, "none.png")(rims_folder)
    assert Dataset.open(rims_folder.path).measurements is not None


def test_a_rim_may_lie_outside_the_image_in_part(rims_folder):
    # By its end only: the centre is far beyond the right border.
    set_cell(1, "chart", [1.4, 0.0, 0.0, 0.0, -1.0])(rims_folder)
    Dataset.open(rims_folder.path)


@pytest.mark.parametrize("value", [1e59, -1e59])
def test_covariances_that_rounding_has_left_indefinite_are_refused(rims_folder, value):
    covariance = np.diag([1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    covariance[0, 1] = covariance[1, 0] = value
    set_cell(0, "covariance", covariance.ravel().tolist())(rims_folder)
    with pytest.raises(InputError, match="positive definite"):
        Dataset.open(rims_folder.path)
    # Singular but for rounding.
    covariance[0, 1] = covariance[1, 0] = 1e-6 * (1.0 - 1e-14)
    set_cell(0, "covariance", covariance.ravel().tolist())(rims_folder)
    with pytest.raises(InputError, match="positive definite"):
        Dataset.open(rims_folder.path)


def covariance_with(cross, mirrored):
    covariance = np.diag([1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    covariance[0, 1], covariance[1, 0] = cross, mirrored
    return set_cell(0, "covariance", covariance.ravel().tolist())


def test_covariances_may_differ_from_symmetric_ones_by_rounding(rims_folder):
    covariance_with(3e-21, -2e-21)(rims_folder)
    assert Dataset.open(rims_folder.path).measurements is not None
    covariance_with(3e-7, 2e-7)(rims_folder)
    with pytest.raises(InputError, match="symmetric"):
        Dataset.open(rims_folder.path)


def test_a_data_set_that_is_none():
    with pytest.raises(InputError, match=r"nowhere: folder is missing"):
        Dataset.open("nowhere")
