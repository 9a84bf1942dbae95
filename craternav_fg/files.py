"""Reading and writing of files.

Every reader opens its file through `open_input`, or calls `check_input` before a library opens it: a regular
file, readable, and no larger than its kind may be. Files and folders are written whole or not at all: under a
temporary name that is then changed.
"""

import errno
import fcntl
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from enum import IntEnum
from io import BufferedReader
from pathlib import Path

from craternav_fg.errors import InputError

# Errors of a disk without room.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# In temporary names, before eight random letters; and the end of those of folders about to be removed.
_TEMPORARY = ".craternav-"
_FORMER = ".old"
# Age of a temporary file before which its process may not have locked it yet.
_BEING_MADE_S = 2.0
# Folders in which this process has looked for temporary files of others.
_cleared: set[Path] = set()
_OTHER_KINDS = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))


class SizeLimit(IntEnum):
    """Largest accepted size of an input file in bytes, by what it holds."""

    SETTINGS = 1 << 20
    """TOML and YAML."""
    JSON = 1 << 26
    """JSON, and JSON by lines."""
    TABLE = 1 << 30
    """CSV and Parquet."""
    ARCHIVE = 1 << 31
    """NumPy archives."""
    IMAGE = 1 << 28
    """Images."""
    RASTER = 1 << 31
    """Elevation models."""
    BAG = 1 << 44
    """Bags, which are read message by message."""
    KERNEL = 1 << 44
    """SPICE's binary kernels, which are read where they are asked."""
    TEXT_KERNEL = 1 << 26
    """SPICE's text kernels, which are read whole: 80 MB take a second."""


@contextmanager
def open_input(path: Path, limit: SizeLimit) -> Iterator[BufferedReader]:
    """Open an input file.

    Parameters
    ----------
    path : Path
    limit : SizeLimit
        For what the file is to hold.

    Yields
    ------
    BufferedReader

    Raises
    ------
    InputError
        When the file is missing, is not a regular file (a folder, a pipe, a device), cannot be read, or is
        larger than `limit`.
    """
    try:
        # A pipe without a writer would otherwise block.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise _unread(path, error) from None
    except ValueError as error:
        # A zero byte in the name.
        raise InputError(ascii(str(path)), f"cannot be read: {error}") from None
    try:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode):
            found = next((name for is_kind, name in _OTHER_KINDS if is_kind(about.st_mode)), "a device")
            raise InputError(path, f"expected a file, found {found}")
        if about.st_size > limit:
            raise InputError(path, f"expected at most {limit >> 20} MiB, found {about.st_size >> 20}")
        stream = os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise
    with stream:
        yield stream


def check_input(path: Path, limit: SizeLimit) -> None:
    """Check a file that a library is to open by its name.

    Parameters
    ----------
    path : Path
    limit : SizeLimit
        For what the file is to hold.

    Raises
    ------
    InputError
        As `open_input`.
    """
    with open_input(path, limit):
        pass


def read_bytes(path: Path, limit: SizeLimit) -> bytes:
    """Read a whole file.

    Parameters
    ----------
    path : Path
    limit : SizeLimit
        For what the file is to hold.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        As `open_input`.
    """
    with open_input(path, limit) as stream:
        try:
            return stream.read(limit)
        except OSError as error:
            raise _unread(path, error) from None


def exists(path: Path) -> bool:
    """Return whether there is a file or folder of a name, whatever it is.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
        Also true for a link that leads nowhere.

    Raises
    ------
    InputError
        When this cannot be told, as for a folder that may not be searched.
    """
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise _unread(path, error) from None
    return True


def entries(folder: Path) -> list[Path]:
    """List a folder.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Path
        Ordered by name.

    Raises
    ------
    InputError
        When it is missing, is not a folder, or cannot be read.
    """
    try:
        return sorted(folder.iterdir())
    except FileNotFoundError:
        raise InputError(folder, "folder is missing") from None
    except NotADirectoryError:
        raise InputError(folder, "expected a folder, found a file") from None
    except OSError as error:
        raise _unread(folder, error) from None


def _unread(path: Path, error: OSError) -> InputError:
    """Explain why a file cannot be read."""
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return InputError(path, "file is missing")
    if error.errno == errno.ENXIO:
        return InputError(path, "expected a file, found a socket or a device")
    return InputError(path, f"cannot be read: {error.strerror or error}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide a temporary path to write; on success it takes the final name, on failure it is removed.

    Parameters
    ----------
    path : Path
        Final name of the file; its folder is made when missing.

    Yields
    ------
    Path
        Temporary name in the same folder, with the same suffix.

    Raises
    ------
    InputError
        When `path` is a folder or cannot be written, as on a full disk.
    """
    try:
        if path.is_dir():
            raise InputError(path, "expected a file to write, found a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        _clear(path.parent)
        prefix = f".{path.stem}{_TEMPORARY}"
        handle, name = tempfile.mkstemp(prefix=prefix, suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise _unwritten(path, error) from error
    temporary = Path(name)
    try:
        _lock(handle)
        temporary.chmod(0o644)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _unwritten(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)


@contextmanager
def replacing_folder(path: Path, *, marker: str, ours: Sequence[str]) -> Iterator[Path]:
    """Provide a temporary folder to fill; on success it replaces the folder of the final name.

    Parameters
    ----------
    path : Path
        Final name. An existing folder is replaced only when it is empty, or holds `marker` and nothing but
        names in `ours`.
    marker : str
        Name of a file by which a folder is recognised as written by this package.
    ours : sequence of str
        Patterns of all names that such a folder may hold.

    Yields
    ------
    Path
        Temporary folder beside the final one.

    Raises
    ------
    InputError
        When `path` is a file, the current folder, or a folder that holds anything else; these are noticed
        before anything is written. Also when it cannot be written, as on a full disk.
    """
    try:
        final = path.resolve()
        _check(path, final, marker, ours)
        final.parent.mkdir(parents=True, exist_ok=True)
        _clear(final.parent)
        temporary = Path(tempfile.mkdtemp(prefix=f".{final.name}{_TEMPORARY}", dir=final.parent))
        handle = os.open(temporary, os.O_RDONLY)
    except RuntimeError:
        # What `resolve` raises for links that lead to each other.
        raise InputError(path, f"cannot be written: {os.strerror(errno.ELOOP)}") from None
    except OSError as error:
        raise _unwritten(path, error) from error
    try:
        _lock(handle)
        temporary.chmod(0o755)
        yield temporary
        old = temporary.with_name(f"{temporary.name}{_FORMER}")
        if final.exists():
            final.replace(old)
        temporary.replace(final)
        shutil.rmtree(old, ignore_errors=True)
    except InputError as error:
        # The error names a file in the temporary folder, which the user does not know.
        if isinstance(error.__cause__, OSError) and error.path.is_relative_to(temporary):
            raise _unwritten(path, error.__cause__) from error
        raise
    except OSError as error:
        # Other errors need not be of this folder: the caller may also read files meanwhile.
        if error.errno in _FULL:
            raise _unwritten(path, error) from error
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        os.close(handle)


def _lock(handle: int) -> bool:
    """Lock a temporary file or folder as long as this process lives.

    False when another process has locked it, or the file system has no locks.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _clear(folder: Path) -> None:
    """Remove what processes that were killed have left in a folder: temporary names that none has locked.

    Each process looks once into a folder.
    """
    if folder in _cleared:
        return
    _cleared.add(folder)
    for left in folder.glob(f".*{_TEMPORARY}*"):
        with suppress(OSError):
            # The former contents of a folder that was being replaced are the last ones, if it is missing.
            name = left.name[1:].rpartition(_TEMPORARY)[0]
            if left.name.endswith(_FORMER) and not (folder / name).exists():
                continue
            handle = os.open(left, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if _lock(handle) and time.time() - os.fstat(handle).st_mtime > _BEING_MADE_S:
                    shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink()
            finally:
                os.close(handle)


def _unwritten(path: Path, error: OSError) -> InputError:
    """Say that a file or folder cannot be written, by the system's text: some libraries replace it."""
    reason = error.strerror if error.errno is None else os.strerror(error.errno)
    return InputError(path, f"cannot be written: {reason or error}")


def _check(path: Path, final: Path, marker: str, ours: Sequence[str]) -> None:
    if final == Path.cwd():
        raise InputError(path, "is the current folder, which cannot be replaced: name another")
    if final.exists() and not final.is_dir():
        raise InputError(path, "expected a folder to write, found a file")
    if not final.is_dir():
        return
    names = sorted(entry.name for entry in final.iterdir())
    if names and marker not in names:
        raise InputError(path, f"is not empty and holds no {marker}: it is not overwritten")
    foreign = [name for name in names if not any(Path(name).match(pattern) for pattern in ours)]
    if foreign:
        raise InputError(path, f"holds {foreign[0]}, which would be lost: it is not overwritten")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all even after a power cut.

    Parameters
    ----------
    path : Path
        Its folder must exist.
    content : bytes

    Raises
    ------
    InputError
        When it cannot be written, as on a full disk; a file of that name stays what it was.
    """
    try:
        with replacing(path) as temporary, temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise _unwritten(path, error) from error
