"""Compile the kernels by using each once, on small problems; the compiled code stays on disk."""

import importlib
import multiprocessing
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.registry import DEFAULT
from craternav_fg.simulation.scenario import simulate
from craternav_fg.vision.edge_kernel import trace_rim
from factors.kernels.compiled import is_cached
from factors.kernels.packed import shape_residuals

# The demo's descent with few frames, and with few and small images.
MEASURED = """
base = "measured_descent"
[trajectory]
frame_interval_s = 20.0
"""
RENDERED = """
base = "lunar_descent"
[camera]
width_px = 512
height_px = 512
[trajectory]
frame_interval_s = 20.0
[craters]
min_apparent_px = 24.0
max_apparent_px = 150.0
"""


def is_warm() -> bool:
    """Whether the kernels of a reconstruction have been compiled.

    Returns
    -------
    bool
    """
    return is_cached(trace_rim) and is_cached(shape_residuals)


def warm_up(folder: Path) -> Dataset:
    """Compile the kernels of simulation, front end, estimators and figures, in two processes.

    Parameters
    ----------
    folder : Path
        Where the small problems are put.

    Returns
    -------
    Dataset
        One of them, with images.
    """
    with _compiling(folder):
        pass
    return Dataset.open(folder / "rendered")


@contextmanager
def warming_up() -> Iterator[None]:
    """Prepare a reconstruction while something else is done, and wait for the end.

    What it needs is compiled in other processes; where it has been, a thread imports it.
    """
    if is_warm():
        # Rendering needs the interpreter little.
        thread = threading.Thread(target=_imported, daemon=True)
        thread.start()
        yield
        # Nobody waits for it when the work has failed.
        thread.join()
        return
    with tempfile.TemporaryDirectory(prefix="craternav-") as folder, _compiling(Path(folder)):
        yield


def _imported() -> None:
    # What cannot be imported is said where it is needed.
    with suppress(Exception):
        importlib.import_module("craternav_fg.runs.execute")


@contextmanager
def _compiling(folder: Path) -> Iterator[None]:
    # Each compiles the kernels that the other has not begun.
    make = multiprocessing.get_context("spawn").Process
    processes = [make(target=part, args=(folder,), daemon=True) for part in (_rendered, _measured)]
    try:
        for process in processes:
            process.start()
        yield
        for process in processes:
            process.join()
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


def _measured(folder: Path) -> None:
    """Run all estimators on measured rims, with figures."""
    from craternav_fg.runs.execute import execute_run

    _ignore_interrupts()
    data = _data(folder, "measured", MEASURED)
    (folder / "run").mkdir()
    # What cannot be solved on so small a problem is compiled all the same.
    with suppress(CraternavError):
        execute_run(data, folder / "run", DEFAULT, label="../measured", began_s=time.perf_counter())


def _rendered(folder: Path) -> None:
    """Reconstruct from images."""
    from craternav_fg.pipeline.reconstruct import reconstruct

    _ignore_interrupts()
    data = _data(folder, "rendered", RENDERED)
    with suppress(CraternavError):
        reconstruct(data, ["smoother", "online"])


def _ignore_interrupts() -> None:
    # Ctrl-C is for the process that started this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _data(folder: Path, name: str, scenario: str) -> Dataset:
    file = folder / f"{name}.toml"
    file.write_text(scenario)
    simulate(file, folder / name)
    return Dataset.open(folder / name)
