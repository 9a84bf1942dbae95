"""The report of a run or a campaign, from its folder to a page."""

from collections.abc import Sequence
from pathlib import Path

from craternav_fg.campaign import store as campaign_store
from craternav_fg.campaign.read import read_campaign
from craternav_fg.files import exists
from craternav_fg.reports.campaign_page import campaign_page
from craternav_fg.reports.page import write_page
from craternav_fg.reports.run_page import run_page
from craternav_fg.reports.runs_page import runs_page
from craternav_fg.runs.read import read_run

REPORT = "report.html"


def is_campaign(folder: Path) -> bool:
    """Whether a folder is a campaign's."""
    return exists(folder / campaign_store.MARKER)


def report(folder: Path | str | Sequence[Path | str], output: Path | str | None = None) -> Path:
    """Write a report on a run, a campaign or several runs: one HTML page that works offline.

    Parameters
    ----------
    folder : Path or str, or a sequence of them
        Folder of the run or the campaign, or of several runs.
    output : Path or str, optional
        The page; `report.html` in the folder, or in the first one, by default.

    Returns
    -------
    Path
        The page's path.

    Raises
    ------
    InputError
        When the folder is neither, or damaged.
    """
    folders = [Path(folder)] if isinstance(folder, str | Path) else [Path(one) for one in folder]
    here = folders[0]
    path = here / REPORT if output is None else Path(output)
    if len(folders) > 1:
        page = runs_page([read_run(one) for one in folders])
    elif is_campaign(here):
        page = campaign_page(read_campaign(here))
    else:
        page = run_page(read_run(here))
    write_page(page, path)
    return path
