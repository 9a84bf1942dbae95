"""Where independent tasks run: processes on this machine, or the workers of a Dask cluster."""

import asyncio
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from craternav_fg.errors import CraternavError

T = TypeVar("T")
Key = TypeVar("Key", bound=Hashable)
Task = TypeVar("Task")
Result = TypeVar("Result")

# How long to wait for a scheduler to answer, and for its first worker.
CONNECT_TIMEOUT_S = 10.0
# Tasks that a scheduler holds at a time, and further ones for each thread of its workers. The cost of every
# result grows with their number, as does memory.
TASKS_AT_ONCE, TASKS_OF_A_THREAD = 500, 4
# A task whose worker has died so many times is not tried again: two, as the first may be by chance.
MAX_WORKER_DEATHS = 2
# Interval at which the connection to the scheduler is checked.
POLL_S = 2.0
# Every task has a core of its own: more threads of linear algebra, compiled code or OpenCV would compete for
# it.
_SINGLE_THREAD = dict.fromkeys(
    (
        "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    ),
    "1",
)  # fmt: skip


@dataclass(frozen=True)
class Workers:
    """An executor, and what its user must know.

    Attributes
    ----------
    executor : Executor
    at_once : int
        Maximum number of tasks that it may hold at a time.
    lost : tuple of type
        Exceptions that a task raises when its worker has died.
    connected : callable
        Says whether results can still arrive.
    """

    executor: Executor
    at_once: int
    lost: tuple[type[BaseException], ...]
    connected: Callable[[], bool] = lambda: True


class Processes(Executor):
    """Processes with one task each. One that dies loses its own task only, and is replaced.

    Parameters
    ----------
    count : int
        Number of processes, and of tasks that they hold at a time.
    scratch : Path
        Folder for their temporary files.
    """

    def __init__(self, count: int, scratch: Path) -> None:
        self._scratch = scratch
        self._lanes = [(self._lane(), _done()) for _ in range(count)]
        # Lanes whose process has started, which it does at the first task.
        self._begun: set[int] = set()
        self._others = set(multiprocessing.active_children())

    def _lane(self) -> ProcessPoolExecutor:
        # A new interpreter, as a fork of one that has threads (a progress bar) can hang.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, _begin_worker, (str(self._scratch),))

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Give a task to an idle process.

        Parameters
        ----------
        fn : callable
        *args, **kwargs
            Its arguments.

        Returns
        -------
        Future

        Raises
        ------
        RuntimeError
            When all processes are busy.
        """
        free = (k for k, (_, future) in enumerate(self._lanes) if future.done())
        k = next(free, None)
        if k is None:
            raise RuntimeError(f"all {len(self._lanes)} processes are busy")
        lane, _ = self._lanes[k]
        if k in self._begun:
            try:
                future = lane.submit(fn, *args, **kwargs)
            except BrokenExecutor:
                lane.shutdown(wait=False)
                lane = self._lane()
            else:
                self._lanes[k] = (lane, future)
                return future
        # Ctrl-C is ignored while a process starts, no longer.
        with _spawning():
            future = lane.submit(fn, *args, **kwargs)
        self._begun.add(k)
        self._lanes[k] = (lane, future)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop the processes; with `cancel_futures` those still at work are killed."""
        if cancel_futures:
            for process in self._own():
                process.terminate()
        for lane, _ in self._lanes:
            lane.shutdown(wait, cancel_futures=cancel_futures)

    def _own(self) -> set[BaseProcess]:
        return set(multiprocessing.active_children()) - self._others


def _done() -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(None)
    return future


@contextmanager
def _spawning() -> Iterator[None]:
    """Set what new processes must inherit before their first import.

    Computations have one thread. Ctrl-C, which reaches them too, is left to the process that started them.
    """
    before = {name: os.environ.get(name) for name in _SINGLE_THREAD}
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    os.environ.update(_SINGLE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if main:
            signal.signal(signal.SIGINT, handler)


def _begin_worker(scratch: str) -> None:
    """Set up a process: its folder for temporary files, and that it ends with the process that started it."""
    tempfile.tempdir = scratch
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def processes(count: int, scratch: Path) -> Iterator[Workers]:
    """Return workers that are processes on this machine.

    Parameters
    ----------
    count : int
        Number of processes.
    scratch : Path
        Folder for their temporary files.

    Yields
    ------
    Workers
    """
    pool = Processes(count, scratch)
    try:
        yield Workers(pool, count, (BrokenExecutor,))
        pool.shutdown()
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise


@contextmanager
def _silent(name: str) -> Iterator[None]:
    """Silence a logger whose messages are raised as errors here."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Return the workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        As `dask scheduler` prints it.

    Yields
    ------
    Workers

    Raises
    ------
    CraternavError
        When the extra `cluster` is not installed, or no scheduler or no worker answers in time.
    """
    try:
        from distributed import Client, KilledWorker
        from distributed.comm import connect, get_address_host_port
    except ImportError:
        raise CraternavError("--scheduler needs Dask: pip install 'craternav_fg[cluster]'") from None
    try:
        get_address_host_port(address)
    except (ValueError, TypeError) as error:
        raise CraternavError(
            f"scheduler {address}: expected an address as tcp://host:port: {error}"
        ) from None

    async def answers() -> None:
        comm = await connect(address, timeout=CONNECT_TIMEOUT_S)
        await comm.close()

    try:
        # A client that fails half-way leaves threads and messages behind.
        asyncio.run(answers())
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise CraternavError(
            f"scheduler {address}: not reached within {CONNECT_TIMEOUT_S:g} s: {error}"
        ) from None
    except Exception as error:
        # The answer of another server, decoded as a message, can raise anything: on the port of the
        # scheduler's web page it is a MemoryError.
        problem = f"what answers there is no Dask scheduler ({type(error).__name__})"
        raise CraternavError(f"scheduler {address}: {problem}") from None
    with _silent("distributed.client"), client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError:
            raise CraternavError(f"scheduler {address}: no worker within {CONNECT_TIMEOUT_S:g} s") from None
        # Impure, so that a task that is repeated is run again.
        executor = client.get_executor(pure=False)
        at_once = TASKS_AT_ONCE + TASKS_OF_A_THREAD * sum(client.nthreads().values())
        yield Workers(executor, at_once, (KilledWorker,), lambda: client.status == "running")


def each_result(
    workers: Workers,
    work: Callable[[Task], Result],
    tasks: Mapping[Key, Task],
    died: Callable[[Key], Result],
    what: str,
) -> Iterator[Result]:
    """Run all tasks and give their results in the order in which they are done.

    The task of a worker that dies is tried once more.

    Parameters
    ----------
    workers : Workers
    work : callable
        Function at the top level of a module; its one argument is the task.
    tasks : mapping of hashable to object
        What each task is, by its key.
    died : callable
        Gives the result of a task, by its key, whose workers have died `MAX_WORKER_DEATHS` times.
    what : str
        What the tasks are, for messages: "trials".

    Yields
    ------
    object
        What `work` or `died` returned.

    Raises
    ------
    CraternavError
        When a task raises it, the scheduler is lost, or workers cannot run tasks at all.
    """
    lost = f"the scheduler is lost; finished {what} are kept"
    waiting = deque(tasks)
    running: dict[Future[Result], Key] = {}
    deaths: Counter[Key] = Counter()
    while waiting or running:
        while waiting and len(running) < workers.at_once:
            key = waiting.popleft()
            running[workers.executor.submit(work, tasks[key])] = key
        finished, _ = wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED)
        if not finished and not workers.connected():
            raise CraternavError(lost)
        for future in finished:
            key = running.pop(future)
            try:
                result = future.result()
            except workers.lost:
                deaths[key] += 1
                if deaths[key] < MAX_WORKER_DEATHS:
                    waiting.append(key)
                    continue
                result = died(key)
            except CancelledError:
                raise CraternavError(lost) from None
            except CraternavError:
                raise
            except Exception as error:
                problem = f"a worker cannot run {what}: {type(error).__name__}: {error}"
                raise CraternavError(" ".join(problem.split())) from error
            yield result
