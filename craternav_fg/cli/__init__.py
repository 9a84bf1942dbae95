"""The command line `craternav`: a module for each group of commands."""

from craternav_fg.cli.ending import one_line_endings


def main() -> None:
    """Run the command line: a known error is one line on stderr and exit code 2."""
    with one_line_endings():
        # Ctrl-C during the import ends in one line, too.
        from craternav_fg.cli.app import run

        run()
