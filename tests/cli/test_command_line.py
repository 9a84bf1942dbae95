"""The whole way, from images, through the command line; and what it says of bad input."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from evo.core import metrics as evo_metrics
from evo.tools import file_interface
from scipy.stats import chi2
from typer.testing import CliRunner

from craternav_fg.cli.app import app
from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.registry import DEFAULT
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.pipeline.reconstruct import reconstruct as reconstruct_in_process
from craternav_fg.runs.read import read_run
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from factors.arrays import FloatArray
from tests import descents
from tests.cli.calls import call, craternav

FIELDS = {
    "position_rms_m",
    "position_final_m",
    "velocity_rms_m_s",
    "attitude_rms_deg",
    "attitude_final_deg",
    "ate_m",
    "rpe_m",
    "rpe_deg",
    "anees",
    "frames",
    "rim_outlier_share",
}


def short_scenario(folder: Path, **changes: str) -> Path:
    """Write the demo's scenario, cut to its first 20 s, with craters that are seen from up there."""
    import scenarios

    text = (Path(scenarios.__file__).parent / "lunar_descent.toml").read_text()
    short = {"duration_s": "20.0", "min_apparent_px": "14.0", "density": "0.003"}
    for key, value in {**short, **changes}.items():
        text, count = re.subn(rf"^{key} = \S+", f"{key} = {value}", text, flags=re.MULTILINE)
        assert count
    # The first 20 s of 300 s: the end's state is that of the long descent there.
    case = load_scenario("lunar_descent").trajectory
    T = 20.0
    end = {
        "altitude_m": case.start.altitude_m + case.start.vertical_speed_m_s * T,
        "downrange_m": case.start.downrange_m + case.start.ground_speed_m_s * T,
        "vertical_speed_m_s": case.start.vertical_speed_m_s,
        "ground_speed_m_s": case.start.ground_speed_m_s,
    }
    head, tail = text.split("[trajectory.end]")
    for key, value in end.items():
        tail = re.sub(rf"^{key} = \S+", f"{key} = {value!r}", tail, count=1, flags=re.MULTILINE)
    path = folder / "short.toml"
    path.write_text(f"{head}[trajectory.end]{tail}")
    return path


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Run the demo on six images; its run folder and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    done = craternav("demo", "--scenario", short_scenario(folder), "-o", folder / "run")
    assert done.returncode == 0, done.stderr
    return folder / "run", done


def test_demo_writes_a_run_and_says_where(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    run, done = demo
    summary = json.loads((run / "metrics.json").read_text())
    assert list(summary["estimators"]) == list(DEFAULT)
    assert summary["wall_s"] > 0.0
    for name, values in summary["estimators"].items():
        assert set(values) == FIELDS
        assert values["frames"] == 6
        assert name in done.stdout
        assert (run / f"{name}.tum").is_file()
    assert set(summary["innovations"]["nis"]) == {"imu", "rims", "sun"}
    assert "NIS per dimension of ekf" in done.stdout
    for path in ("dataset", "figures", "metrics.json", "states.parquet", "residuals.parquet", "run.toml"):
        assert (run / path).exists()
        assert str(run / path) in done.stdout
    for path in (run / "figures").iterdir():
        assert path.stat().st_size > 10_000


def claimed(run: Path, estimator: str) -> FloatArray:
    """Pose covariances (k, 6, 6) in a run's states."""
    table = pq.read_table(run / "states.parquet")
    own = table.filter(pc.equal(table["estimator"], estimator))
    return np.array(own["pose_covariance"].to_pylist()).reshape(-1, 6, 6)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_demo_finds_the_lander_from_25_deg_and_4_km(
    demo: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """To the bound, from the images alone: the prior is off by degrees and kilometres."""
    run, _ = demo
    data = Dataset.open(run / "dataset")
    assert data.truth is not None
    assert np.linalg.norm(data.initial.gTb[:3, 3] - data.truth.gP[0]) > 1000.0
    summary = json.loads((run / "metrics.json").read_text())
    assert min(summary["craters_per_frame"]) >= 10
    frames = reconstruct_in_process(data, ["dead_reckoning"]).frames
    bound = posterior_bound(Descent.of(data), frames, data.truth)
    # The EKF treats time-correlated errors as white with an inflated variance: it claims to know less.
    for name, least, most in (
        ("smoother", bound.smoothed, 1.05),
        ("online", bound.filtered, 1.15),
        ("ekf", bound.filtered, 2.0),
    ):
        best_m = rms(position_rms_m(least))
        assert best_m < 10.0
        assert 0.95 < rms(position_rms_m(claimed(run, name))) / best_m < most
        # The errors of six frames in 20 s are nearly one error: chi-square of 3 and of 6.
        errors = summary["estimators"][name]
        assert errors["position_rms_m"] < best_m * np.sqrt(chi2.ppf(0.999, 3) / 3)
        assert errors["anees"] < chi2.ppf(0.99, 6)
        assert errors["attitude_rms_deg"] < 0.02


def test_reconstruct_in_a_new_process_gives_the_demo_s_numbers(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    run, _ = demo
    names = ("smoother", "online", "ekf")
    wanted = ("-o", tmp_path / "again", "-e", ",".join(names), "--json")
    done = craternav("reconstruct", run / "dataset", *wanted)
    assert done.returncode == 0, done.stderr
    first = json.loads((run / "metrics.json").read_text())["estimators"]
    again = json.loads(done.stdout)["estimators"]
    for name in names:
        for field, value in first[name].items():
            assert again[name][field] == pytest.approx(value, rel=1e-9, abs=1e-9), (name, field)


def test_evo_reads_the_trajectories(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    run, _ = demo
    truth = file_interface.read_tum_trajectory_file(run / "truth.tum")
    for name, values in json.loads((run / "metrics.json").read_text())["estimators"].items():
        estimate = file_interface.read_tum_trajectory_file(run / f"{name}.tum")
        for relation, field in (
            (evo_metrics.PoseRelation.translation_part, "position_rms_m"),
            (evo_metrics.PoseRelation.rotation_angle_deg, "attitude_rms_deg"),
        ):
            ape = evo_metrics.APE(relation)
            ape.process_data((truth, estimate))
            rms = ape.get_statistic(evo_metrics.StatisticsType.rmse)
            assert rms == pytest.approx(values[field], rel=1e-6, abs=1e-9)
    command = [Path(sys.executable).with_name("evo_ape"), "tum", run / "truth.tum", run / "smoother.tum"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "rmse" in done.stdout


def test_run_toml_tells_how_it_was_made(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    run, _ = demo
    description = tomllib.loads((run / "run.toml").read_text())
    assert description["estimators"] == list(DEFAULT)
    assert description["options"]["centre_smoother"]["rims"] == "centre"
    assert description["options"]["ekf_paper"]["measurement"] == "eq19"
    assert description["options"]["front_end"]["fit"]["floor_px"] > 0.0
    assert description["versions"]["gtsam"].startswith("4.3")


def test_run_reads_back(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    run, _ = demo
    back = read_run(run)
    assert list(back.trajectories) == list(DEFAULT)
    assert back.truth is not None
    smoother = back.trajectories["smoother"]
    assert smoother.pose_covariance is not None
    assert (np.linalg.eigvalsh(smoother.pose_covariance) > 0.0).all()
    assert smoother.stamps_ns.tolist() == back.truth.stamps_ns.tolist()


def test_without_truth_there_are_sigmas_instead_of_errors(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(demo[0] / "dataset", data)
    shutil.rmtree(data / "mav0/state_groundtruth_estimate0")
    names = ("-e", "smoother", "-e", "online")
    done = call("reconstruct", data, "-o", tmp_path / "run", *names, "--overlay-every", "4")
    assert done.code == 0, done.err
    assert "no ground truth" in done.out
    pictures = sorted(path.name for path in (tmp_path / "run/overlays").iterdir())
    assert pictures == ["frame_00000_0.0s.png", "frame_00004_16.0s.png"]
    back = read_run(tmp_path / "run")
    assert back.truth is None
    assert back.dataset == data
    assert {p.stem for p in (tmp_path / "run/figures").iterdir()} == {
        "contact_sheet", "descent", "overview", "sigmas",
    }  # fmt: skip


@pytest.mark.usefixtures("undrawn")
def test_images_that_show_something_else_are_warned_of(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """Black images: no rim, no pose; the prior and the IMU are all there is, and the user is warned."""
    data = tmp_path / "data"
    shutil.copytree(demo[0] / "dataset", data)
    for image in (data / "mav0/cam0/data").iterdir():
        cv2.imwrite(str(image), np.zeros((1024, 1024), dtype=np.uint8))
    names = ("-e", "smoother", "-e", "ekf", "-e", "dead_reckoning")
    done = call("reconstruct", data, "-o", tmp_path / "run", *names, "--overlays")
    assert done.code == 0, done.err
    assert len(list((tmp_path / "run/overlays").iterdir())) == 6
    assert "warning: no rim was found in any frame" in done.err
    summary = json.loads((tmp_path / "run/metrics.json").read_text())
    assert summary["innovations"] is None
    estimators = summary["estimators"]
    smoother, dead = (estimators[name]["position_rms_m"] for name in ("smoother", "dead_reckoning"))
    assert smoother == pytest.approx(dead, rel=0.01)


@pytest.mark.parametrize(
    ("names", "message"),
    [(["run.toml", "notes.txt"], "holds notes.txt"), (["notes.txt"], "holds no run.toml")],
    ids=["notes", "other"],
)
def test_what_we_did_not_write_is_not_replaced(tmp_path: Path, names: list[str], message: str) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for name in names:
        (folder / name).touch()
    done = call("demo", "-o", folder, "--force")
    assert done.code == 2
    assert message in done.err
    assert done.err.count("\n") == 1
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)


@pytest.mark.usefixtures("undrawn")
def test_a_first_image_that_shows_nothing_only_delays_the_start(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(demo[0] / "dataset", data)
    cv2.imwrite(str(data / "mav0/cam0/data/0.png"), np.full((1024, 1024), 100, dtype=np.uint8))
    done = call("reconstruct", data, "-o", tmp_path / "run", "-e", "smoother", "-e", "ekf", "--json")
    assert done.code == 0, done.err
    assert "no rim was found in 1 of 6 frames (the first: 0)" in done.err
    summary = json.loads(done.out)
    assert summary["craters_per_frame"][0] == 0
    for name in ("smoother", "ekf"):
        # As for the whole descent, whose last frame is known to 8 m.
        assert summary["estimators"][name]["position_final_m"] < 8.0 * np.sqrt(chi2.ppf(0.999, 3) / 3)
        assert summary["estimators"][name]["anees"] < chi2.ppf(0.99, 6)


def test_version() -> None:
    done = craternav("--version")
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", done.stdout)


def test_child_processes_run_this_checkout(tmp_path: Path) -> None:
    """Wherever they start, and whatever is installed."""
    program = "import importlib.util as util; print(*(util.find_spec(name).origin for name in ({}, {})))"
    done = subprocess.run(
        [sys.executable, "-c", program.format("'craternav_fg'", "'factors'")],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    here = Path(__file__).parents[2]
    assert done.stdout.split() == [str(here / name / "__init__.py") for name in ("craternav_fg", "factors")]


def test_compare_prints_and_tells_json(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    run, _ = demo
    done = call("compare", run, run)
    assert done.code == 0, done.err
    assert done.out.count("dead_reckoning") == 2
    assert "…" not in done.out
    result = json.loads(call("compare", run, "--json").out)[str(run)]
    assert result["smoother"]["from_smoother_rms_m"] == 0.0
    assert result["dead_reckoning"]["from_smoother_rms_m"] > 0.0


@pytest.fixture(scope="module")
def case3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's case 3."""
    data = tmp_path_factory.mktemp("case3") / "data"
    assert call("simulate", "paper_case3", "-o", data).code == 0
    return data


@pytest.fixture(scope="module")
def short_case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty-one frames with rims in each."""
    return simulate(descents.scenario(duration_s=60.0), tmp_path_factory.mktemp("short") / "data")


@pytest.mark.usefixtures("undrawn")
def test_simulate_and_one_estimator_from_measured_rims(case3: Path, tmp_path: Path) -> None:
    done = call("reconstruct", case3, "-o", tmp_path / "run", "-e", "ekf", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)["estimators"]
    assert list(result) == ["ekf"]
    assert result["ekf"]["rim_outlier_share"] < 0.01
    assert "sigma" not in done.err
    none = call("reconstruct", case3, "-o", tmp_path / "other", "--overlays")
    assert none.code == 2
    assert "has measured rims: expected images for --overlays" in none.err
    assert not (tmp_path / "other").exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("factor", "code", "told"),
    [
        (1.0 / 9.81, 2, r"mav0/imu0/data.csv: a_RS_S_x: expected m/s\^2, found g"),
        # No unit: nothing but the poses tells.
        (0.4, 0, r"at the poses of ekf \(\d+ %\), which cannot be trusted; check the units"),
    ],
)
def test_an_imu_of_another_scale_is_told(
    short_case: Path, tmp_path: Path, factor: float, code: int, told: str
) -> None:
    data = tmp_path / "data"
    shutil.copytree(short_case, data)
    imu = data / "mav0/imu0/data.csv"
    header, *rows = imu.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    lines = [",".join([*row[:4], *(repr(factor * float(a)) for a in row[4:])]) for row in cells]
    imu.write_text("\n".join([header, *lines]) + "\n")
    # Without the truth nothing else tells.
    shutil.rmtree(data / "mav0/state_groundtruth_estimate0")
    done = call("reconstruct", data, "-o", tmp_path / "run", "-e", "ekf", "-e", "dead_reckoning")
    assert done.code == code, done.err
    assert re.search(told, done.err)


def test_help_tells_defaults_that_are_not_values() -> None:
    shown = CliRunner().invoke(app, ["reconstruct", "--help"], env={"COLUMNS": "200"}).output
    assert "all but self_calibrating_smoother" in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("reconstruct", "nowhere", "-o", "run"), "nowhere: folder is missing"),
        (("reconstruct", "nowhere", "-o", "run", "-e", "magic"), "unknown estimator 'magic'"),
        (("simulate", "no_such_case", "-o", "data"), "no_such_case"),
        (("compare", "nowhere"), "nowhere: folder is missing"),
        (("demo", "--scenario", "bad.toml", "-o", "run"), "bad.toml:2: colour"),
    ],
    ids=["data", "estimator", "scenario", "run", "key"],
)
def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text('seed = 1\ncolour = "red"\n')
    done = call(*arguments)
    assert done.code == 2
    assert done.out == ""
    assert message in done.err
    assert done.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]


def test_bad_input_is_the_exit_code_of_the_process(tmp_path: Path) -> None:
    done = craternav("reconstruct", "nowhere", "-o", tmp_path / "run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "craternav: nowhere: folder is missing\n"


def test_a_damaged_image_leaves_nothing_half_written(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(demo[0] / "dataset", data)
    image = sorted((data / "mav0/cam0/data").iterdir())[3]
    image.write_bytes(image.read_bytes()[:20_000])
    done = call("reconstruct", data, "-o", tmp_path / "run")
    assert done.code == 2
    assert image.name in done.err
    assert done.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_a_run_is_no_data_set_but_holds_one(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    done = call("reconstruct", demo[0], "-o", tmp_path / "run")
    assert done.code == 2
    assert "found a run: its data set is" in done.err


def test_a_run_does_not_replace_the_folder_of_its_data(
    demo: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    run, _ = demo
    done = call("reconstruct", run / "dataset", "-o", run)
    assert done.code == 2
    assert "would be lost" in done.err
    assert (run / "dataset" / "dataset.toml").is_file()


def test_somebody_else_s_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("precious")
    done = call("simulate", "paper_case3", "-o", tmp_path / "thesis", "--force")
    assert done.code == 2
    assert "not overwritten" in done.err
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "precious"
