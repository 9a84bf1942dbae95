"""Trials over processes, the same whatever their number."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

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
    """
    if workers == 1 or len(tasks) == 1:
        out = []
        for done, task in enumerate(tasks, 1):
            out.append(work(task))
            if progress is not None:
                progress(what, done, len(tasks))
        return out
    # A fresh interpreter each: forking one that has threads (a progress bar's) can hang.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures: list[Future[Result]] = [pool.submit(work, task) for task in tasks]
        for done, _ in enumerate(as_completed(futures), 1):
            if progress is not None:
                progress(what, done, len(tasks))
        return [future.result() for future in futures]
