"""Tables of ellipses: what one command writes, another one reads."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.camera import Camera
from craternav_fg.dataset import ellipses as tables
from craternav_fg.errors import InputError

CAMERA = Camera(200, 100, 150.0, 150.0, 99.5, 49.5)
ELLIPSES = np.array(
    [[20.0, 30.0, 12.5, 8.25, 0.5], [150.0, 60.0, 30.0, 29.0, -1.25], [2.0, 99.0, 6.0, 5.0, 0.0]]
)


def test_detected_ellipses_are_read_again(tmp_path: Path) -> None:
    path = tmp_path / "new" / "rims.csv"
    tables.write_detected_ellipses(path, ELLIPSES, np.ones(3, dtype=bool), "image, 1.png")
    assert_allclose(tables.read_detected_ellipses(path, CAMERA)[0], ELLIPSES, atol=1e-3)
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["inputImage"] for row in rows} == {"image, 1.png"}
    assert {row["crater_classification"] for row in rows} == {"-1"}


def test_whether_detected_ellipses_were_traced_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "rims.csv"
    tables.write_detected_ellipses(path, ELLIPSES, np.array([True, False, True]), "image.png")
    found, traced = tables.read_detected_ellipses(path, CAMERA)
    assert_allclose(found, ELLIPSES, atol=1e-3)
    assert traced.tolist() == [True, False, True]
    # NASA's own tables have no such column.
    path.write_text(",".join(tables.ELLIPSE) + "\n20,30,12,8,28\n")
    assert tables.read_detected_ellipses(path, CAMERA)[1].tolist() == [True]


def test_matched_ellipses_are_read_again_with_their_craters(tmp_path: Path) -> None:
    path = tmp_path / "matched.csv"
    tables.write_matched_ellipses(path, ELLIPSES, ["A", None, "C, the third"])
    found = tables.read_matched_ellipses(path, CAMERA)
    assert found.craters == ("A", "C, the third")
    assert found.sigmas_px is None
    assert_allclose(found.ellipses_px, ELLIPSES[[0, 2]], atol=1e-4)


def test_rims_that_an_oblique_view_aligns_are_not_in_radians(tmp_path: Path) -> None:
    """An image of the horizon's direction along x: all major axes are within 3 deg of it."""
    aligned = np.array([[20.0 * k, 50.0, 12.0, 6.0, np.radians(k - 3.5)] for k in range(1, 7)])
    tables.write_matched_ellipses(tmp_path / "oblique.csv", aligned, list("ABCDEF"))
    assert_allclose(tables.read_detected_ellipses(tmp_path / "oblique.csv", CAMERA)[0], aligned, atol=1e-4)
    aligned[:, 3] = 10.0
    tables.write_matched_ellipses(tmp_path / "nadir.csv", aligned, list("ABCDEF"))
    with pytest.raises(InputError, match="they are in radians"):
        tables.read_detected_ellipses(tmp_path / "nadir.csv", CAMERA)[0]


def test_tables_without_ellipses_are_read_but_not_without_matches(tmp_path: Path) -> None:
    tables.write_detected_ellipses(
        tmp_path / "none.csv", np.empty((0, 5)), np.empty(0, dtype=bool), "dark.png"
    )
    assert tables.read_detected_ellipses(tmp_path / "none.csv", CAMERA)[0].shape == (0, 5)
    tables.write_matched_ellipses(tmp_path / "unmatched.csv", ELLIPSES, [None] * 3)
    with pytest.raises(InputError, match=r"unmatched\.csv: expected at least one rim"):
        tables.read_matched_ellipses(tmp_path / "unmatched.csv", CAMERA)


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        (
            tables.CENTRE_X,
            "-13",
            r":3: ellipseCenterX\(px\): expected .* that reaches into the 200 x 100 image",
        ),
        (tables.CENTRE_Y, "112", r":3: ellipseCenterY\(px\): .* found its centre at 112"),
        (tables.MAJOR, "2001", r":3: ellipseSemimajor\(px\): expected 0.1 to 2000 px, found 2001"),
        (tables.MINOR, "12.6", r":3: ellipseSemiminor\(px\): expected at most the semi-major axis 12.5"),
        (tables.SIGMA, "0", r":3: sigma_px: expected 1e-06 to 1000 px, found 0"),
        ("CRATER_ID", "A", r":3: CRATER_ID: .* found 'A' again, first in line 2"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, column: str, value: str, problem: str) -> None:
    row = dict(zip(tables.ELLIPSE, ["20", "30", "12.5", "8.25", "28"], strict=True))
    good = {**row, "CRATER_ID": "A", tables.SIGMA: "0.5"}
    path = tmp_path / "rims.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(good))
        writer.writeheader()
        writer.writerow(good)
        writer.writerow({**good, "CRATER_ID": "B", column: value})
    with pytest.raises(InputError, match=problem):
        tables.read_matched_ellipses(path, CAMERA)


def test_sigmas_of_edge_points_are_read(tmp_path: Path) -> None:
    path = tmp_path / "rims.csv"
    path.write_text(",".join((*tables.ELLIPSE, "CRATER_ID", "sigma_px")) + "\n20,30,12,8,28,A,0.25\n")
    assert tables.read_matched_ellipses(path, CAMERA).sigmas_px == pytest.approx([0.25])


def test_plain_data_of_detections_is_json() -> None:
    covariance = np.tile(np.diag([0.01, 0.03, 1e-4, 1e-4, 1e-4]), (3, 1, 1))
    traced = np.array([True, False, True])
    quality = np.array([0.9, 0.8, 0.7])
    plain = tables.detections_as_plain_data(ELLIPSES, covariance, quality, traced, np.nan)
    read = json.loads(json.dumps(plain, allow_nan=False))
    assert read["sun_angle_deg"] is None
    assert read["rims"][0] == {
        "center_x_px": 20.0, "center_y_px": 30.0, "semi_major_px": 12.5, "semi_minor_px": 8.25,
        "rotation_deg": 28.648, "quality": 0.9, "traced": True, "center_sigma_px": 0.141,
    }  # fmt: skip
    assert not read["rims"][1]["traced"]
    none = tables.detections_as_plain_data(ELLIPSES[:0], covariance[:0], np.empty(0), traced[:0], np.pi)
    assert none["sun_angle_deg"] == 180.0
