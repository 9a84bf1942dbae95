"""Workers without processes, and one trial function that kills its worker."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from craternav_fg.campaign.trial import TrialResult, TrialTask, failed
from craternav_fg.workers import Workers

DEADLY = 2


class Inline(Executor):
    """Does a task when it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def processes(count: int, scratch: Path) -> Iterator[Workers]:
    """Stand in for `craternav_fg.workers.processes`."""
    del scratch
    yield Workers(Inline(), count, (BrokenExecutor,))


def run_deadly_trial(task: TrialTask) -> TrialResult:
    """Stand in for `run_trial`: one trial ends its process as the kernel does when memory is short."""
    if task.number == DEADLY:
        os.kill(os.getpid(), signal.SIGKILL)
    return failed(task.number, f"in process {os.getpid()}")
