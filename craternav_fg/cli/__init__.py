"""The command line `craternav`: a module for each group of commands."""

import gc
import os

from craternav_fg.cli.ending import ended_by_a_signal, leave, one_line_endings


def main() -> None:
    """Run the command line: a known error is one line on stderr and exit code 2."""
    # Our matrices are small: threads of linear algebra would wait for each other most of the time, and keep
    # the cores busy meanwhile. It is read when numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Until the command's modules are imported: all of them stay, and the search for garbage takes a twentieth
    # of a short command's time.
    gc.disable()
    try:
        with one_line_endings():
            # Ctrl-C during the import ends in one line, too.
            from craternav_fg.cli.app import run

            run()
    except SystemExit as end:
        if ended_by_a_signal(end):
            leave(end)
        raise
    finally:
        gc.enable()
