"""Files that are whole or absent: written under a temporary name, then renamed."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from craternav_fg.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write; on success it takes the final name, on failure it is removed.

    Parameters
    ----------
    path : Path
        Final name of the file; its folder is made when missing.

    Yields
    ------
    Path
        Temporary name in the same folder, with the same suffix.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    temporary.chmod(0o644)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: Path, *, marker: str) -> Iterator[Path]:
    """Give a temporary folder to fill; on success it replaces the folder of the final name.

    Parameters
    ----------
    path : Path
        Final name. A folder of that name is replaced only when it is empty or holds `marker`.
    marker : str
        Name of a file that tells that the folder was written by us.

    Yields
    ------
    Path
        Temporary folder beside the final one.

    Raises
    ------
    InputError
        When `path` is a file, or a folder of somebody else's.
    """
    if path.exists() and not path.is_dir():
        raise InputError(path, "expected a folder to write, found a file")
    if path.is_dir() and any(path.iterdir()) and not (path / marker).is_file():
        raise InputError(path, f"is not empty and holds no {marker}: it is not overwritten")
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    temporary.chmod(0o755)
    try:
        yield temporary
        if path.exists():
            shutil.rmtree(path)
        temporary.replace(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
