"""Three methods that find a rim in an image, and the columns of a row in which their numbers stand."""

from collections.abc import Mapping

from craternav_fg.reproduce.results import NO_NUMBER, Row, verdict

# Ellipses through Canny edges, as in the paper; the blind detector; guided measurement from a predicted pose.
CANNY, BLIND, GUIDED = "canny", "blind", "guided"
METHODS = (CANNY, BLIND, GUIDED)


def image_row(
    figure: str,
    quantity: str,
    condition: str,
    unit: str,
    values: Mapping[str, float | None],
    *,
    verdict: str = NO_NUMBER,
    paper: float | None = None,
    headline: bool = True,
) -> Row:
    """Make the row of a number by each method: Canny as printed, blind as corrected, guided as efficient.

    Parameters
    ----------
    figure, quantity, condition, unit : str
    values : mapping of str to float or None
        By method.
    verdict : str
    paper : float, optional
    headline : bool

    Returns
    -------
    Row
    """
    return Row(
        figure,
        quantity,
        condition,
        unit,
        paper,
        as_printed=values.get(CANNY),
        corrected=values.get(BLIND),
        efficient=values.get(GUIDED),
        verdict=verdict,
        headline=headline,
    )


def judged(paper: float | None, by_canny: float | None, ours: float | None, error: float = 0.0) -> str:
    """Judge a number of the paper by that of Canny edges, and say how ours compares.

    Parameters
    ----------
    paper, by_canny, ours : float or None
    error : float
        Standard error of the difference between the paper's number and that of Canny edges.

    Returns
    -------
    str
    """
    words = verdict(paper, by_canny, None, error=error)
    return words if paper is None or ours is None else f"{words}; ours {ours / paper:.2g} times"
