"""Campaigns on this machine: same data whoever runs them, reruns, failures, dying workers, bad input."""

import errno
import json
import os
import re
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from craternav_fg import workers
from craternav_fg.campaign import run, write
from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.run import CampaignOptions, as_measured, each_result, montecarlo
from craternav_fg.campaign.trial import TrialResult, TrialTask, failed, run_trial, software
from craternav_fg.campaign.write import CampaignFolder, identity
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError, EstimationError, InputError
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.reports.campaign_page import campaign_page
from craternav_fg.reports.page import write_page
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.simulation.scenario_tables import CraterTrials, ExpectedSection, Spread
from craternav_fg.workers import Workers
from tests.campaign import inline
from tests.campaign.scene import ESTIMATORS, contents, options, small_scenario, without_times, write_scenario
from tests.cli.calls import call
from tests.report.test_report import Reader


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run trials in this process."""
    monkeypatch.setattr(run, "processes", inline.processes)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four trials in this process."""
    folder = tmp_path_factory.mktemp("campaign") / "one"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "processes", inline.processes)
        montecarlo(small_scenario(), folder, options(4))
    return folder


def check_two_workers(folder: Path, reference: Path) -> None:
    steps = []
    summary = montecarlo(small_scenario(), folder, options(4, workers=2), lambda *step: steps.append(step))
    assert steps == [("trials", done, 4) for done in range(5)]
    assert contents(folder) == contents(reference)
    assert sorted(contents(reference)) == [
        "campaign.toml",
        "summary.json",
        *(f"trials/trial_00000{k}.parquet" for k in range(4)),
    ]
    assert not list(reference.glob(".*"))
    assert without_times(summary) == contents(reference)["summary.json"]
    assert summary["trials"] == 4
    assert summary["failed"] == 0
    assert list(summary["estimators"]) == list(ESTIMATORS)
    assert all(values["time_per_trial_s"] > 0.0 for values in summary["estimators"].values())


def test_trials_are_the_same_however_many_are_done_at_a_time(
    undisturbed: Path, tmp_path: Path, here: None
) -> None:
    """In this process: test_killed.py has the quick test with processes."""
    check_two_workers(tmp_path / "two", undisturbed)


@pytest.mark.slow
def test_trials_are_the_same_however_many_workers(tmp_path: Path) -> None:
    # Not those of this process: here other tests may have compiled kernels for other array layouts, whose
    # sums are rounded in another order.
    montecarlo(small_scenario(), tmp_path / "one", options(4, workers=1))
    check_two_workers(tmp_path / "two", tmp_path / "one")


def test_a_trial_is_that_of_its_number(undisturbed: Path, tmp_path: Path) -> None:
    """All is drawn anew for each trial, and the table holds what `simulate` and `reconstruct` give."""
    data = Dataset.open(simulate(small_scenario(), tmp_path / "data", trial=2))
    assert data.truth is not None
    estimate = reconstruct(data, ESTIMATORS).trajectories["ekf"]
    table = read_campaign(undisturbed).table.to_pandas()
    rows = table[(table.trial == 2) & (table.estimator == "ekf")]
    np.testing.assert_array_equal(np.stack(rows.position_error_m), data.truth.gP - estimate.gP)
    sigmas = np.sqrt(np.diagonal(estimate.pose_covariance, axis1=1, axis2=2))
    np.testing.assert_array_equal(np.stack(rows.pose_sigma), sigmas)
    assert rows.rims.tolist() == [len(frame.rims) for frame in data.measurements or ()]
    for column in ("position_error_m", "velocity_error_m_s", "attitude_error_rad"):
        first = np.stack(table[(table.estimator == "ekf") & (table.stamp_ns == 0)][column])
        assert len(np.unique(first[:, 0])) == 4
    bounds = table[(table.trial == 2) & (table.estimator == "pcrb_filtered")]
    assert bounds.position_error_m.isna().all()
    assert (np.stack(bounds.pose_sigma) > 0.0).all()


def test_a_cluster_is_given_a_few_tasks_at_a_time() -> None:
    class Slow(inline.Inline):
        """Holds its tasks until the last one that it may hold."""

        def __init__(self) -> None:
            self.held: list[tuple[Future[TrialResult], TrialTask]] = []
            self.most = 0

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            self.held.append((Future(), args[0]))
            self.most = max(self.most, len(self.held))
            future = self.held[-1][0]
            if len(self.held) == 5 or args[0].number == 11:
                for waiting, task in self.held:
                    waiting.set_result(failed(task.number, "held"))
                self.held = []
            return future

    executor = Slow()
    tasks = {n: TrialTask(small_scenario(), n, ESTIMATORS, software()) for n in range(12)}
    found = list(each_result(Workers(executor, 5, (BrokenExecutor,)), tasks))
    assert sorted(result.number for result in found) == list(range(12))
    assert executor.most == 5


def test_terrain_of_a_campaign_varies(tmp_path: Path, here: None) -> None:
    case = small_scenario()
    varied = CraterTrials(place_sigma_m=200.0, semi_axes_m=(1000.0, 2000.0))
    craters = case.craters.model_copy(update={"trials": varied})
    montecarlo(case.model_copy(update={"craters": craters}), tmp_path / "c", options(2))
    table = read_campaign(tmp_path / "c").table.to_pandas()
    bound = table[table.estimator == "pcrb_smoothed"]
    first, second = (np.stack(bound[bound.trial == k].pose_sigma) for k in range(2))
    assert np.abs(first / second - 1.0).max() > 0.01


def test_a_rerun_does_what_is_missing(tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "c"
    montecarlo(small_scenario(), folder, options(2))
    before = {path: path.stat().st_mtime_ns for path in (folder / "trials").iterdir()}
    done = []
    monkeypatch.setattr(run, "run_trial", lambda task: (done.append(task.number), run_trial(task))[1])
    again = montecarlo(small_scenario(), folder, options(2))
    assert done == []
    more = montecarlo(small_scenario(), folder, options(3))
    assert done == [2]
    assert (again["trials"], more["trials"]) == (2, 3)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert more["wall_s"] > again["wall_s"] > 0.0
    # Fewer are asked for: the others stay and count.
    assert montecarlo(small_scenario(), folder, options(1))["trials"] == 3


@pytest.mark.parametrize("change", ["scenario", "seed", "estimators", "version", "dependency"])
def test_another_campaigns_folder_is_refused(
    undisturbed: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, wanted = small_scenario(), options(6)
    if change == "scenario":
        case = case.model_copy(update={"sun": case.sun.model_copy(update={"elevation_deg": 31.0})})
        message = "scenario.sun.elevation_deg: expected 31.0, found 30.0"
    elif change == "seed":
        case, message = case.model_copy(update={"seed": 4}), "scenario.seed: expected 4, found 3"
    elif change == "estimators":
        wanted = options(6, estimators=("ekf",))
        message = 'estimators: expected ["ekf"], found ["ekf", "dead_reckoning"]'
    else:
        name = "craternav_fg" if change == "version" else "gtsam"
        other = {**software(), name: "0.0.1"}
        monkeypatch.setattr(write, "software", lambda: other)
        message = f'software.{name}: expected "0.0.1", found'
    before = {path: path.stat().st_mtime_ns for path in undisturbed.rglob("*")}
    with pytest.raises(InputError) as caught:
        montecarlo(case, undisturbed, wanted)
    assert message in str(caught.value)
    assert "not overwritten" in str(caught.value)
    assert {path: path.stat().st_mtime_ns for path in undisturbed.rglob("*")} == before


def test_another_expectation_is_no_other_campaign() -> None:
    case = load_scenario("hard_mounting")
    wider = ExpectedSection(position_rms_m=Spread(mean=4.0, sd=9.0))
    other = case.model_copy(update={"expected": {**case.expected, "smoother": wider}})
    assert other.expected != case.expected
    assert identity(other, ESTIMATORS) == identity(case, ESTIMATORS)
    assert identity(case, ESTIMATORS)["scenario"]["faults"]["mounting_deg"] == 0.2


def test_a_changed_crater_file_is_another_campaign(tmp_path: Path) -> None:
    table = tmp_path / "craters.csv"
    table.write_text("one")
    file = {"source": "file", "path": str(table)}
    case = load_scenario("paper_case3")
    case = type(case).model_validate({**case.model_dump(), "craters": file})
    first = identity(case, ESTIMATORS)
    table.write_text("two")
    assert first != identity(case, ESTIMATORS)
    table.unlink()
    with pytest.raises(InputError, match="file is missing"):
        identity(case, ESTIMATORS)


def test_somebody_else_s_folder_and_a_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("precious")
    for path, message in ((tmp_path / "thesis", "holds no campaign.toml"), (tmp_path / "f", "found a file")):
        if message == "found a file":
            path.touch()
        with pytest.raises(InputError, match=message):
            montecarlo(small_scenario(), path, options(1))
    assert [path.name for path in (tmp_path / "thesis").iterdir()] == ["chapter1.tex"]


def test_hidden_files_of_others_stay(tmp_path: Path) -> None:
    here = identity(small_scenario(), ESTIMATORS)
    theirs = [tmp_path / "c" / name for name in (".git/HEAD", ".notes.txt")]
    for path in theirs:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("precious")
    for _ in range(2):
        with CampaignFolder(tmp_path / "c", here).open():
            assert all(path.is_file() for path in theirs)


def test_two_processes_do_not_run_one_campaign(tmp_path: Path) -> None:
    here = identity(small_scenario(), ESTIMATORS)
    with CampaignFolder(tmp_path / "c", here).open() as scratch:
        with pytest.raises(InputError, match="another process is running"):
            montecarlo(small_scenario(), tmp_path / "c", options(1))
        # The one that runs still has its temporary files.
        assert scratch.is_dir()


def test_a_folder_that_became_another_campaigns_meanwhile_is_refused(tmp_path: Path) -> None:
    mine, theirs = (identity(small_scenario(), names) for names in (ESTIMATORS, ("ekf",)))
    late = CampaignFolder(tmp_path / "c", mine)
    with CampaignFolder(tmp_path / "c", theirs).open():
        pass
    with pytest.raises(InputError, match="another campaign's"), late.open():
        pass


def test_a_run_killed_before_it_wrote_anything_leaves_a_folder_that_can_be_used(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        """Nothing is done after it, as after kill -9."""

    def killed(path: Path, content: bytes) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(write, "write_whole", killed)
        with pytest.raises(Killed):
            montecarlo(small_scenario(), tmp_path / "c", options(1))
    assert montecarlo(small_scenario(), tmp_path / "c", options(1))["trials"] == 1


def test_a_failed_trial_is_recorded_and_the_rest_go_on(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "c"
    calls = []

    def sometimes(dataset: Dataset, names: tuple[str, ...]) -> Reconstruction:
        calls.append(dataset.path)
        if len(calls) == 1:
            raise EstimationError(f"{dataset.path} makes\nno sense")
        if len(calls) == 2:
            raise ZeroDivisionError("a defect")
        return reconstruct(dataset, names)

    monkeypatch.setattr("craternav_fg.campaign.trial.reconstruct", sometimes)
    summary = montecarlo(small_scenario(), folder, options(3))
    assert (summary["trials"], summary["failed"]) == (3, 2)
    assert summary["estimators"]["ekf"]["converged"] == 1
    said = {0: "trial/dataset makes no sense", 1: "ZeroDivisionError: a defect"}
    assert read_campaign(folder).failed == said
    assert montecarlo(small_scenario(), folder, options(3))["failed"] == 2
    assert len(calls) == 3
    assert montecarlo(small_scenario(), folder, options(3, retry=True))["failed"] == 0
    assert len(calls) == 5


def test_an_estimator_without_a_trajectory_in_some_trials_is_named(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def sometimes(dataset: Dataset, names: tuple[str, ...]) -> Reconstruction:
        calls.append(dataset.path)
        result = reconstruct(dataset, names)
        if len(calls) == 2:
            del result.trajectories["ekf"]
            result.failures["ekf"] = "ekf: lost"
        return result

    monkeypatch.setattr("craternav_fg.campaign.trial.reconstruct", sometimes)
    case = write_scenario(tmp_path / "small.toml", small_scenario())
    arguments = ("montecarlo", case, "-o", tmp_path / "c", "--workers", 1, "-e", "ekf", "-e", "online")
    assert "that produced a trajectory" not in call(*arguments, "-n", 1).out
    shown = call(*arguments, "-n", 3).out
    assert "ekf: statistics of the 2 of 3 trials that produced a trajectory\n" in shown
    assert "online: figures" not in shown
    reader = Reader()
    write_page(campaign_page(read_campaign(tmp_path / "c")), tmp_path / "r.html")
    reader.feed((tmp_path / "r.html").read_text("utf-8"))
    assert [row[:3] for row in reader.tables[0]] == [
        ["estimator", "trajectories", "converged"],
        ["ekf", "2 of 3", "2"],
        ["online", "3 of 3", "3"],
    ]


def test_a_worker_that_dies_takes_its_own_trial_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "run_trial", inline.run_deadly_trial)
    tasks = {n: TrialTask(small_scenario(), n, ESTIMATORS, software()) for n in range(5)}
    with workers.processes(2, tmp_path) as pool:
        results = {result.number: result.error for result in each_result(pool, tasks)}
    assert sorted(results) == [0, 1, 2, 3, 4]
    assert results.pop(inline.DEADLY) == "its worker died 2 times"
    assert all(str(error).startswith("in process") for error in results.values())


def test_a_worker_with_other_software_is_an_error_not_a_failed_trial(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "software", lambda: {**software(), "gtsam": "9.9"})
    with pytest.raises(CraternavError, match=r"a worker has gtsam 4\.3\.0, the campaign 9\.9"):
        montecarlo(small_scenario(), tmp_path / "c", options(2))
    assert not list((tmp_path / "c" / "trials").iterdir())


def test_a_full_disk_leaves_what_is_written_valid(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "c"
    sync, calls = os.fsync, []

    def full(handle: int) -> None:
        calls.append(handle)
        # campaign.toml and the first trial, with their folders, come first.
        if len(calls) > 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        InputError, match=r"trial_000001\.parquet: cannot be written: No space left on device"
    ):
        montecarlo(small_scenario(), folder, options(3))
    assert [path.name for path in (folder / "trials").iterdir()] == ["trial_000000.parquet"]
    assert len(pq.read_table(folder / "trials" / "trial_000000.parquet")) == 4 * 6
    monkeypatch.setattr(os, "fsync", sync)
    assert montecarlo(small_scenario(), folder, options(3))["trials"] == 3


def test_a_disk_that_is_full_in_a_trial_is_no_fault_of_the_trial(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "c"

    def full(scenario: Scenario, path: Path, *, trial: int) -> Path:
        if trial == 0:
            return simulate(scenario, path, trial=trial)
        try:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise InputError(path, f"cannot be written: {error.strerror}") from error

    with monkeypatch.context() as patch:
        patch.setattr("craternav_fg.campaign.trial.simulate", full)
        with pytest.raises(CraternavError, match=r"trial 1: trial/dataset: cannot be written: No space left"):
            montecarlo(small_scenario(), folder, options(3))
    assert list(read_campaign(folder).failures) == [0]
    summary = montecarlo(small_scenario(), folder, options(3))
    assert (summary["trials"], summary["failed"]) == (3, 0)


def test_remains_of_a_killed_run_are_cleared_away(undisturbed: Path) -> None:
    expected = contents(undisturbed)
    (undisturbed / "trials" / ".trial_000009.x1.parquet").write_bytes(b"PAR1 half")
    (undisturbed / ".scratch" / "craternav-1").mkdir(parents=True)
    with (undisturbed / "times.jsonl").open("a") as file:
        file.write('{"session": 9, "elap')
    montecarlo(small_scenario(), undisturbed, options(4))
    assert contents(undisturbed) == expected
    for line in (undisturbed / "times.jsonl").read_text().splitlines():
        json.loads(line)


def test_a_damaged_trial_is_named(tmp_path: Path, here: None) -> None:
    summary = montecarlo(small_scenario(), tmp_path / "c", options(1))
    table = read_campaign(tmp_path / "c").table
    trial = tmp_path / "c" / "trials" / "trial_000000.parquet"
    whole = trial.read_bytes()
    pages = range(4, len(whole) - 8 - int.from_bytes(whole[-8:-4], "little"))
    said = []
    for place in pages[::23]:
        trial.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        try:
            found = read_campaign(tmp_path / "c").table
        except InputError as error:
            said.append(str(error))
        else:
            # In the statistics of a page, which nobody reads.
            assert found.equals(table)
    assert len(said) > 0.5 * len(pages[::23])
    # On one line, as no dot is a line break.
    one_line = re.compile(r".*trial_000000\.parquet: is damaged: .+; remove it, .+")
    assert all(one_line.fullmatch(each) for each in said)
    middle = pages[len(pages) // 2]
    trial.write_bytes(whole[:middle] + bytes(20) + whole[middle + 20 :])
    with pytest.raises(InputError, match=r"trial_000000\.parquet: is damaged: .* remove it"):
        montecarlo(small_scenario(), tmp_path / "c", options(1))
    trial.unlink()
    assert without_times(montecarlo(small_scenario(), tmp_path / "c", options(1))) == without_times(summary)
    assert trial.read_bytes() == whole
    trial.write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"trial_000000\.parquet: is damaged"):
        read_campaign(tmp_path / "c")
    with pytest.raises(InputError, match="expected a campaign's folder"):
        read_campaign(tmp_path)


def test_images_or_rims_as_asked_for() -> None:
    rendered, measured = load_scenario("lunar_descent"), load_scenario("paper_case3")
    assert as_measured(measured, images=False) is measured
    assert as_measured(rendered, images=True) is rendered
    rims = as_measured(rendered, images=False)
    assert rims.render is None
    assert rims.measurements == run.MEASUREMENTS
    with pytest.raises(CraternavError, match=r"no table \[render\]"):
        as_measured(measured, images=True)


def test_a_scheduler_that_is_not_there_is_named_soon_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT_S", 0.5)
    for address, message in (
        ("tcp://127.0.0.1:9", "not reached within 0.5 s"),
        ("moon", "expected an address"),
    ):
        began = time.monotonic()
        with pytest.raises(CraternavError, match=f"scheduler {address}: {message}") as caught:
            montecarlo(small_scenario(), tmp_path / "c", options(1, scheduler=address))
        assert time.monotonic() - began < 10.0
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trials": 0}, "trials: expected 1 or more, found 0"),
        ({"trials": 1, "workers": -2}, "workers: expected 1 or more, found -2"),
        ({"trials": 1, "first": -1}, "first: expected 0 or more, found -1"),
        ({"trials": 1, "estimators": ("magic",)}, "unknown estimator 'magic'"),
    ],
)
def test_bad_options(changes: dict[str, object], message: str) -> None:
    with pytest.raises(CraternavError, match=message):
        CampaignOptions(**changes)  # type: ignore[arg-type]


def test_command(tmp_path: Path, undisturbed: Path) -> None:
    case = write_scenario(tmp_path / "small.toml", small_scenario())
    names = [part for name in ESTIMATORS for part in ("-e", name)]
    done = call("montecarlo", case, "-n", 4, "-o", undisturbed, *names, "--json")
    assert done.code == 0, done.err
    assert without_times(json.loads(done.out)) == contents(undisturbed)["summary.json"]
    for arguments, message in (
        (("-n", -3), "trials: expected 1 or more, found -3"),
        (("-n", 1, "--workers", 1, "--scheduler", "tcp://a:1"), "found both"),
    ):
        refused = call("montecarlo", case, "-o", tmp_path / "c", *arguments)
        assert refused.code == 2
        assert message in refused.err
        assert refused.err.count("\n") == 1
        assert not (tmp_path / "c").exists()
