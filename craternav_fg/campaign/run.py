"""Run a campaign: what is missing, on many workers, each result kept at once."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craternav_fg.campaign.store import CampaignFolder, identity, read_campaign
from craternav_fg.campaign.summary import summarise
from craternav_fg.campaign.trial import TrialResult, TrialTask, failed, run_trial, software
from craternav_fg.campaign.workers import Workers, cluster, processes
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.simulation.scenario_file import MeasurementSection, Scenario

# What is being done, how many of its steps are done, how many there are.
Progress = Callable[[str, int, int], None]

# A trial that kills its worker so often is not tried again.
MOST_DEATHS = 2
# How often to look whether the scheduler is still there.
POLL_S = 2.0
# Analytic rims of a scenario that has images: the paper's edges, sizes that the front end measures.
MEASUREMENTS = MeasurementSection(
    edge_sigma_px=1.0, points_per_rim=60, min_semi_minor_px=12.0, sun_tilt_sigma_deg=10.0
)


@dataclass(frozen=True)
class CampaignOptions:
    """What to run, and where.

    Attributes
    ----------
    trials : int
        Trials 0 to this, exclusive; those that a folder has beyond are left alone.
    estimators : tuple of str
    images : bool
        Render and measure images; the default is analytic rims.
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers run the trials instead.
    retry : bool
        Do those trials again that failed.
    """

    trials: int
    estimators: tuple[str, ...] = DEFAULT
    images: bool = False
    workers: int = 1
    scheduler: str | None = None
    retry: bool = False

    def __post_init__(self) -> None:
        for name in self.estimators:
            estimator(name)
        for name in ("trials", "workers"):
            if getattr(self, name) < 1:
                raise CraternavError(f"{name}: expected 1 or more, found {getattr(self, name)}")


def montecarlo(
    scenario: Scenario, folder: Path, options: CampaignOptions, progress: Progress | None = None
) -> dict[str, Any]:
    """Run the trials of a campaign that its folder lacks, and sum up all that are in it.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        New, empty, or of the same campaign, finished or not.
    options : CampaignOptions
    progress : callable, optional

    Returns
    -------
    dict
        What summary.json holds, see `craternav_fg.campaign.summary.summarise`.

    Raises
    ------
    InputError
        When the folder is another campaign's or in use, or cannot be written.
    CraternavError
        When the scenario cannot do what is asked, or the scheduler cannot be reached or is lost. Finished
        trials stay, and the same call goes on with the others.
    """
    case = as_measured(scenario, images=options.images)
    store = CampaignFolder(folder, identity(case, options.estimators))
    with ExitStack() as stack:
        # Before the folder is made: a scheduler that is not there leaves nothing behind.
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
        summary = summarise(read_campaign(folder))
        store.write_summary(summary)
    return summary


def _missing(options: CampaignOptions, store: CampaignFolder) -> list[int]:
    there = store.numbers(without_failed=options.retry)
    return [number for number in range(options.trials) if number not in there]


def as_measured(scenario: Scenario, *, images: bool) -> Scenario:
    """Give a scenario with images or with analytic rims, whichever is asked for.

    Raises
    ------
    CraternavError
        When images are asked for and the scenario does not say how to render them.
    """
    if images and scenario.render is None:
        raise CraternavError("--images: the scenario has no table [render]")
    if images or scenario.measurements is not None:
        return scenario
    return scenario.model_copy(update={"render": None, "measurements": MEASUREMENTS})


def each_result(workers: Workers, tasks: dict[int, TrialTask]) -> Iterator[TrialResult]:
    """Give the result of every task as soon as it is there.

    A worker that dies costs the tasks that it had; each is tried once more, then counts as failed.

    Raises
    ------
    CraternavError
        When workers cannot run trials at all.
    """
    waiting = deque(tasks)
    running: dict[Future[TrialResult], int] = {}
    deaths: Counter[int] = Counter()
    while waiting or running:
        while waiting and (workers.at_once is None or len(running) < workers.at_once):
            number = waiting.popleft()
            running[workers.executor.submit(run_trial, tasks[number])] = number
        finished, _ = wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED)
        if not finished and not workers.connected():
            raise CraternavError("the scheduler is lost; finished trials stay")
        for future in finished:
            number = running.pop(future)
            try:
                result = future.result()
            except workers.lost:
                deaths[number] += 1
                if deaths[number] < MOST_DEATHS:
                    waiting.append(number)
                    continue
                result = failed(number, f"its worker died {MOST_DEATHS} times")
            except CancelledError:
                raise CraternavError("the scheduler is lost; finished trials stay") from None
            except CraternavError:
                raise
            except Exception as error:
                problem = f"a worker cannot run trials: {type(error).__name__}: {error}"
                raise CraternavError(" ".join(problem.split())) from error
            yield result
