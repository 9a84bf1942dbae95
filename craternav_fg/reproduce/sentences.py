"""Words that follow from numbers: the notes of the figures say nothing that is not computed."""

from collections.abc import Sequence

# Numbers that differ by less, relative to the reference, count as equal.
EQUAL_WITHIN = 0.1


def compared(value: float, reference: float, within: float = EQUAL_WITHIN) -> str:
    """Say how a positive number compares with a reference.

    Parameters
    ----------
    value, reference : float
    within : float
        Relative difference up to which they count as equal.

    Returns
    -------
    str
        "smaller than", "about equal to" or "larger than"; "not comparable with" when one is NaN.
    """
    if abs(value - reference) <= within * abs(reference):
        return "about equal to"
    if value < reference:
        return "smaller than"
    return "larger than" if value > reference else "not comparable with"


def changed(first: float, last: float) -> str:
    """Describe the factor by which a positive number grows or falls: "grows by a factor of 3.7".

    Parameters
    ----------
    first, last : float

    Returns
    -------
    str
        "stays about the same" within `EQUAL_WITHIN`, "is not known" when one is NaN.
    """
    how = compared(last, first)
    if how == "about equal to":
        return "stays about the same"
    if how == "not comparable with":
        return "is not known"
    return (
        f"grows by a factor of {last / first:.2g}"
        if last > first
        else f"falls by a factor of {first / last:.2g}"
    )


def listed(items: Sequence[str]) -> str:
    """Join words as a list: "a, b and c"."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"
