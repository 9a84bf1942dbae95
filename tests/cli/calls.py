"""The command line, called in this process or in one of its own."""

import contextlib
import io
import subprocess
import sys
from dataclasses import dataclass
from unittest import mock

from craternav_fg.cli import main


@dataclass(frozen=True)
class Done:
    """What a command returned and printed."""

    code: int
    out: str
    err: str


def call(*arguments: object) -> Done:
    """Run the command line in this process: a new one takes seconds to import everything."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch("sys.argv", ["craternav", *map(str, arguments)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return Done(code, out.getvalue(), err.getvalue())


def craternav(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "craternav_fg", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)
