"""A campaign on disk.

campaign.toml               what is run: software, estimators, the scenario with every value (its seed and
                            the trial's number determine all randomness of a trial)
trials/trial_000012.parquet  a trial, see `craternav_fg.campaign.trial.SCHEMA`; no rows and the error in its
                            metadata if it failed
times.jsonl                 wall times, a line for each trial: the only file that another run would not
                            write the same, with the times in summary.json
summary.json                each estimator's figures over all trials
"""

import fcntl
import hashlib
import json
import os
import re
import shutil
import time
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from craternav_fg.campaign.trial import METADATA, SCHEMA, TrialResult, software
from craternav_fg.errors import InputError
from craternav_fg.files import write_whole
from craternav_fg.simulation.scenario_file import CraterFile, Scenario

FORMAT = 1
MARKER = "campaign.toml"
TRIALS = "trials"
TIMES = "times.jsonl"
SUMMARY = "summary.json"
SCRATCH = ".scratch"
_NAME = re.compile(r"trial_(\d{6,})\.parquet")
# Temporary names of `write_whole`, beside what they become.
_HALF_WRITTEN = (
    *(f".{Path(name).stem}.*{Path(name).suffix}" for name in (MARKER, TIMES, SUMMARY)),
    f"{TRIALS}/.trial_*.parquet",
)
_HEAD = (
    "# What every trial of this folder is of. Trial i draws from numpy's SeedSequence(scenario.seed, "
    "spawn_key=(i,)).\n"
)


@dataclass(frozen=True)
class Campaign:
    """A campaign read back.

    Attributes
    ----------
    path : Path
        Its folder.
    identity : dict
        What campaign.toml holds.
    table : pyarrow.Table
        All trials, in the order of their numbers: see `craternav_fg.campaign.trial.SCHEMA`.
    failed : dict of int to str
        Trials without a result, and why.
    failures : dict of int to dict
        Of the other trials: estimators that gave no trajectory, and why.
    times_s : dict of int to dict
        Wall times of each trial's parts, where they are known.
    wall_s : float
        Wall time of all runs that made it.
    """

    path: Path
    identity: dict[str, Any]
    table: pa.Table
    failed: dict[int, str]
    failures: dict[int, dict[str, str]]
    times_s: dict[int, dict[str, float]]
    wall_s: float

    @property
    def summary(self) -> dict[str, Any]:
        """What summary.json holds.

        Raises
        ------
        InputError
            When it is missing or damaged: the campaign was never brought to its end.
        """
        path = self.path / SUMMARY
        try:
            return dict(json.loads(path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            raise InputError(path, "is missing: run the campaign to its end") from None
        except ValueError as error:
            raise InputError(path, f"is damaged: {error}") from None


def identity(scenario: Scenario, estimators: tuple[str, ...]) -> dict[str, Any]:
    """Give what makes trials of the same number the same: software, estimators, scenario, its files.

    What a scenario expects of the estimators is not among it: it judges trials and changes none.
    """
    paths = [scenario.craters.path] if isinstance(scenario.craters, CraterFile) else []
    if scenario.terrain is not None and scenario.terrain.dem is not None:
        paths.append(scenario.terrain.dem)
    return {
        "format_version": FORMAT,
        "estimators": list(estimators),
        "software": software(),
        "files_sha256": {path: _digest(Path(path)) for path in paths},
        "scenario": scenario.model_dump(mode="json", exclude_none=True, exclude={"expected"}),
    }


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from None


class CampaignFolder:
    """The folder of a campaign, for the one process that writes it.

    Parameters
    ----------
    path : Path
        New, empty, or of the same campaign.
    identity : mapping
        See `identity`.

    Raises
    ------
    InputError
        When the folder is another campaign's, or no campaign's. Nothing is written.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self.path = path
        self._text = _HEAD + tomli_w.dumps(dict(identity))
        self._check()
        self._began = 0.0
        self._session = 0

    def _check(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise InputError(self.path, "expected a folder to write, found a file")
        if not self.path.is_dir():
            return
        if not (self.path / MARKER).is_file():
            # A run that was killed at once leaves hidden names of ours; others' are in nobody's way.
            if any(not entry.name.startswith(".") for entry in self.path.iterdir()):
                raise InputError(self.path, f"is not empty and holds no {MARKER}: it is not overwritten")
            return
        here, there = tomllib.loads(self._text), _read_identity(self.path)
        key = _difference(there, here)
        if key is not None:
            found, wanted = (_shown(tree, key) for tree in (there, here))
            raise InputError(
                self.path / MARKER,
                f"expected {wanted}, found {found}: the folder is another campaign's and is not overwritten",
                column=".".join(key),
            )

    def numbers(self, *, without_failed: bool = False) -> set[int]:
        """Numbers of the trials that are there."""
        paths = _trial_files(self.path)
        if not without_failed:
            return set(paths)
        return {number for number, path in paths.items() if _metadata(path)["error"] is None}

    @contextmanager
    def open(self) -> Iterator[Path]:
        """Make the folder, lock it, and clear away what a killed run left half-written.

        Yields
        ------
        Path
            A folder for temporary files, removed in the end.

        Raises
        ------
        InputError
            When another process is writing the campaign, the folder has become another's since it was looked
            at, or cannot be written.
        """
        scratch = self.path / SCRATCH
        with self._locked():
            self._check()
            shutil.rmtree(scratch, ignore_errors=True)
            for remains in _HALF_WRITTEN:
                for entry in self.path.glob(remains):
                    entry.unlink(missing_ok=True)
            # Before anything else is there: whoever finds the folder must see whose it is.
            if not (self.path / MARKER).exists():
                write_whole(self.path / MARKER, self._text.encode())
            self._begin_times()
            try:
                (self.path / TRIALS).mkdir(exist_ok=True)
                scratch.mkdir()
            except OSError as error:
                raise InputError(self.path, f"cannot be written: {error.strerror}") from error
            try:
                yield scratch
            finally:
                shutil.rmtree(scratch, ignore_errors=True)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Make the folder and hold its lock."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_RDONLY)
        except OSError as error:
            raise InputError(self.path, f"cannot be written: {error.strerror}") from error
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(self.path, "another process is running this campaign") from None
            yield
        finally:
            os.close(handle)

    def add(self, result: TrialResult) -> None:
        """Keep a trial, whole or not at all.

        Raises
        ------
        InputError
            When it cannot be written; what was written before stays.
        """
        self._append({"trial": result.number, "times_s": dict(result.times_s)})
        write_whole(self.path / TRIALS / f"trial_{result.number:06d}.parquet", result.parquet)

    def note_time(self) -> None:
        """Count the time until now as spent on the campaign."""
        self._append({})

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write summary.json."""
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        write_whole(self.path / SUMMARY, text.encode())

    def _begin_times(self) -> None:
        path = self.path / TIMES
        lines = _read_times(path)
        self._session = 1 + max((line["session"] for line in lines), default=0)
        self._began = time.perf_counter()
        if path.exists() and not path.read_bytes().endswith(b"\n"):
            # A killed run's last line, cut short.
            write_whole(path, "".join(json.dumps(line) + "\n" for line in lines).encode())

    def _append(self, values: Mapping[str, Any]) -> None:
        line = {"session": self._session, "elapsed_s": time.perf_counter() - self._began, **values}
        path = self.path / TIMES
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise InputError(path, f"cannot be written: {error.strerror}; finished trials stay") from error


def read_campaign(folder: Path | str) -> Campaign:
    """Read a campaign, finished or not.

    Raises
    ------
    InputError
        When the folder is none, or a file of it is damaged.
    """
    path = Path(folder)
    if not (path / MARKER).is_file():
        raise InputError(path, f"expected a campaign's folder, found no {MARKER} in it")
    told = _read_identity(path)
    tables, failed, failures = [], {}, {}
    for number, file in sorted(_trial_files(path).items()):
        metadata = _metadata(file)
        if metadata["error"] is not None:
            failed[number] = metadata["error"]
            continue
        failures[number] = metadata["failures"]
        tables.append(_table(file))
    lines = _read_times(path / TIMES)
    wall_s: dict[int, float] = {}
    for line in lines:
        wall_s[line["session"]] = max(line["elapsed_s"], wall_s.get(line["session"], 0.0))
    times_s = {line["trial"]: line["times_s"] for line in lines if "trial" in line}
    table = pa.concat_tables(tables) if tables else SCHEMA.empty_table()
    return Campaign(path, told, table, failed, failures, times_s, sum(wall_s.values()))


def _read_identity(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads((path / MARKER).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(path / MARKER, f"is damaged: {error}") from None


def _trial_files(path: Path) -> dict[int, Path]:
    found = ((_NAME.fullmatch(file.name), file) for file in (path / TRIALS).glob("*.parquet"))
    return {int(match[1]): file for match, file in found if match is not None}


def _metadata(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(pq.read_schema(path).metadata[METADATA]))
    except (pa.ArrowInvalid, OSError, KeyError, TypeError, ValueError) as error:
        raise _damaged(path, error) from None


def _table(path: Path) -> pa.Table:
    try:
        table = pq.read_table(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise _damaged(path, error) from None
    return table.replace_schema_metadata(None)


def _damaged(path: Path, error: Exception) -> InputError:
    said = " ".join(str(error).split())
    return InputError(path, f"is damaged: {said}; remove it, and the next run does it again")


def _read_times(path: Path) -> list[dict[str, Any]]:
    """Lines of times.jsonl; the last may be cut short."""
    lines = []
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            lines.append(json.loads(text))
        except ValueError:
            continue
    return lines


def _difference(a: Any, b: Any, key: tuple[str, ...] = ()) -> tuple[str, ...] | None:
    """Key of the first value in which two trees differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        for name in [*a, *(name for name in b if name not in a)]:
            found = _difference(a.get(name), b.get(name), (*key, name))
            if found is not None:
                return found
        return None
    return None if a == b else key


def _shown(tree: Any, key: tuple[str, ...]) -> str:
    for name in key:
        tree = None if tree is None else tree.get(name)
    if tree is None:
        return "none"
    if isinstance(tree, dict):
        return "a table"
    text = json.dumps(tree)
    return text if len(text) < 60 else f"{text[:57]}..."
