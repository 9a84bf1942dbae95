"""Detect the rims of many images: tables and overlays in a folder, each image on one core."""

import csv
import io
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craternav_fg.dataset.ellipses import detections_as_plain_data, write_detected_ellipses
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.detection.folder import RIMS, DetectionFolder, read_record, source_of
from craternav_fg.detection.settings import DetectionSettings, use_one_thread
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.detect import FoundRims
from craternav_fg.workers import MAX_WORKER_DEATHS, Workers, cluster, each_result, processes

# Called with the name of a step, the number of its parts that are done, and their total.
Progress = Callable[[str, int, int], None]
SUMMARY = "summary.csv"
_COLUMNS = ("image", "rims", "sun_deg", "sun_probability", "seconds", "warning", "error")


@dataclass(frozen=True)
class Where:
    """Who does the work.

    Attributes
    ----------
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do it instead.
    """

    workers: int
    scheduler: str | None = None


@dataclass(frozen=True)
class _Task:
    path: str
    settings: DetectionSettings


@dataclass(frozen=True)
class _Result:
    path: str
    record: dict[str, Any]
    table: bytes = b""
    overlay: bytes = b""


def detect_images(
    paths: Sequence[Path],
    folder: Path,
    settings: DetectionSettings,
    where: Where,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Detect the rims of images; an image that is done already, and has not changed, is passed over.

    For each image the folder gets the table and the overlay of `craternav detect`, and a record in JSON with
    the standard deviations; for all of them summary.csv.

    Parameters
    ----------
    paths : sequence of Path
        Image files; their names must differ.
    folder : Path
        New, empty, or of a detection with the same options.
    settings : DetectionSettings
    where : Where
    force : bool
        Replace all results of the folder, whatever their options.
    progress : callable, optional

    Returns
    -------
    list of dict
        The rows of the summary, in the order of the images: `image`, `rims`, `sun_deg`, `sun_probability`,
        `seconds`, `warning`, `error`.

    Raises
    ------
    InputError
        When two images have one name, or the folder has results of other options, or cannot be written. An
        image that cannot be read is an `error` in its row.
    CraternavError
        When the scheduler cannot be reached or is lost. Finished images are kept.
    """
    named: dict[str, Path] = {}
    for path in paths:
        if path.stem in named:
            problem = f"has the name of {named[path.stem]}, as far as its ending: use another folder for one"
            raise InputError(path, problem)
        named[path.stem] = path
    store = DetectionFolder(folder, {"kind": "images", **settings.identity()}, force=force)
    with ExitStack() as stack:
        # Before the folder is made, so that a scheduler that does not answer leaves nothing behind.
        workers = None if where.scheduler is None else stack.enter_context(cluster(where.scheduler))
        scratch = stack.enter_context(store.open())
        records = {str(path): _done(folder, path) for path in paths}
        missing = {path: _Task(path, settings) for path, record in records.items() if record is None}
        done = len(paths) - len(missing)
        if progress is not None:
            progress("images", done, len(paths))
        if missing and workers is None:
            workers = stack.enter_context(processes(min(where.workers, len(missing)), scratch))
        for result in _results(workers, missing):
            records[result.path] = result.record
            if "error" not in result.record:
                stem = f"{RIMS}/{Path(result.path).stem}"
                store.write(f"{stem}.csv", result.table)
                store.write(f"{stem}_overlay.png", result.overlay)
                # Last, as it marks the image as done.
                store.write(f"{stem}.json", (json.dumps(result.record, indent=1) + "\n").encode())
            done += 1
            if progress is not None:
                progress("images", done, len(paths))
        rows = [_row(path, records[path]) for path in map(str, paths)]
        store.write(SUMMARY, _table(rows))
    return rows


def _results(workers: Workers | None, tasks: dict[str, _Task]) -> Iterator[_Result]:
    if workers is None or not tasks:
        return iter(())

    def died(path: str) -> _Result:
        return _Result(path, {"error": f"its worker died {MAX_WORKER_DEATHS} times: too little memory?"})

    return each_result(workers, _detect, tasks, died, "images")


def _done(folder: Path, path: Path) -> dict[str, Any] | None:
    """Record of an image whose results are in the folder; None when they are not, or the image is another."""
    try:
        source = source_of(path)
    except InputError:
        return None
    record = read_record(folder / RIMS / f"{path.stem}.json")
    whole = all((folder / RIMS / f"{path.stem}{end}").is_file() for end in (".csv", "_overlay.png"))
    return record if whole and record is not None and record.get("source") == source else None


def _detect(task: _Task) -> _Result:
    """Do one image; a worker calls this."""
    use_one_thread()
    path = Path(task.path)
    try:
        source = source_of(path)
        pixels = read_foreign_image(path, opacity=True)
        began_s = time.perf_counter()
        rims = task.settings.detect(pixels, task.settings.sun_rad)
        seconds = time.perf_counter() - began_s
        with tempfile.TemporaryDirectory() as scratch:
            table, overlay = Path(scratch) / "rims.csv", Path(scratch) / "overlay.png"
            write_detected_ellipses(table, rims.ellipses_px, rims.traced, path.name)
            write_overlay(overlay, pixels, rims)
            record = {"source": source, "seconds": round(seconds, 3), **rims_as_plain_data(rims)}
            return _Result(task.path, record, table.read_bytes(), overlay.read_bytes())
    except CraternavError as error:
        return _Result(task.path, {"error": str(error)})
    except MemoryError:
        return _Result(task.path, {"error": f"{path}: too little memory"})


def rims_as_plain_data(rims: FoundRims) -> dict[str, Any]:
    """Return what was found in an image, for JSON.

    Parameters
    ----------
    rims : FoundRims

    Returns
    -------
    dict
        `sun_probability`, `sun_angle_deg`, `warning` (None without one), and `rims`, see
        `dataset.ellipses.detections_as_plain_data`.
    """
    values = detections_as_plain_data(
        rims.ellipses_px, rims.covariance_px, rims.quality, rims.traced, rims.sun_angle_rad
    )
    sure = None if math.isnan(rims.sun_probability) else round(rims.sun_probability, 4)
    return {"sun_probability": sure, "warning": sun_warning(rims), **values}


def sun_warning(rims: FoundRims) -> str | None:
    """Warn of a direction of the sun that was given and that the craters contradict.

    Parameters
    ----------
    rims : FoundRims

    Returns
    -------
    str or None
        None when they do not contradict it.
    """
    if not rims.sun_contradicted:
        return None
    given, seen = (math.degrees(a) % 360.0 for a in (rims.sun_angle_rad, rims.seen_sun_angle_rad))
    return (
        f"the sun is given at {given:.0f} deg in the image, but its craters look lit from {seen:.0f} deg; "
        "omit --sun-deg to estimate it from the image"
    )


def _row(path: str, record: dict[str, Any] | None) -> dict[str, Any]:
    values = record or {}
    return {
        "image": path,
        "rims": len(values["rims"]) if "rims" in values else None,
        "sun_deg": None if values.get("sun_angle_deg") is None else round(values["sun_angle_deg"] % 360.0, 1),
        **{name: values.get(name) for name in _COLUMNS[3:]},
    }


def _table(rows: Sequence[dict[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if value is None else value for name, value in row.items()} for row in rows)
    return text.getvalue().encode()
