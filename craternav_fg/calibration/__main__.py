"""Command that regenerates fitted constants: python -m craternav_fg.calibration [NAME...]."""

import sys

from rich import box
from rich.console import Console
from rich.table import Table

from craternav_fg.calibration.families import FAMILIES
from craternav_fg.calibration.regenerated import Regenerated


def main(names: list[str]) -> int:
    """Print each constant of some families, all if none is named, as shipped and as regenerated.

    Parameters
    ----------
    names : list of str

    Returns
    -------
    int
        Exit code: 2 for a name that is no family's, 1 when a constant is not what it is said to be.
    """
    unknown = [name for name in names if name not in FAMILIES]
    if unknown:
        known = ", ".join(FAMILIES)
        Console(stderr=True).print(f"calibration: expected some of {known}, found {unknown[0]}", style="red")
        return 2
    console, every = Console(), []
    for name in names or FAMILIES:
        with Console(stderr=True).status(name):
            found = FAMILIES[name]()
        console.print(_table(name, found))
        every += found
    return 0 if all(one.holds for one in every) else 1


def _table(name: str, found: list[Regenerated]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, title=name, title_justify="left")
    table.add_column("", min_width=14, overflow="fold")
    for heading in ("shipped", "regenerated", "standard error"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("")
    for one in found:
        numbers = (f"{one.shipped:.4g}", f"{one.value:.4g}", f"{one.error:.2g}")
        table.add_row(one.name, *numbers, one.verdict)
    return table


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
