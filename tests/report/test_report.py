"""The page of a run: what is in it, with whatever the run lacks."""

import base64
import html
import html.parser
import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from craternav_fg.errors import InputError
from craternav_fg.evaluation.consistency import mean_interval
from craternav_fg.reports.page import write_page
from craternav_fg.reports.residuals import crater_table
from craternav_fg.reports.run_page import run_page
from craternav_fg.reports.svg import identifier, inline_svg
from craternav_fg.runs.read import read_run
from tests.cli.calls import call


class Reader(html.parser.HTMLParser):
    """Collects identifiers, references and the text of table cells."""

    def __init__(self) -> None:
        super().__init__()
        self.identifiers: list[str] = []
        self.references: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.warnings: list[str] = []
        self._into: list[str] | None = None

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.identifiers += [str(values["id"])] if "id" in values else []
        self.references += [str(values[k]) for k in ("href", "src", "xlink:href") if values.get(k)]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._into = self.tables[-1][-1]
            self._into.append("")
        elif values.get("class") == "warning":
            self._into = self.warnings
            self._into.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th", "p"):
            self._into = None

    def handle_data(self, data: str) -> None:
        if self._into is not None:
            self._into[-1] += data.strip()


def read(run: Path, out: Path) -> Reader:
    write_page(run_page(read_run(run)), out)
    reader = Reader()
    reader.feed(out.read_text("utf-8"))
    return reader


@pytest.fixture(scope="module")
def page_file(made_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page") / "r.html"
    write_page(run_page(read_run(made_run)), out)
    return out


@pytest.fixture(scope="module")
def page(page_file: Path) -> Reader:
    reader = Reader()
    reader.feed(page_file.read_text("utf-8"))
    return reader


@pytest.fixture
def run(made_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made_run, tmp_path / "run"))


def test_the_page_needs_no_other_file_and_no_network(page: Reader, page_file: Path) -> None:
    assert all(r.startswith(("#", "data:")) for r in page.references), page.references
    text = page_file.read_text("utf-8")
    assert not re.search(r"@import|url\((?!#)|<link|<script[^>]+src", text)


def data_of(page_file: Path) -> dict[str, Any]:
    found = re.search(
        r'<script type="application/json" id="data">(.*?)</script>', page_file.read_text("utf-8")
    )
    assert found is not None
    return json.loads(found.group(1))


def test_the_charts_hold_the_errors_of_every_estimator(page_file: Path, made_run: Path) -> None:
    data = data_of(page_file)
    run = read_run(made_run)
    assert run.truth is not None
    np.testing.assert_allclose(
        data["times"], 1e-9 * (run.truth.stamps_ns - run.truth.stamps_ns[0]), atol=1e-3
    )
    traces = data["charts"]["errors"]["data"]
    position = {trace["name"]: trace["y"] for trace in traces if trace["yaxis"] == "y"}
    assert list(position) == list(run.trajectories)
    for name, values in position.items():
        rms = run.metrics["estimators"][name]["position_rms_m"]
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(rms, rel=1e-5)


def test_three_sigma_are_those_of_the_covariance(page_file: Path, made_run: Path) -> None:
    """The height's: the up axis is the radial one, all along the descent."""
    traces = data_of(page_file)["charts"][f"bounds-{identifier('ekf')}"]["data"]
    up = next(trace for trace in traces if trace["yaxis"] == "y3")
    run = read_run(made_run)
    assert run.truth is not None
    covariance = run.trajectories["ekf"].pose_covariance
    assert covariance is not None
    radial = run.truth.gP / np.linalg.norm(run.truth.gP, axis=1, keepdims=True)
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", radial, covariance[:, 3:, 3:], radial))
    np.testing.assert_allclose(up["y"], 3.0 * sigma, rtol=1e-5)


def test_markers_follow_the_first_estimate(page_file: Path, made_run: Path) -> None:
    charts = data_of(page_file)["charts"]
    first = read_run(made_run).trajectories["smoother"]
    (place,) = charts["scene"]["follow"]
    steps_m = 1e3 * np.linalg.norm(np.diff([place["x"], place["y"], place["z"]], axis=1), axis=0)
    np.testing.assert_allclose(
        steps_m, np.linalg.norm(np.diff(first.gP, axis=0), axis=1), rtol=1e-2, atol=2.0
    )
    assert charts["scene"]["data"][place["trace"]]["name"] == "cursor"


def test_a_page_is_small(page_file: Path) -> None:
    assert page_file.stat().st_size < 3_000_000


def test_identifiers_are_unique_and_every_link_within_the_page_has_its_target(page: Reader) -> None:
    assert len(set(page.identifiers)) == len(page.identifiers)
    assert {r[1:] for r in page.references if r.startswith("#")} <= set(page.identifiers)


def test_the_summary_holds_the_metrics_of_every_estimator(page: Reader, made_run: Path) -> None:
    summary = page.tables[0]
    estimators = read_run(made_run).metrics["estimators"]
    assert [row[0] for row in summary[1:]] == list(estimators)
    for row in summary[1:]:
        assert float(row[1].replace(",", "")) == pytest.approx(estimators[row[0]]["position_rms_m"], rel=6e-3)


def test_innovations_of_a_consistent_run_are_of_no_concern(page: Reader, made_run: Path) -> None:
    """The rims of this run have the noise that they claim, and no truth is needed to see it."""
    table = next(rows for rows in page.tables if "NIS per dimension" in rows[0])
    found = read_run(made_run).metrics["innovations"]["nis"]
    assert [row[0] for row in table[1:]] == list(found) == ["imu", "rims", "sun"]
    low, high = mean_interval(1, found["rims"]["dimension"], 0.9999)
    assert low < found["rims"]["mean"] < high
    assert float(table[2][1]) == pytest.approx(found["rims"]["mean"], rel=5e-3)


def test_the_residual_table_has_every_crater_with_its_mean(page: Reader, made_run: Path) -> None:
    rows = {row[0]: row for row in page.tables[2][1:]}
    table = pq.read_table(made_run / "residuals.parquet").to_pylist()
    own = [r for r in table if r["estimator"] == "smoother"]
    assert set(rows) == {r["crater_id"] for r in own}
    crater = own[0]["crater_id"]
    chi2 = [r["chi2"] for r in own if r["crater_id"] == crater]
    assert int(rows[crater][1]) == len(chi2)
    assert float(rows[crater][3]) == pytest.approx(np.mean(chi2) / 5, rel=6e-3)


def test_rejected_matches_do_not_count_against_a_crater() -> None:
    rims = [("A", 5.0, 1.0), ("A", 7.0, None), ("A", 900.0, 0.0), ("B", 800.0, 0.0)]
    table = pa.table(
        {
            "crater_id": [name for name, _, _ in rims],
            "whitened": pa.array(
                [[np.sqrt(chi2), 0, 0, 0, 0] for _, chi2, _ in rims], pa.list_(pa.float64(), 5)
            ),
            "chi2": [chi2 for _, chi2, _ in rims],
            "weight": pa.array([weight for _, _, weight in rims], pa.float64()),
        }
    )
    (_, first), (_, second) = crater_table(table).rows
    assert [cell.text for cell in first[:4]] == ["A", "3", "1", "1.2"]
    assert [cell.text for cell in second[:4]] == ["B", "1", "1", "–"]
    assert not any(cell.concern for cell in (*first, *second))
    assert first[4].text == "+2.44"


def test_the_same_drawing_gives_the_same_text() -> None:
    def drawn() -> str:
        figure = Figure()
        figure.subplots().plot([0.0, 1.0], [1.0, 3.0], label="smoother")
        return inline_svg(figure, "name")

    assert drawn() == drawn()


def test_overlays_are_in_the_page_and_shrunk_to_it(page: Reader) -> None:
    pictures = [r.split(",", 1)[1] for r in page.references if r.startswith("data:image")]
    assert len(pictures) == 3
    last = cv2.imdecode(np.frombuffer(base64.b64decode(pictures[-1]), np.uint8), cv2.IMREAD_COLOR)
    assert last is not None
    assert last.shape[1] == 1000
    assert last.mean() == pytest.approx(120, abs=3)


def test_without_truth_the_page_says_so_and_shows_standard_deviations(run: Path, tmp_path: Path) -> None:
    dataset = run / "dataset"
    shutil.rmtree(dataset / "mav0" / "state_groundtruth_estimate0")
    assert call("reconstruct", dataset, "-o", tmp_path / "blind", "-e", "smoother", "-e", "ekf").code == 0
    page = read(tmp_path / "blind", tmp_path / "r.html")
    assert "sigmas" in page.identifiers
    assert not {"errors", "bounds", "consistency"} & set(page.identifiers)


def test_a_run_whose_data_set_is_gone_has_a_page_without_map(run: Path, tmp_path: Path) -> None:
    shutil.rmtree(run / "dataset")
    page = read(run, tmp_path / "r.html")
    assert "map" not in page.identifiers
    assert any(str(run / "dataset") in warning for warning in page.warnings)


def test_names_are_escaped(run: Path, tmp_path: Path) -> None:
    odd = run.rename(tmp_path / "a<b>&c")
    text_of = tmp_path / "r.html"
    read(odd, text_of)
    assert "a&lt;b&gt;&amp;c" in text_of.read_text("utf-8")
    assert "a<b>" not in text_of.read_text("utf-8")


@pytest.mark.parametrize("damaged", ["residuals.parquet", "overlays/frame_0001.png"])
def test_a_damaged_run_is_one_error_that_names_the_file(run: Path, tmp_path: Path, damaged: str) -> None:
    (run / damaged).write_bytes(b"PAR1 or PNG it is not")
    out = tmp_path / "r.html"
    with pytest.raises(InputError, match=re.escape(damaged)):
        write_page(run_page(read_run(run)), out)
    assert not out.exists()


def test_the_command_writes_into_the_run_and_reads_its_own_result_as_part_of_it(run: Path) -> None:
    assert call("report", run).out.strip() == str(run / "report.html")
    # A run with its page may be replaced by the next one: the page is ours.
    assert call("report", run, "--json").code == 0


def test_what_is_no_run_is_refused_in_one_line(tmp_path: Path) -> None:
    done = call("report", tmp_path)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_runs_side_by_side(run: Path, made_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "both.html"
    assert call("report", made_run, run).code == 2
    done = call("report", made_run, run, "-o", out)
    assert done.code == 0, done.err
    reader = Reader()
    reader.feed(out.read_text("utf-8"))
    names = list(read_run(run).trajectories)
    assert [row[:2] for row in reader.tables[0][1:]] == [
        [name, str(folder)] for folder in (made_run, run) for name in names
    ]
    traces = data_of(out)["charts"]["runs-chart"]["data"]
    assert [trace["name"] for trace in traces] == 2 * names
    assert [trace["meta"] for trace in traces] == 2 * [identifier(name) for name in names]
    looks = {(trace["line"]["color"], trace["line"]["dash"], trace["marker"]["symbol"]) for trace in traces}
    assert len(looks) == len(traces)


def test_text_in_the_data_cannot_end_its_element(run: Path, tmp_path: Path) -> None:
    table = pq.read_table(run / "residuals.parquet")
    odd = "</script><script>alert(1)</script>"
    names = pa.array([odd] * len(table))
    column = table.schema.get_field_index("crater_id")
    pq.write_table(table.set_column(column, "crater_id", names), run / "residuals.parquet")
    read(run, tmp_path / "r.html")
    assert odd not in (tmp_path / "r.html").read_text("utf-8")
    assert data_of(tmp_path / "r.html")["charts"]["residuals-chart"]["data"][0]["text"][0] == html.escape(odd)
