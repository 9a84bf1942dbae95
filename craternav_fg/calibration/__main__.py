"""Command that regenerates fitted constants: python -m craternav_fg.calibration [NAME...].

Families on real ground are called one by one, each with the folder of the public files: NAME FOLDER.
"""

import sys
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from craternav_fg.calibration.families import FAMILIES, ON_REAL_GROUND
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.errors import CraternavError


def main(names: list[str]) -> int:
    """Print each constant of some families, all if none is named, as shipped and as regenerated.

    Parameters
    ----------
    names : list of str
        Or one of a family on real ground, and the folder of the public files.

    Returns
    -------
    int
        Exit code: 2 for what cannot be done, 1 when a constant is not what it is said to be.
    """
    if names and names[0] in ON_REAL_GROUND:
        return _on_real_ground(names[0], names[1:])
    unknown = [name for name in names if name not in FAMILIES]
    if unknown:
        known = ", ".join((*FAMILIES, *ON_REAL_GROUND))
        return _refused(f"expected some of {known}, found {unknown[0]}")
    console, every = Console(), []
    for name in names or FAMILIES:
        with Console(stderr=True).status(name):
            found = FAMILIES[name]()
        console.print(_table(name, found))
        every += found
    return 0 if all(one.holds for one in every) else 1


def _on_real_ground(name: str, given: list[str]) -> int:
    if len(given) != 1:
        return _refused(f"{name}: expected the folder of the public files, and nothing else")
    try:
        ON_REAL_GROUND[name](Path(given[0]))
    except CraternavError as error:
        return _refused(str(error))
    return 0


def _refused(problem: str) -> int:
    Console(stderr=True, soft_wrap=True).print(f"calibration: {problem}", style="red", markup=False)
    return 2


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
