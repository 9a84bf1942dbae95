"""The report of a run or a campaign, from its folder to a page."""

from pathlib import Path

from craternav_fg.campaign import store as campaign_store
from craternav_fg.campaign.read import read_campaign
from craternav_fg.files import exists
from craternav_fg.reports.campaign_page import campaign_page
from craternav_fg.reports.page import write_page
from craternav_fg.reports.run_page import run_page
from craternav_fg.runs.read import read_run

REPORT = "report.html"


def is_campaign(folder: Path) -> bool:
    """Whether a folder is a campaign's."""
    return exists(folder / campaign_store.MARKER)


def report(folder: Path | str, output: Path | str | None = None) -> Path:
    """Write a report on a run or a campaign: one HTML page that needs no network.

    Parameters
    ----------
    folder : Path or str
        Of the run or the campaign.
    output : Path or str, optional
        The page; `report.html` in the folder by default.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    InputError
        When the folder is neither, or damaged.
    """
    here = Path(folder)
    path = here / REPORT if output is None else Path(output)
    write_page(campaign_page(read_campaign(here)) if is_campaign(here) else run_page(read_run(here)), path)
    return path
