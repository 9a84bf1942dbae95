"""The folder of a detection: which options it was made with, and what is done already."""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, entries, exists, read_bytes, write_whole

MARKER = "detection.json"
RIMS = "rims"
WINDOWS = "windows"
# Temporary files of the workers; removed at the end.
_SCRATCH = ".scratch"
_OURS = (MARKER, RIMS, WINDOWS, "summary.csv", "rims.csv", "overlay.png", "catalog.parquet")


class DetectionFolder:
    """The folder of a detection, for the one process that writes it.

    Parameters
    ----------
    path : Path
        New, empty, or of the same detection, complete or not.
    options : mapping
        Everything but the images that determines a result; JSON.
    force : bool
        Remove what was detected before, with the same options or with others.

    Raises
    ------
    InputError
        When the folder was made with other options and `force` is not set, or is no detection's. Nothing is
        written.
    """

    def __init__(self, path: Path, options: Mapping[str, Any], *, force: bool = False) -> None:
        self.path = path
        self._options = json.loads(json.dumps(options))
        self._force = force
        self._replaced = self._check()

    def _check(self) -> bool:
        """Refuse a folder that is not this detection's; true when its results are to be replaced."""
        if exists(self.path) and not self.path.is_dir():
            raise InputError(self.path, "expected a folder to write, found a file")
        if not self.path.is_dir():
            return False
        marker = self.path / MARKER
        if not exists(marker):
            # Hidden files are of a run that was killed at once, or in nobody's way.
            if any(not entry.name.startswith(".") for entry in entries(self.path)):
                raise InputError(self.path, f"is not empty and holds no {MARKER}: it is not overwritten")
            return False
        if self._force:
            return True
        found = read_record(marker)
        if found == self._options:
            return False
        if found is None:
            raise InputError(marker, "is damaged: use --force to detect anew")
        names = [*self._options, *(name for name in found if name not in self._options)]
        name = next(name for name in names if found.get(name) != self._options.get(name))
        there, here = (json.dumps(tree.get(name)) for tree in (found, self._options))
        raise InputError(
            self.path,
            f"was made with {name} {there}, not {here}: use --force to detect anew, or another folder",
        )

    @contextmanager
    def open(self) -> Iterator[Path]:
        """Make the folder and lock it.

        Yields
        ------
        Path
            A folder for temporary files, removed at the end.

        Raises
        ------
        InputError
            When another process is writing the folder, or it cannot be written.
        """
        scratch = self.path / _SCRATCH
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_RDONLY)
        except OSError as error:
            raise InputError(self.path, f"cannot be written: {error.strerror}") from error
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(self.path, "another process is writing this folder") from None
            self._begin(scratch)
            try:
                yield scratch
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
        finally:
            os.close(handle)

    def _begin(self, scratch: Path) -> None:
        try:
            if self._replaced:
                # The marker goes last: a killed run leaves a folder that is still known as a detection's.
                for name in reversed(_OURS):
                    old = self.path / name
                    shutil.rmtree(old) if old.is_dir() else old.unlink(missing_ok=True)
            shutil.rmtree(scratch, ignore_errors=True)
            scratch.mkdir()
        except OSError as error:
            raise InputError(self.path, f"cannot be written: {error.strerror}") from error
        # First of all, so that the folder always says how its results were made.
        write_record(self.path / MARKER, self._options)

    def write(self, name: str, content: bytes) -> None:
        """Save a file, whole or not at all.

        Parameters
        ----------
        name : str
            Path in the folder.
        content : bytes

        Raises
        ------
        InputError
            When it cannot be written.
        """
        path = self.path / name
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(path.parent, f"cannot be written: {error.strerror}") from error
        write_whole(path, content)


def source_of(path: Path) -> dict[str, Any]:
    """Return what tells whether a file is still the same.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict
        Name, size and time of the last change.

    Raises
    ------
    InputError
        When there is no such file.
    """
    try:
        about = path.stat()
    except (OSError, ValueError) as error:
        problem = "file is missing" if isinstance(error, FileNotFoundError) else f"cannot be read: {error}"
        raise InputError(path, problem) from None
    return {"name": path.name, "size": about.st_size, "mtime_ns": about.st_mtime_ns}


def read_record(path: Path) -> dict[str, Any] | None:
    """Read a JSON object.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict or None
        None when the file is missing or damaged.
    """
    try:
        values = json.loads(read_bytes(path, SizeLimit.JSON))
    except (InputError, ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None


def write_record(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object.

    Parameters
    ----------
    path : Path
    values : mapping

    Raises
    ------
    InputError
        When it cannot be written.
    """
    write_whole(path, (json.dumps(values, indent=1, allow_nan=False) + "\n").encode())
