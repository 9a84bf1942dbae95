"""Run a campaign: the trials that its folder lacks, on many workers, each saved when it is done."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from craternav_fg.campaign.summary import summarise_folder
from craternav_fg.campaign.trial import TrialResult, TrialTask, failed, run_trial, software
from craternav_fg.campaign.write import CampaignFolder, identity
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.simulation.scenario_tables import MeasurementSection, PublishedCraters
from craternav_fg.workers import MAX_WORKER_DEATHS, Workers, cluster, processes
from craternav_fg.workers import each_result as each_result_of

# Called with the name of a step, the number of its parts that are done, and their total.
Progress = Callable[[str, int, int], None]

# Simulated measurements for a scenario that renders images: noise and tilt of the paper's section 4, the
# smallest rims that the front end measures.
MEASUREMENTS = MeasurementSection(
    edge_sigma_px=1.0, points_per_rim=60, min_semi_minor_px=12.0, sun_tilt_sigma_deg=10.0
)


@dataclass(frozen=True)
class CampaignOptions:
    """What a campaign runs, and where.

    Attributes
    ----------
    trials : int
        Number of trials, starting with the first. Others in the folder are not changed.
    first : int
        Number of the first trial.
    estimators : tuple of str
        Names.
    images : bool
        Render images and measure them; the default simulates the measurements.
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler whose workers run the trials instead.
    retry : bool
        Repeat the trials that failed.

    Raises
    ------
    CraternavError
        When an estimator is unknown, there is no trial or no worker, or the first trial's number is negative.
    """

    trials: int
    first: int = field(default=0, kw_only=True)
    estimators: tuple[str, ...] = DEFAULT
    images: bool = False
    workers: int = 1
    scheduler: str | None = None
    retry: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "estimators", tuple(estimator(name).name for name in self.estimators))
        for name in ("trials", "workers"):
            if getattr(self, name) < 1:
                raise CraternavError(f"{name}: expected 1 or more, found {getattr(self, name)}")
        if self.first < 0:
            raise CraternavError(f"first: expected 0 or more, found {self.first}")


def montecarlo(
    scenario: Scenario | Path | str,
    folder: Path | str,
    options: CampaignOptions,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the trials of a campaign that its folder lacks, and summarise all of them.

    Parameters
    ----------
    scenario : Scenario, Path or str
        Name of a built-in scenario, or a TOML file.
    folder : Path or str
        New, empty, or of the same campaign, complete or not.
    options : CampaignOptions
    progress : callable, optional

    Returns
    -------
    dict
        Contents of summary.json, see `craternav_fg.campaign.summary.summarise`.

    Raises
    ------
    InputError
        When the folder is another campaign's or in use, or cannot be written.
    CraternavError
        When the scenario has no images to render, or the scheduler cannot be reached or is lost. Finished
        trials stay, and the same call resumes the campaign.
    """
    folder = Path(folder)
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    scenario = scenario.with_data()
    case = as_measured(scenario, images=options.images)
    store = CampaignFolder(folder, identity(case, options.estimators))
    with ExitStack() as stack:
        # Before the folder is made, so that a scheduler that does not answer leaves nothing behind.
        workers = None
        if options.scheduler is not None and _missing(options, store):
            workers = stack.enter_context(cluster(options.scheduler))
        scratch = stack.enter_context(store.open())
        missing = _missing(options, store)
        done = options.trials - len(missing)
        if progress is not None:
            progress("trials", done, options.trials)
        if missing and workers is None:
            workers = stack.enter_context(processes(min(options.workers, len(missing)), scratch))
        if workers is not None:
            versions = software()
            tasks = {n: TrialTask(case, n, options.estimators, versions) for n in missing}
            for result in each_result(workers, tasks):
                store.add(result)
                done += 1
                if progress is not None:
                    progress("trials", done, options.trials)
        store.note_time()
        summary = summarise_folder(folder)
        store.write_summary(summary)
    return summary


def _missing(options: CampaignOptions, store: CampaignFolder) -> list[int]:
    done = store.numbers(without_failed=options.retry)
    return [number for number in range(options.first, options.first + options.trials) if number not in done]


def as_measured(scenario: Scenario, *, images: bool) -> Scenario:
    """Return a scenario that renders images, or one that simulates the measurements.

    Parameters
    ----------
    scenario : Scenario
    images : bool
        Which of the two.

    Returns
    -------
    Scenario

    Raises
    ------
    CraternavError
        When `images` is set and the scenario has no table [render], or it is not and the true rims are those
        of an elevation model.
    """
    if not images and isinstance(scenario.craters, PublishedCraters):
        raise CraternavError("only images show the true rims of published craters: use --images")
    if images and scenario.render is None:
        raise CraternavError("--images: the scenario has no table [render]")
    if images or scenario.measurements is not None:
        return scenario
    return scenario.model_copy(update={"render": None, "measurements": MEASUREMENTS})


def each_result(workers: Workers, tasks: dict[int, TrialTask]) -> Iterator[TrialResult]:
    """Run all trials and give their results in the order in which they are done.

    Those of a worker that dies are tried once more, and fail if their worker dies again.

    Parameters
    ----------
    workers : Workers
    tasks : dict of int to TrialTask
        By the number of the trial.

    Returns
    -------
    iterator of TrialResult

    Raises
    ------
    CraternavError
        When the scheduler is lost, or workers cannot run trials at all.
    """

    def died(number: int) -> TrialResult:
        return failed(number, f"its worker died {MAX_WORKER_DEATHS} times")

    return each_result_of(workers, run_trial, tasks, died, "trials")
