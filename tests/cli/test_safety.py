"""Results are never replaced without being asked; trials, names and verbosity on the command line."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from craternav_fg.campaign import run as campaign_run
from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.run import CampaignOptions
from craternav_fg.cli.app import every_command
from craternav_fg.cli.options import require_free
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from tests import descents
from tests.campaign import inline
from tests.cli.calls import call
from tests.cli.test_help import COMMANDS

pytestmark = pytest.mark.usefixtures("undrawn")

SHORT = """
base = "paper_case3"
[trajectory]
duration_s = 20.0
[trajectory.start]
altitude_m = 40e3
downrange_m = -2e3
ground_speed_m_s = 150.0
[trajectory.end]
altitude_m = 37e3
ground_speed_m_s = 50.0
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "short.toml"
    path.write_text(SHORT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(descents.scenario(duration_s=20.0), tmp_path_factory.mktemp("data") / "data")


def test_a_run_is_replaced_by_force_alone(data: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert call("reconstruct", data, "-o", run, "-e", "smoother,ekf").code == 0
    done = call("reconstruct", data, "-o", run, "-e", "dead_reckoning")
    assert done.code == 2
    assert done.err == f"craternav: {run}: already exists: choose another name, or replace it with --force\n"
    assert list(json.loads((run / "metrics.json").read_text())["estimators"]) == ["smoother", "ekf"]
    assert call("reconstruct", data, "-o", run, "-e", "dead_reckoning", "--force").code == 0
    assert list(json.loads((run / "metrics.json").read_text())["estimators"]) == ["dead_reckoning"]


@pytest.mark.parametrize(
    ("arguments", "beside"),
    [
        (["export", "kitti", "run", "-o", "out/s.txt"], "s_times.txt"),
        (["detect", "image.png", "-o", "out/rims.csv", "--method", "canny"], "rims_overlay.png"),
        (
            ["catalog", "merge", "a.csv", "b.csv", "-o", "out/c.csv", "--sources", "out/sources.csv"],
            "sources.csv",
        ),
    ],
    ids=["times", "overlay", "sources"],
)
def test_what_is_written_beside_a_result_is_replaced_by_force_alone(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], beside: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if "run" in arguments:
        assert call("reconstruct", data, "-o", "run", "-e", "ekf").code == 0
    cv2.imwrite("image.png", np.zeros((64, 64), np.uint8))
    for name in ("a.csv", "b.csv"):
        shutil.copy(data / "craters.csv", name)
    Path("out").mkdir()
    kept = Path("out") / beside
    kept.write_text("kept")
    done = call(*arguments)
    assert (done.code, done.err) == (
        2,
        f"craternav: {kept}: already exists: choose another name, or replace it with --force\n",
    )
    assert [path.name for path in Path("out").iterdir()] == [beside]
    done = call(*arguments, "--force")
    assert done.code == 0, done.err
    assert kept.read_bytes() != b"kept"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        *(
            (
                ["detect", "image.png", *given],
                f"{given[0]}: does nothing for one image that is not searched into a folder (-o FOLDER)",
            )
            for given in (
                ["--body", "Moon"], ["--body-radius-m", "1e6"], ["--workers", "2"], ["--scheduler", "a:1"]
            )
        ),
        (
            ["detect", "image.png", "b.png", "--body", "Moon"],
            "--body: does nothing for several images, only for one mosaic",
        ),
        *(
            (["catalog", "refine", "a.csv", source, "x", *given], f"{given[0]}: does nothing without --dem")
            for source in ("--run", "--posed-images")
            for given in (
                # Also the default, which would be as misleading.
                ["--dem-unit-m", "1"], ["--min-diameter-steps", "9"], ["--resolution-steps", "2"],
                ["--scheduler", "a:1"],
            )
        ),
        *(
            (["bench", subject, *given], f"{given[0]}: does nothing for bench {subject}")
            for subject in ("detect-real", "identify-ground")
            for given in (["--output", "a.png"], ["--compare", "a.json"], ["--full"], ["--force"])
        ),
        (["bench", "scaling", "--full"], "--full: does nothing for bench scaling"),
        (["bench", "--data", "x"], "--data: does nothing for bench speed"),
        *(
            (
                ["reconstruct", "--print-config", *given],
                f"{given[0]}: does nothing with --print-config, which prints the defaults",
            )
            for given in (
                ["data"], ["--config", "a.toml"], ["--output", "run"], ["--without", "sun"], ["--overlays"],
                ["--overlay-every", "2"], ["--force"], ["--json"],
            )
        ),
    ],
)  # fmt: skip
def test_an_option_that_would_do_nothing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call(*arguments)
    assert (done.code, done.err) == (2, f"craternav: {problem}: leave it out\n")
    assert list(tmp_path.iterdir()) == []


def test_every_command_that_writes_a_result_has_force() -> None:
    # A campaign that is there is completed.
    without = {
        names for names, command in COMMANDS.items() if _writes(command) and not _has(command, "force")
    }
    assert without == {("montecarlo",)}


def _has(command: object, name: str) -> bool:
    return any(parameter.name == name for parameter in command.params)  # type: ignore[attr-defined]


def _writes(command: object) -> bool:
    return _has(command, "output")


def test_folders_are_not_made_at_the_root(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="would make the folder /no-such-folder at the root"):
        require_free(Path("/no-such-folder/report.html"), force=True)
    require_free(tmp_path / "new" / "report.html", force=False)
    (tmp_path / "empty").mkdir()
    require_free(tmp_path / "empty", force=False)


def test_a_report_is_not_written_to_the_root(data: Path, tmp_path: Path) -> None:
    assert call("reconstruct", data, "-o", tmp_path / "run", "-e", "ekf").code == 0
    done = call("report", tmp_path / "run", "-o", "/no-such-folder/report.html")
    assert done.code == 2
    assert "root of the file system" in done.err
    assert not Path("/no-such-folder").exists()


def test_a_trial_is_the_campaigns(scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_run, "processes", inline.processes)
    folder = tmp_path / "campaign"
    done = call("montecarlo", scenario, "-n", 2, "--trial", 16, "-e", "ekf", "--workers", 1, "-o", folder)
    assert done.code == 0, done.err
    assert sorted(read_campaign(folder).failures) == [16, 17]
    done = call("simulate", scenario, "--trial", 17, "-o", tmp_path / "data")
    assert done.code == 0, done.err
    data = Dataset.open(tmp_path / "data")
    found = reconstruct(data, ["ekf"]).trajectories["ekf"]
    assert data.truth is not None
    table = read_campaign(folder).table.to_pandas()
    rows = table[(table.trial == 17) & (table.estimator == "ekf")]
    np.testing.assert_array_equal(np.stack(rows.position_error_m), data.truth.gP - found.gP)


def test_seeds_make_other_data(scenario: Path, tmp_path: Path) -> None:
    files = []
    for name, options in (("a", ()), ("b", ("--seed", 7)), ("c", ("--seed", 7)), ("d", ("--trial", 0))):
        assert call("simulate", scenario, *options, "-o", tmp_path / name).code == 0
        files.append((tmp_path / name / "mav0/imu0/data.csv").read_bytes())
    assert files[1] == files[2]
    assert len(set(files)) == 3


def test_measured_rims_in_place_of_images(tmp_path: Path) -> None:
    done = call("simulate", "lunar_descent", "--measured", "-o", tmp_path / "data")
    assert done.code == 0, done.err
    assert Dataset.open(tmp_path / "data").measurements is not None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("reconstruct", "DATA", "-e", "smoohter"), "did you mean smoother?"),
        (("reconstruct", "DATA", "-e", "smoother,efk"), "did you mean ekf?"),
        (("simulate", "lunar_decent"), "did you mean lunar_descent?"),
        (("reconstruct", "nowhere"), "nowhere: folder is missing"),
        (("compare", "nowhere"), "nowhere: folder is missing"),
        (("report", "nowhere"), "nowhere: folder is missing"),
        (("reconstruct", "DATA", "--without", "altimeter"), "has no sensor 'altimeter'"),
    ],
)
def test_what_was_meant(data: Path, tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    writes = arguments[0] in ("reconstruct", "simulate")
    output = ("-o", tmp_path / "out") if writes else ()
    done = call(*(data if word == "DATA" else word for word in arguments), *output)
    assert done.code == 2
    assert says in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_quiet_prints_warnings_and_json_only(data: Path, tmp_path: Path) -> None:
    done = call("-q", "reconstruct", data, "-o", tmp_path / "run", "-e", "ekf")
    assert (done.code, done.out, done.err) == (0, "", "")
    done = call("-q", "compare", tmp_path / "run", "--json")
    assert list(json.loads(done.out)) == [str(tmp_path / "run")]
    done = call("-v", "reconstruct", data, "-o", tmp_path / "verbose", "-e", "ekf")
    assert "estimator ekf: 0 of 1" in done.err
    done = call("-v", "compare", "nowhere")
    assert "Traceback" in done.err


def test_compare_tells_different_data_sets_and_draws(data: Path, tmp_path: Path) -> None:
    other = simulate(descents.scenario(duration_s=20.0), tmp_path / "other", trial=3)
    longer = simulate(descents.scenario(duration_s=24.0), tmp_path / "longer")
    for name, folder in (("a", data), ("c", other), ("d", longer)):
        assert call("reconstruct", folder, "-o", tmp_path / name, "-e", "smoother,ekf").code == 0
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    done = call("compare", tmp_path / "a", tmp_path / "b", "-o", tmp_path / "errors.png")
    assert (done.code, done.err) == (0, "")
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")
    done = call("compare", tmp_path / "a", tmp_path / "c")
    assert done.code == 0
    assert f"warning: different data sets: {data}" in done.err
    done = call("compare", tmp_path / "a", tmp_path / "d", "-o", tmp_path / "longer.png")
    assert done.code == 0
    assert (tmp_path / "longer.png").exists()


# What a shell asks, and an answer.
COMPLETED = {
    "craternav rec": "reconstruct",
    "craternav reconstruct --overlay-": "--overlay-every",
    "craternav reconstruct DATA -e smoother,dead": "smoother,dead_reckoning",
    "craternav simulate lunar": "lunar_descent",
    "craternav catalog ne": "near",
}
# In a process whose program is not `python -m pytest`, by which the variables would be named.
COMPLETING = """
import json, os, sys
from tests.cli.calls import call

os.environ["_CRATERNAV_COMPLETE"] = "complete_bash"
for words in json.loads(sys.argv[1]):
    os.environ.update({"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)})
    print(json.dumps(call().out.split()))
"""


def test_the_shell_completes() -> None:
    command = [sys.executable, "-c", COMPLETING, json.dumps(list(COMPLETED))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    for answers, completed in zip(done.stdout.splitlines(), COMPLETED.values(), strict=True):
        assert completed in json.loads(answers)


def test_commands_say_what_their_output_is_by_one_rule() -> None:
    for names, command in COMMANDS.items():
        output = [parameter for parameter in command.params if parameter.name == "output"]
        for one in output:
            assert one.opts == ["--output", "-o"] or set(one.opts) == {"--output", "-o"}, names
            assert one.required or one.default is None or str(one.default).startswith("runs/"), names


def test_all_groups_are_loaded() -> None:
    assert {"reconstruct", "catalog"} <= set(every_command().commands)


def test_campaigns_begin_where_they_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_run, "processes", inline.processes)
    case = descents.scenario(duration_s=20.0)
    for first in (0, 2):
        options = CampaignOptions(trials=1, first=first, estimators=("dead_reckoning",))
        campaign_run.montecarlo(case, tmp_path / "campaign", options)
    campaign = read_campaign(tmp_path / "campaign")
    assert sorted(campaign.failures) == [0, 2]
    assert set(campaign.table["trial"].to_pylist()) == {0, 2}
