"""Three ways to find a rim in an image, and the columns of a row in which their numbers stand."""

from collections.abc import Mapping

from craternav_fg.reproduce.results import Row

# The paper's way; without a prior, the edge taken where the crest is; the same from a predicted pose.
CANNY, BLIND, GUIDED = "canny", "blind", "guided"
METHODS = (CANNY, BLIND, GUIDED)


def image_row(
    figure: str,
    quantity: str,
    condition: str,
    unit: str,
    values: Mapping[str, float | None],
    *,
    verdict: str,
    paper: float | None = None,
    headline: bool = True,
) -> Row:
    """Row of a number by each way: as printed, corrected and efficient; None where there is none."""
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
