"""Trials over processes, the same whatever their number."""

import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from pathlib import Path
from typing import TypeVar

from craternav_fg.campaign.workers import processes
from craternav_fg.errors import CraternavError

Task = TypeVar("Task")
Result = TypeVar("Result")
# What is being done, how many of its steps are done, how many there are.
Progress = Callable[[str, int, int], None]


def run_all(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    what: str,
    progress: Progress | None,
) -> list[Result]:
    """Do every task, in processes if there is more than one worker.

    Parameters
    ----------
    work : callable
        A function of a module, of one argument; all that it needs, a seed included, is in the task.
    tasks : sequence
    workers : int
    what : str
        For the progress report.
    progress : callable, optional

    Returns
    -------
    list
        In the order of the tasks.

    Raises
    ------
    CraternavError
        When a process died, as for want of memory.
    """
    results: dict[int, Result] = {}

    def keep(number: int, result: Result) -> None:
        results[number] = result
        if progress is not None:
            progress(what, len(results), len(tasks))

    if workers == 1 or len(tasks) == 1:
        for number, task in enumerate(tasks):
            keep(number, work(task))
    else:
        with (
            tempfile.TemporaryDirectory(prefix="craternav-") as scratch,
            processes(min(workers, len(tasks)), Path(scratch)) as pool,
        ):
            waiting = deque(enumerate(tasks))
            running: dict[Future[Result], int] = {}
            while waiting or running:
                while waiting and len(running) < workers:
                    number, task = waiting.popleft()
                    running[pool.executor.submit(work, task)] = number
                for future in wait(running, return_when=FIRST_COMPLETED)[0]:
                    try:
                        keep(running.pop(future), future.result())
                    except BrokenExecutor:
                        raise CraternavError(f"{what}: a worker process died") from None
    return [results[number] for number in range(len(tasks))]
