"""Trials distributed over processes; the results do not depend on their number."""

import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from pathlib import Path
from typing import TypeVar

from craternav_fg.errors import CraternavError
from craternav_fg.workers import processes

Task = TypeVar("Task")
Result = TypeVar("Result")
# Called with a description, the number of finished steps and the number of all steps.
Progress = Callable[[str, int, int], None]


def run_all(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    what: str,
    progress: Progress | None,
) -> list[Result]:
    """Run every task, in processes if there is more than one worker.

    Parameters
    ----------
    work : callable
        Function at the top level of a module; its one argument, the task, holds all it needs, with the seed.
    tasks : sequence
    workers : int
    what : str
        Description for the progress report.
    progress : callable, optional

    Returns
    -------
    list
        In the order of the tasks.

    Raises
    ------
    CraternavError
        When a process died, for example of lack of memory.
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
