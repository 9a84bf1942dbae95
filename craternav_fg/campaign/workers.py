"""Where trials run: processes on this machine, or a Dask cluster."""

import asyncio
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from craternav_fg.errors import CraternavError

T = TypeVar("T")

# How long to wait for a scheduler to answer, and for its first worker.
CONNECT_TIMEOUT_S = 10.0
# Every trial has a core of its own: more threads of linear algebra would compete for it.
_SINGLE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Workers:
    """An executor, and what its user must know.

    Attributes
    ----------
    executor : Executor
    at_once : int or None
        Maximum number of tasks that it may hold at a time; None for any number.
    lost : tuple of type
        Exceptions that a task raises when its worker has died.
    connected : callable
        Says whether results can still arrive.
    """

    executor: Executor
    at_once: int | None
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

    Linear algebra has one thread. Ctrl-C, which reaches them too, is left to the process that started them.
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
    """Give workers that are processes on this machine.

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
    """Give the workers of a Dask scheduler.

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
        # Impure, so that a trial that is repeated is run again.
        executor = client.get_executor(pure=False)
        yield Workers(executor, None, (KilledWorker,), lambda: client.status == "running")
