"""Refinement in chunks of craters: on all cores or a Dask cluster, resumed after an interruption.

Each finished chunk is written to a folder beside the result. A later refinement of the same catalogue, model
and options takes it from there.
"""

import hashlib
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from os import cpu_count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from craternav_fg.catalogs.dem import Dem, read_dem
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import CraternavError
from craternav_fg.files import replacing
from craternav_fg.mapping.measured_rim import Found, MeasuredRim, Outcome
from craternav_fg.mapping.refine import (
    Progress,
    RefinedRims,
    RefineOptions,
    collect,
    measure_rims,
    with_model_heights,
)
from craternav_fg.workers import Workers, each_result

# Craters of a chunk: some seconds of work.
CHUNK = 512


class DemFile(NamedTuple):
    """Where workers find the elevation model."""

    path: str
    """Absolute."""
    unit_m: float
    """Unit of its values, m."""
    radius_m: float
    """Radius of the body."""

    def read(self) -> Dem:
        """Read the model."""
        return read_dem(Path(self.path), self.unit_m, self.radius_m, gaps=True)


class _Task(NamedTuple):
    """A chunk as a worker gets it."""

    key: int
    model: DemFile
    options: RefineOptions
    craters: Catalog


@cache
def _model(file: DemFile) -> Dem:
    return file.read()


def _run(task: _Task) -> tuple[int, list[Found]]:
    """Measure the rims of a chunk on a worker."""
    return task.key, measure_rims(task.craters, _model(task.model), task.options)


@dataclass(frozen=True)
class KeptChunks:
    """Results of finished chunks in a folder.

    Attributes
    ----------
    folder : Path
        It belongs to one catalogue, model and set of options.
    """

    folder: Path

    @classmethod
    def beside(cls, output: Path, catalog: Catalog, model: DemFile, options: RefineOptions) -> "KeptChunks":
        """Open the results that are kept beside a file to write.

        Parameters
        ----------
        output : Path
        catalog : Catalog
        model : DemFile
        options : RefineOptions

        Returns
        -------
        KeptChunks
            Empty unless the catalogue, the model and the options are the same as then.
        """
        stat = Path(model.path).stat()
        digest = hashlib.sha256(repr((*model, stat.st_size, stat.st_mtime_ns, options, CHUNK)).encode())
        for name in (
            "latitude_rad",
            "longitude_rad",
            "semi_major_m",
            "semi_minor_m",
            "angle_rad",
            "height_m",
        ):
            digest.update(np.ascontiguousarray(getattr(catalog, name)).tobytes())
        if catalog.plane_tilt_rad is not None:
            digest.update(np.ascontiguousarray(catalog.plane_tilt_rad).tobytes())
        return cls(output.parent / f".{output.stem}.{digest.hexdigest()[:16]}.chunks")

    def read(self, key: int) -> list[Found] | None:
        """Read a chunk's results; None when it is not finished.

        Parameters
        ----------
        key : int
            Number of the chunk.
        """
        path = self.folder / f"{key}.npz"
        if not path.is_file():
            return None
        with np.load(path) as data:
            outcomes, numbers = data["outcomes"], data["numbers"]
        kinds = list(Outcome)
        return [
            MeasuredRim.of_numbers(row) if kinds[code] is Outcome.REFINED else kinds[code]
            for code, row in zip(outcomes.tolist(), numbers, strict=True)
        ]

    def write(self, key: int, found: Sequence[Found]) -> None:
        """Write a chunk's results.

        Parameters
        ----------
        key : int
            Number of the chunk.
        found : sequence of MeasuredRim or Outcome
        """
        kinds = list(Outcome)
        numbers = np.zeros((len(found), MeasuredRim.NUMBERS))
        outcomes = np.zeros(len(found), dtype=np.int64)
        for row, one in enumerate(found):
            if isinstance(one, MeasuredRim):
                numbers[row], outcomes[row] = one.numbers(), kinds.index(Outcome.REFINED)
            else:
                outcomes[row] = kinds.index(one)
        with replacing(self.folder / f"{key}.npz") as path:
            np.savez(path, outcomes=outcomes, numbers=numbers)

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


def refine_in_chunks(
    catalog: Catalog,
    model: DemFile,
    options: RefineOptions,
    kept: KeptChunks,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> RefinedRims:
    """Measure the rims of a catalogue on an elevation model, and keep what is finished.

    Parameters
    ----------
    catalog : Catalog
    model : DemFile
    options : RefineOptions
    kept : KeptChunks
    progress : callable, optional
        Called with the number of craters done and of all.
    workers : Workers, optional
        By default threads of this process, one per core.

    Returns
    -------
    RefinedRims
        The same, to the bit, as without an interruption.

    Raises
    ------
    InputError
        When the model is wrong, or a result cannot be written.
    CraternavError
        When the scheduler is lost, or workers cannot read the model.
    """
    dem = _model(model)
    known = with_model_heights(catalog, dem)
    n = len(catalog)
    parts = {key: np.arange(first, min(first + CHUNK, n)) for key, first in enumerate(range(0, n, CHUNK))}
    found = {key: part for key in parts if (part := kept.read(key)) is not None}
    done = sum(len(part) for part in found.values())

    def finished(key: int, part: list[Found]) -> None:
        nonlocal done
        kept.write(key, part)
        found[key] = part
        done += len(part)
        if progress is not None:
            progress(done, n)

    tasks = {
        key: _Task(key, model, options, known.take(rows)) for key, rows in parts.items() if key not in found
    }
    if workers is None:
        with ThreadPoolExecutor(cpu_count()) as threads:
            for key, part in threads.map(_run, tasks.values()):
                finished(key, part)
    else:
        for key, part in each_result(workers, _run, tasks, _died, "chunks"):
            finished(key, part)
    return collect(catalog, dem, [one for key in parts for one in found[key]])


def _died(key: int) -> tuple[int, list[Found]]:
    raise CraternavError(f"chunk {key}: its workers died twice; finished chunks are kept")
