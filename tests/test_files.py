"""Inputs that are no plain files are refused in one line, before they block or fill the memory."""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from craternav_fg import files
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.foreign_table import read_headers
from craternav_fg.config import read_toml
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.images import check_image
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, entries, exists, open_input, read_bytes, replacing
from craternav_fg.tables import Column, read_table
from craternav_fg.tables.parquet import read_parquet_metadata

READERS = {
    "TOML": read_toml,
    "CSV": lambda path: read_table(path, [Column("a")]),
    "table of others": read_headers,
    "Parquet": lambda path: read_parquet_metadata(path, b""),
    "image of a data set": lambda path: check_image(path, 4, 4),
    "image": read_foreign_image,
    "elevation model": read_dem,
}


@pytest.fixture
def nobody() -> Iterator[None]:
    """Files are read as by another user, where the tests run as root."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def fifo(path: Path) -> None:
    os.mkfifo(path)


def zeros(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listener(path: Path) -> None:
    # The name of a socket is short, and its folder's is not.
    here = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(path.name)
    finally:
        os.chdir(here)


def sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(20 << 30)


KINDS = {
    "a pipe": (fifo, "expected a file, found a pipe"),
    "/dev/zero": (zeros, "expected a file, found a device"),
    "a socket": (listener, "expected a file, found a socket or a device"),
    "a folder": (Path.mkdir, "expected a file, found a folder"),
    "20 GB": (sparse, "MiB, found 20480"),
    "a loop": (lambda path: path.symlink_to(path), "cannot be read: Too many levels of symbolic links"),
    "nothing": (lambda path: None, "file is missing"),
    "a link to nothing": (lambda path: path.symlink_to("nowhere"), "file is missing"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused(reader: str, kind: str, tmp_path: Path) -> None:
    make, problem = KINDS[kind]
    path = tmp_path / "in"
    make(path)
    with pytest.raises(InputError) as raised:
        READERS[reader](path)
    assert str(raised.value).startswith(f"{path}: ")
    assert problem in str(raised.value)


@pytest.mark.usefixtures("nobody")
def test_what_may_not_be_read_is_refused() -> None:
    # The folder of a temporary path is closed to others, the one of passwords is not.
    with pytest.raises(InputError, match=r"/etc/shadow: cannot be read: Permission denied"):
        read_bytes(Path("/etc/shadow"), SizeLimit.JSON)


def test_a_folder_that_may_not_be_read_is_not_empty(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    closed = tmp_path / "closed"
    (closed / "within").mkdir(parents=True)
    closed.chmod(0)
    request.getfixturevalue("nobody")
    try:
        with pytest.raises(InputError, match="cannot be read: Permission denied"):
            entries(closed)
        with pytest.raises(InputError, match="cannot be read: Permission denied"):
            exists(closed / "within")
    finally:
        if os.getuid() == 0:
            os.seteuid(0)
        closed.chmod(0o755)


def test_a_name_with_a_zero_byte_is_refused() -> None:
    with pytest.raises(InputError, match="embedded null"), open_input(Path("a\0b"), SizeLimit.JSON):
        pass


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(bytes(SizeLimit.SETTINGS))
    assert len(read_bytes(path, SizeLimit.SETTINGS)) == SizeLimit.SETTINGS
    path.write_bytes(bytes(SizeLimit.SETTINGS + 1))
    with pytest.raises(InputError, match="expected at most 1 MiB, found 1"):
        read_bytes(path, SizeLimit.SETTINGS)


def killed_while_writing(folder: Path, what: str) -> None:
    """Let a process begin to write a file or folder, and kill it."""
    code = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from craternav_fg.files import replacing, replacing_folder\n"
        f"with {what} as temporary:\n"
        "    print(temporary, flush=True)\n"
        "    time.sleep(60)\n"
    )
    command = [sys.executable, "-c", code, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        left = Path(process.stdout.readline().strip())
        # As long as it is written, nobody clears it.
        os.utime(left, (1e9, 1e9))
        files._cleared.clear()
        with replacing(folder / "another") as temporary:
            temporary.write_text("x")
        assert left.exists()
        process.kill()
    os.utime(left, (1e9, 1e9))


@pytest.mark.parametrize(
    "what",
    [
        "replacing(Path(sys.argv[1]) / 'out.csv')",
        "replacing_folder(Path(sys.argv[1]) / 'run', marker='run.toml', ours=())",
    ],
)
def test_what_a_killed_process_leaves_is_cleared_by_the_next(what: str, tmp_path: Path) -> None:
    killed_while_writing(tmp_path, what)
    mine = tmp_path / ".settings.of-mine"
    mine.write_text("kept")
    assert len(list(tmp_path.iterdir())) == 3
    files._cleared.clear()
    with replacing(tmp_path / "another") as temporary:
        temporary.write_text("x")
    assert sorted(tmp_path.iterdir()) == [mine, tmp_path / "another"]


def test_a_folder_that_was_being_replaced_is_kept_when_it_is_the_last(tmp_path: Path) -> None:
    last = tmp_path / ".run.craternav-abcdefgh.old"
    last.mkdir()
    os.utime(last, (1e9, 1e9))
    files._cleared.clear()
    with replacing(tmp_path / "another") as temporary:
        temporary.write_text("x")
    assert last.exists()
    (tmp_path / "run").mkdir()
    files._cleared.clear()
    with replacing(tmp_path / "another") as temporary:
        temporary.write_text("x")
    assert not last.exists()
