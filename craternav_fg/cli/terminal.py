"""What commands print: lines, warnings, tables of numbers, progress bars."""

import textwrap
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from craternav_fg.pipeline.measuring import Progress as Report


class _Results(Console):
    """Standard output; JSON is printed even where nothing else is."""

    verbose = False

    def print_json(self, *args: Any, **options: Any) -> None:
        """Print JSON."""
        quiet, self.quiet = self.quiet, False
        try:
            super().print_json(*args, **options)
        finally:
            self.quiet = quiet


# Names and paths come from files: what they hold is no markup.
err = Console(stderr=True, markup=False)
out = _Results(markup=False)


def set_verbosity(*, verbose: bool, quiet: bool) -> None:
    """Set what is printed beside results, warnings and errors.

    Parameters
    ----------
    verbose : bool
        Each step as a line, where no terminal draws bars; tracebacks of known errors.
    quiet : bool
        Neither tables nor remarks nor bars.
    """
    out.verbose, out.quiet = verbose, quiet


def say(text: str) -> None:
    """Print text as it is, neither wrapped nor coloured, so that it can be copied."""
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def tell(text: str) -> None:
    """Print a sentence, in one line unless in a terminal, where it is wrapped between words."""
    say(_wrapped(out, text))


def warn(text: str) -> None:
    """Print a warning on stderr, as `tell` does."""
    line = _wrapped(err, f"craternav: warning: {text}")
    err.print(line, style="yellow", highlight=False, markup=False, soft_wrap=True)


def note(text: str) -> None:
    """Print a remark on stderr, as `tell` does."""
    if not out.quiet:
        line = _wrapped(err, f"craternav: {text}")
        err.print(line, highlight=False, markup=False, soft_wrap=True)


def _wrapped(console: Console, text: str) -> str:
    """Break a text between words where a terminal is narrower; its other lines are indented."""
    if not console.is_terminal or len(text) <= console.width:
        return text
    return textwrap.fill(
        text, console.width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def three_digits(value: float | None) -> str:
    """Write a number with three significant digits; a dash for none."""
    if value is None:
        return "-"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.3g}"


def table_of_numbers(first: str, headings: Iterable[str]) -> Table:
    """Make an empty table: names in the first column, numbers in the others.

    Neighbouring columns share their padding, so that the longest name of an estimator and all columns fit
    into 80 characters. In a narrower terminal a name continues in the next line: it is shown whole, as it may
    be copied.

    Parameters
    ----------
    first : str
        Heading of the first column.
    headings : iterable of str
        Headings of the others.

    Returns
    -------
    Table
    """
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, collapse_padding=True)
    table.add_column(first, overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


class _Rate(ProgressColumn):
    """Steps per minute."""

    def render(self, task: Task) -> Text:
        """Write the recent rate, nothing before it is known."""
        return Text("" if task.speed is None else f"{60.0 * task.speed:.3g}/min")


@contextmanager
def progress_bars() -> "Iterator[Report]":
    """Return a progress report that draws bars on stderr if that is a terminal."""
    columns = (
        TextColumn("{task.description:24}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, disable=out.quiet or not err.is_terminal) as progress:
        tasks: dict[str, TaskID] = {}

        def report(what: str, done: int, total: int) -> None:
            # One bar for all estimators: the name changes, the first word does not.
            kind = what.split()[0]
            if kind not in tasks:
                # Steps that were done before do not count for the rate.
                tasks[kind] = progress.add_task(what, total=total, completed=done)
            progress.update(tasks[kind], description=what, completed=done, total=total)
            if out.verbose and not err.is_terminal:
                note(f"{what}: {done} of {total}")

        yield report
