"""Write a campaign's folder."""

import fcntl
import hashlib
import json
import os
import shutil
import time
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import tomli_w

from craternav_fg.campaign.read import read_identity, read_metadata, read_times, trial_files
from craternav_fg.campaign.store import FORMAT, MARKER, SCRATCH, SUMMARY, TIMES, TRIALS, trial_name
from craternav_fg.campaign.trial import TrialResult, software
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, entries, exists, open_input, read_bytes, write_whole
from craternav_fg.simulation.scenario_file import Scenario

# Temporary names of `write_whole`: what a killed run leaves behind.
_HALF_WRITTEN = (
    *(f".{Path(name).stem}.*{Path(name).suffix}" for name in (MARKER, TIMES, SUMMARY)),
    f"{TRIALS}/.trial_*.parquet",
)
_HEAD = (
    "# What every trial of this folder runs. Trial i draws its random numbers from "
    "numpy's SeedSequence(scenario.seed, spawn_key=(i,)).\n"
)
# Longest value that an error message shows.
_MAX_SHOWN = 60


def identity(scenario: Scenario, estimators: tuple[str, ...]) -> dict[str, Any]:
    """Return everything that determines the result of a trial but its number.

    These are the software, the estimators, the scenario and the files that it names. The figures that a
    scenario expects are left out, as they change no trial.

    Parameters
    ----------
    scenario : Scenario
    estimators : tuple of str

    Returns
    -------
    dict
        Contents of campaign.toml.

    Raises
    ------
    InputError
        When a file that the scenario names cannot be read.
    """
    paths = list(scenario.files())
    return {
        "format_version": FORMAT,
        "estimators": list(estimators),
        "software": software(),
        "files_sha256": {path: _digest(Path(path)) for path in paths},
        "scenario": scenario.model_dump(mode="json", exclude_none=True, exclude={"expected"}),
    }


def _digest(path: Path) -> str:
    with open_input(path, SizeLimit.RASTER) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
        if not exists(self.path / MARKER):
            # Hidden files are of a run that was killed at once, or in nobody's way.
            if any(not entry.name.startswith(".") for entry in entries(self.path)):
                raise InputError(self.path, f"is not empty and holds no {MARKER}: it is not overwritten")
            return
        here, there = tomllib.loads(self._text), read_identity(self.path)
        key = _difference(there, here)
        if key is not None:
            found, wanted = (_shown(tree, key) for tree in (there, here))
            raise InputError(
                self.path / MARKER,
                f"expected {wanted}, found {found}: the folder is another campaign's and is not overwritten",
                column=".".join(key),
            )

    def numbers(self, *, without_failed: bool = False) -> set[int]:
        """Return the numbers of the trials in the folder."""
        paths = trial_files(self.path)
        if not without_failed:
            return set(paths)
        return {number for number, path in paths.items() if read_metadata(path)["error"] is None}

    @contextmanager
    def open(self) -> Iterator[Path]:
        """Make the folder, lock it, and remove what a killed run left half-written.

        Yields
        ------
        Path
            A folder for temporary files, removed at the end.

        Raises
        ------
        InputError
            When another process is writing the campaign, or the folder has become another campaign's in the
            meantime, or cannot be written.
        """
        scratch = self.path / SCRATCH
        with self._locked():
            self._check()
            shutil.rmtree(scratch, ignore_errors=True)
            for remains in _HALF_WRITTEN:
                for entry in self.path.glob(remains):
                    entry.unlink(missing_ok=True)
            # First of all, so that the folder always says which campaign it belongs to.
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
        """Save a trial, whole or not at all.

        Parameters
        ----------
        result : TrialResult

        Raises
        ------
        InputError
            When it cannot be written; earlier trials stay.
        """
        self._append({"trial": result.number, "times_s": dict(result.times_s)})
        write_whole(self.path / TRIALS / trial_name(result.number), result.parquet)

    def note_time(self) -> None:
        """Add the time until now to that of the campaign."""
        self._append({})

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write summary.json."""
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        write_whole(self.path / SUMMARY, text.encode())

    def _begin_times(self) -> None:
        path = self.path / TIMES
        lines = read_times(path)
        self._session = 1 + max((line["session"] for line in lines), default=0)
        self._began = time.perf_counter()
        text = "".join(json.dumps(line) + "\n" for line in lines)
        # A killed run cuts its last line short; other lines may not be ours.
        with suppress(InputError):
            if exists(path) and read_bytes(path, SizeLimit.JSON) != text.encode():
                write_whole(path, text.encode())

    def _append(self, values: Mapping[str, Any]) -> None:
        line = {"session": self._session, "elapsed_s": time.perf_counter() - self._began, **values}
        # Times change no result: a file that cannot be written must not stop the campaign.
        with suppress(OSError):
            handle = os.open(self.path / TIMES, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o644)
            with os.fdopen(handle, "a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


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
    """Write the value of a key for an error message."""
    for name in key:
        tree = None if tree is None else tree.get(name)
    if tree is None:
        return "none"
    if isinstance(tree, dict):
        return "a table"
    text = json.dumps(tree)
    return text if len(text) < _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."
