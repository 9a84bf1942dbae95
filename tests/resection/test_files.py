"""Matched rims are read from files, and what is wrong with these is named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.ellipse import chart_of_axes, normalised_chart
from craternav_fg.errors import InputError
from craternav_fg.resection.files import read_rims
from tests.resection.matched_files import CAMERA, HEADER, MOON, Files, make_files


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return make_files(tmp_path)


def test_sigma_scales_the_covariance(files: Files) -> None:
    with_sigma = files.rims(*(f"{row},0.2" for row in files.rows), header=f"{HEADER},sigma_px")
    rims, *_ = read_rims(with_sigma, CAMERA, files.folder / "craters.csv", MOON, sigma_px=0.1, edge_points=60)
    plain, *_ = read_rims(
        files.rims(), CAMERA, files.folder / "craters.csv", MOON, sigma_px=0.1, edge_points=60
    )
    np.testing.assert_allclose(rims.covariance, 4.0 * plain.covariance, rtol=1e-3, atol=1e-15)


def test_a_covariance_of_the_ellipse_is_that_of_its_chart(files: Files) -> None:
    """Errors drawn from the covariance scatter the charts as it says; 15 numbers, the rotation in degrees."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 5)) * np.array([[0.3], [0.2], [0.5], [0.4], [0.9]])
    covariance = root @ root.T
    words = " ".join(f"{value:.12g}" for value in covariance[np.triu_indices(5)])
    rims, _ = files.read(files.rims(*(f"{row},{words}" for row in files.rows), header=f"{HEADER},covariance"))
    drawn = rng.multivariate_normal(np.zeros(5), covariance, 40_000) * [1.0, 1.0, 1.0, 1.0, np.pi / 180.0]
    ellipse = np.array([float(word) for word in files.rows[0].split(",")[:5]]) * [1, 1, 1, 1, np.pi / 180.0]
    charts, _ = normalised_chart(chart_of_axes(ellipse + drawn), CAMERA)
    sigmas = charts.std(axis=0)
    scale = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(rims.covariance[0] / scale, np.cov(charts.T) / scale, atol=0.03)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("1 2 3", "expected 15 numbers"),
        (" ".join(["x"] * 15), "expected 15 numbers"),
        (" ".join(["1"] * 15), "expected a positive definite matrix"),
        (" ".join(["nan"] * 15), "expected a positive definite matrix"),
        (" ".join(["1e308"] * 15), "expected a positive definite matrix"),
    ],
)
def test_a_wrong_covariance_is_named(files: Files, words: str, says: str) -> None:
    rims = files.rims(*(f"{row},{words}" for row in files.rows), header=f"{HEADER},covariance")
    with pytest.raises(InputError, match=rf"rims\.csv:2: covariance: {says}"):
        files.read(rims)


def cell(row: str, column: int, value: str) -> str:
    cells = row.split(",")
    cells[column] = value
    return ",".join(cells)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda r: [r[0], cell(r[1], 5, "01-a")], r"rims\.csv:3: CRATER_ID: .*'01-a' again, first in line 2"),
        (
            lambda r: [cell(r[0], 5, "99-z")],
            r"rims\.csv:2: CRATER_ID: expected a crater of .*s\.csv, found",
        ),
        (lambda r: [r[0], cell(r[1], 0, "5000")], r"rims\.csv:3: ellipseCenterX\(px\): .*1024 x 768 image"),
        (lambda r: [cell(r[0], 1, "-400")], r"rims\.csv:2: ellipseCenterY\(px\): .*found its centre at -400"),
        (lambda r: [cell(r[0], 3, "0")], r"rims\.csv:2: ellipseSemiminor\(px\): expected 0\.1 to 10240 px"),
        (lambda r: [cell(r[0], 3, "1e-200")], r"rims\.csv:2: ellipseSemiminor\(px\): .* found 1e-200"),
        (lambda r: [r[1], cell(r[0], 2, "1e200")], r"rims\.csv:3: ellipseSemimajor\(px\): .* found 1e\+200"),
        (lambda r: [cell(r[0], 0, "1e50")], r"rims\.csv:2: ellipseCenterX\(px\): .*1024 x 768 image"),
        (
            lambda r: [cell(r[0], 3, "900")],
            r"rims\.csv:2: ellipseSemiminor\(px\): expected at most the",
        ),
        (lambda r: [cell(r[0], 4, "nan")], r"rims\.csv:2: ellipseRotation\(deg\): expected a finite number"),
        (lambda r: [cell(r[0], 2, "big")], r"rims\.csv:2: ellipseSemimajor\(px\): expected a number"),
    ],
)
def test_a_bad_cell_is_named(files: Files, spoil: Callable[[list[str]], list[str]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        files.read(files.rims(*spoil(files.rows)))


@pytest.mark.parametrize("sigma", ["0", "1e-200", "1e50", "-1"])
def test_a_standard_deviation_out_of_range_is_named(files: Files, sigma: str) -> None:
    rims = files.rims(f"{files.rows[0]},1.0", f"{files.rows[1]},{sigma}", header=f"{HEADER},sigma_px")
    with pytest.raises(InputError, match=r"rims\.csv:3: sigma_px: expected 1e-06 to 1000 px, found"):
        files.read(rims)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(",", ", "),
        lambda text: "\n  \n" + text,
        lambda text: text.replace("\n", "\n   \n\n"),
        lambda text: "".join(f"{line},{'note' if k == 0 else 'x'}\n" for k, line in enumerate(text.split())),
        lambda text: text.replace("\n", ",\n"),
    ],
    ids=["spaces", "blank first", "blank between", "another column", "closing comma"],
)
def test_how_a_table_is_laid_out_does_not_matter(files: Files, change: Callable[[str], str]) -> None:
    path = files.rims()
    plain, _ = files.read(path)
    text = path.read_text()
    path.write_text(change(text))
    rims, _ = files.read(path)
    assert rims.identifiers == plain.identifiers
    np.testing.assert_array_equal(rims.chart, plain.chart)
    path.write_text(change(text.replace("01-d", "99-z")))
    line = next(k for k, row in enumerate(path.read_text().split("\n"), 1) if "99-z" in row)
    with pytest.raises(InputError, match=rf"rims\.csv:{line}: CRATER_ID: .*found '99-z'"):
        files.read(path)


@pytest.mark.parametrize(("sign", "name"), [(";", "semicolons"), ("\t", "tabs")])
def test_another_separator_is_named(files: Files, sign: str, name: str) -> None:
    path = files.rims()
    path.write_text(path.read_text().replace(",", sign))
    with pytest.raises(InputError, match=rf"rims\.csv:1: expected columns separated by commas, found {name}"):
        files.read(path)


def test_a_column_almost_of_the_standard_deviation_is_not_passed_over(files: Files) -> None:
    rims = files.rims(*(f"{row},1.0" for row in files.rows), header=f"{HEADER},sigma")
    with pytest.raises(InputError, match=r"rims\.csv:1: sigma: expected only the columns"):
        files.read(rims)


def test_a_file_without_rims(files: Files) -> None:
    path = files.folder / "rims.csv"
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match=r"rims\.csv: expected at least one rim, found none"):
        files.read(path)
    path.write_text("ellipseCenterX(px)\n")
    with pytest.raises(InputError, match=r"rims\.csv:1: ellipseCenterY\(px\): .* missing"):
        files.read(path)
