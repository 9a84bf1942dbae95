"""What is written into a run's folder reads back, also by other tools and from earlier versions."""

import json
import os
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.run_summary import calibration_lines
from craternav_fg.errors import InputError
from craternav_fg.estimators.base import Problem, Start
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.runs.read import describe_frames, read_map_errors, read_residuals, read_run
from craternav_fg.runs.write import write_run
from craternav_fg.trajectory import Calibrated, InitialState, Trajectory
from factors.kernels.conic import project_rims

MOON = Body("Moon", 1_737_400.0, 4.9028e12, (0.0, 0.0, 2.66e-6))
CAMERA = Camera(1024, 1024, 1200.0, 1200.0, 511.5, 511.5)
OPTIONS = {
    "smoother": {"iterations": 20, "loss": None, "gate": float("inf"), "lm": {"floor": 1e-9, "limit": None}},
    "ekf": {},
}


def catalog() -> Catalog:
    one = np.ones(2)
    return Catalog(
        ("A", "B\nnew line"), 0.0 * one, np.array([0.0, 0.002]), 900.0 * one, 700.0 * one, 0.5 * one,
        0.0 * one, MOON,
    )  # fmt: skip


def trajectory(height_m: float, *, sigma: float | None = None) -> Trajectory:
    """Two frames straight above the first crater, turned a little about the vertical in the second."""
    down = frames.east_north_up(np.array(0.0), np.array(0.0)) @ np.diag([1.0, -1.0, -1.0])
    gP = np.array([MOON.radius_m + height_m, 0.0, 0.0])
    turn = frames.rotation_exp(np.array([0.0, 0.0, 0.1]))
    gTb = np.stack([frames.pose(down, gP), frames.pose(down @ turn, gP)])
    stamps = np.array([10**9, 2 * 10**9 + 5], dtype=np.int64)
    V, bias = np.arange(6.0).reshape(2, 3), np.arange(12.0).reshape(2, 6)
    if sigma is None:
        return Trajectory(stamps, gTb, V, bias)
    S = sigma**2 * np.tile(np.eye(6), (2, 1, 1))
    return Trajectory(stamps, gTb, V, bias, S, S[:, :3, :3], S)


def reconstruction() -> Reconstruction:
    """Rims as they are seen from 20 km, each coordinate with a sigma of 1e-3; the smoother is right."""
    truth, craters = trajectory(20e3), catalog()
    measured = []
    for stamp, gTb in zip(truth.stamps_ns, truth.gTb, strict=True):
        charts, seen = project_rims(gTb, CAMERA.bTc, craters.centres, craters.axes)
        assert seen.all()
        rims = RimSet(np.arange(2), charts, np.tile(1e-6 * np.eye(5), (2, 1, 1)))
        measured.append(FrameMeasurement(int(stamp), rims, None))
    initial = InitialState(
        int(truth.stamps_ns[0]), truth.gTb[0], truth.gV[0], 0.1, 100.0, 1.0, 0.01, 1e-5, 1e-3
    )
    problem = Problem(
        MOON, CAMERA, craters, ImuLog(truth.stamps_ns, np.zeros((2, 3)), np.zeros((2, 3))),
        ImuNoise(1e-5, 1e-4, 1e-8, 1e-7), initial, Start(truth.gTb[0], np.eye(6), 0), measured,
    )  # fmt: skip
    return Reconstruction(
        frames=tuple(measured), problems=(problem,), origin="given", reinitialised_at=(),
        trajectories={"smoother": trajectory(20e3, sigma=0.5), "dead_reckoning": trajectory(40e3)},
        times_s={"smoother": 1.0}, options=OPTIONS, failures={}, index_note="", expected_rims=None,
        predicted=None,
    )  # fmt: skip


def write(folder: Path, dataset: str = "dataset", truth: Trajectory | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    write_run(
        folder, reconstruction(), dataset=dataset, truth=truth, times_s={"smoother": 1.0}, wall_s=2.0,
    )  # fmt: skip
    return folder


@pytest.mark.parametrize(
    "name", ["mission \N{ROCKET}", 'quote " and \\', "two\nlines", "tab\tand \x7f", "Mädler"]
)
def test_run_toml_holds_any_path(tmp_path: Path, name: str) -> None:
    """A newline or another control character is escaped in the file and reads back as it was."""
    folder = write(tmp_path / name / "run", str(tmp_path / name / "data"))
    assert read_run(folder).dataset == tmp_path / name / "data"


def test_a_path_that_is_no_text_does_not_lose_the_run(tmp_path: Path) -> None:
    folder = write(tmp_path / "run", os.fsdecode(b"/disk/M\xe4dler"))
    assert read_run(folder).dataset == Path("/disk/M\\udce4dler")


def test_run_toml_holds_options_without_limit(tmp_path: Path) -> None:
    text = (write(tmp_path / "run") / "run.toml").read_text(encoding="utf-8")
    options = tomllib.loads(text)["options"]
    assert options["smoother"]["gate"] == float("inf")
    assert options["smoother"] == {"iterations": 20, "gate": float("inf"), "lm": {"floor": 1e-9}}


def test_states_read_back_as_they_were(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "run", truth=trajectory(20e3)))
    assert list(run.trajectories) == ["smoother", "dead_reckoning"]
    assert run.truth is not None
    for read, written in (
        (run.truth, trajectory(20e3)),
        (run.trajectories["smoother"], trajectory(20e3, sigma=0.5)),
        (run.trajectories["dead_reckoning"], trajectory(40e3)),
    ):
        assert read.stamps_ns.tolist() == written.stamps_ns.tolist()
        np.testing.assert_allclose(read.gTb, written.gTb, rtol=0.0, atol=1e-15 * MOON.radius_m)
        for field in ("gV", "bias", "pose_covariance", "velocity_covariance", "bias_covariance"):
            one, other = getattr(read, field), getattr(written, field)
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)
    assert run.metrics["estimators"]["dead_reckoning"]["position_rms_m"] == pytest.approx(20e3)


def test_a_singular_covariance_is_told_and_the_metrics_stay_json(tmp_path: Path) -> None:
    result = reconstruction()
    smoother = trajectory(20e3, sigma=0.5)
    assert smoother.pose_covariance is not None
    # The position's north is known as soon as its east is.
    smoother.pose_covariance[1, 4, 3] = smoother.pose_covariance[1, 3, 4] = 0.25
    given = Reconstruction(**{**vars(result), "trajectories": {"smoother": smoother}})
    write_run(tmp_path, given, dataset="", truth=trajectory(20.1e3), times_s={}, wall_s=0.0)

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    metrics = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=refuse)
    assert metrics["estimators"]["smoother"]["anees"] is None
    assert metrics["estimators"]["smoother"]["position_rms_m"] == pytest.approx(100.0)
    assert metrics["warnings"] == list(given.warnings)
    told = "smoother: the covariance of its pose is singular in 1 of 2 frames, so it has no ANEES"
    assert told in metrics["warnings"]
    assert not any("singular" in text for text in result.warnings)


def test_a_truth_in_another_frame_is_said(tmp_path: Path) -> None:
    truth = trajectory(20e3)
    turn = frames.pose(frames.rotation_exp(np.array([0.0, 0.0, 0.5])), np.zeros(3))
    turned = read_run(write(tmp_path / "turned", truth=replace(truth, gTb=turn @ truth.gTb)))
    assert any("the truth, not the estimate" in text for text in turned.metrics["warnings"])
    right = read_run(write(tmp_path / "right", truth=truth))
    assert not any("the truth" in text for text in right.metrics["warnings"])


def test_rims_seen_from_elsewhere_are_outliers(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "run"))
    shares = {name: values["rim_outlier_share"] for name, values in run.metrics["estimators"].items()}
    assert shares == {"smoother": 0.0, "dead_reckoning": 1.0}
    residuals = read_residuals(run.path)
    assert residuals["crater_id"].to_pylist() == ["A", "B\nnew line"] * 4
    assert np.array(residuals["chi2"])[:4] == pytest.approx(np.zeros(4), abs=1e-18)


def test_residuals_are_at_the_calibrated_camera(tmp_path: Path) -> None:
    """Without the estimated mounting, wrong by 10 sigma of a rim, every rim is an outlier."""
    result, turn = reconstruction(), np.array([0.01, 0.0, 0.0])
    believed = result.trajectories["smoother"]
    gTb = believed.gTb.copy()
    gTb[:, :3, :3] = gTb[:, :3, :3] @ frames.rotation_exp(-turn)
    shares = {}
    for name, calibrated in (("with", Calibrated(mounting_rad=(turn, 1e-4 * np.ones(3)))), ("without", None)):
        estimate = Trajectory(believed.stamps_ns, gTb, believed.gV, believed.bias, calibrated=calibrated)
        turned = Reconstruction(**{**vars(result), "trajectories": {"smoother": estimate}})
        summary = write_run(tmp_path, turned, dataset="", truth=None, times_s={}, wall_s=0.0)
        shares[name] = summary["estimators"]["smoother"]["rim_outlier_share"]
    assert shares == {"with": 0.0, "without": 1.0}


def test_the_calibration_of_every_segment_is_written(tmp_path: Path) -> None:
    """That of the last one alone hid the first one's."""

    def found(turn_rad: float, errors: dict[int, tuple[float, float]]) -> Calibrated:
        of_map = {row: (np.full(6, e), np.full(6, sigma)) for row, (e, sigma) in errors.items()}
        return Calibrated(mounting_rad=(np.full(3, turn_rad), np.full(3, 1e-4)), map_errors=of_map)

    parts = found(0.0, {0: (0.1, 0.01), 1: (0.2, 0.05)}), found(0.01, {0: (0.4, 0.03), 1: (0.3, 0.02)})
    estimate = replace(trajectory(20e3, sigma=0.5), calibrated=parts[1], calibrated_at=parts)
    begun_anew = {"trajectories": {"smoother": estimate}, "reinitialised_at": (1,)}
    result = Reconstruction(**{**vars(reconstruction()), **begun_anew})
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(folder, result, dataset="", truth=None, times_s={}, wall_s=0.0)
    run = read_run(folder)
    values = run.metrics["estimators"]["smoother"]
    turns = [one["mounting_deg"][0] for one in values["calibrated_segments"]]
    assert turns == pytest.approx([0.0, np.degrees(0.01)])
    assert values["calibrated"] == values["calibrated_segments"][1]
    assert [line.split(" a correction")[0] for line in calibration_lines(values, [1])] == [
        "from frame 0 on", "from frame 1 on",
    ]  # fmt: skip
    # Each crater's by the segment that saw it best.
    errors = read_map_errors(run)
    assert {name: float(error[0]) for name, (error, _) in errors.items()} == {"A": 0.1, "B\nnew line": 0.3}


@pytest.mark.parametrize(
    ("counts", "text"), [([5, 5], "2 frames with 5 rims"), ([1, 18], "2 frames with 1 to 18 rims")]
)
def test_frames_are_described(counts: list[int], text: str) -> None:
    assert describe_frames({"craters_per_frame": counts}) == f"{text} each"


def test_runs_of_version_0_1_are_read(tmp_path: Path) -> None:
    folder = write(tmp_path / "run")
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["resumed_at_frames"] = metrics.pop("reinitialised_at_frames")
    for values in metrics["estimators"].values():
        values["rim_misfit_share"] = values.pop("rim_outlier_share")
        values["calibrated"] = {"image_delay_s": 0.02, "image_delay_sigma_s": 0.004}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    table = pq.read_table(folder / "residuals.parquet")
    former = ["taken_for" if name == "reassociated_with" else name for name in table.column_names]
    pq.write_table(table.rename_columns(former), folder / "residuals.parquet")
    metrics = read_run(folder).metrics
    assert metrics["reinitialised_at_frames"] == []
    values = metrics["estimators"]["dead_reckoning"]
    assert values["rim_outlier_share"] == 1.0
    assert values["calibrated"] == {"time_offset_s": 0.02, "time_offset_sigma_s": 0.004}
    assert read_residuals(folder)["reassociated_with"].to_pylist() == [None] * 8


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("run.toml", b"dataset = \n", "run.toml: expected TOML"),
        ("run.toml", b"estimators = []\n", "run.toml: dataset: key is missing"),
        ("run.toml", b"\xff", "run.toml: expected a text file in UTF-8"),
        ("metrics.json", b"{", "metrics.json: expected JSON"),
        ("metrics.json", b"{}", "metrics.json: wall_s: key is missing"),
        ("metrics.json", b"[1]", "metrics.json: expected a JSON object, found a list"),
        ("metrics.json", b'{"estimators": 3}', "metrics.json: wall_s: key is missing"),
        ("states.parquet", b"PAR1", "states.parquet: expected a Parquet file"),
        ("states.parquet", None, "states.parquet: is missing from the run"),
    ],
)
def test_a_damaged_run_is_one_line(tmp_path: Path, name: str, content: bytes | None, problem: str) -> None:
    folder = write(tmp_path / "run")
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(InputError) as raised:
        read_run(folder)
    assert problem in str(raised.value)
    assert str(folder) in str(raised.value)
