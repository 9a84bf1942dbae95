"""Leap seconds of UTC, which stamps do not count.

A stamp is UTC since 1970 without leap seconds: it has no number for a leap second, and the stamps before and
after one are a second closer to each other than the times.
"""

import re
from datetime import UTC, datetime, timedelta

# Days that end with 23:59:60, by IERS Bulletin C.
_DAYS = (
    "1972-06-30", "1972-12-31", "1973-12-31", "1974-12-31", "1975-12-31", "1976-12-31", "1977-12-31",
    "1978-12-31", "1979-12-31", "1981-06-30", "1982-06-30", "1983-06-30", "1985-06-30", "1987-12-31",
    "1989-12-31", "1990-12-31", "1992-06-30", "1993-06-30", "1994-06-30", "1995-12-31", "1997-06-30",
    "1998-12-31", "2005-12-31", "2008-12-31", "2012-06-30", "2015-06-30", "2016-12-31",
)  # fmt: skip
# Stamps, s, at the end of each.
_ENDS_S = [
    round((datetime.fromisoformat(day).replace(tzinfo=UTC) + timedelta(days=1)).timestamp()) for day in _DAYS
]
_WRITTEN = re.compile(r":60([.,]\d*)?(Z|[+-]\d\d:?\d\d)?$")


def is_leap_second(utc: str) -> bool:
    """Return whether a time in ISO 8601 is in a leap second.

    Parameters
    ----------
    utc : str

    Returns
    -------
    bool
    """
    return _WRITTEN.search(utc.strip()) is not None


def leap_second_between(begin_ns: int, end_ns: int) -> str | None:
    """Find a leap second between two stamps.

    Parameters
    ----------
    begin_ns, end_ns : int
        UTC since 1970 without leap seconds.

    Returns
    -------
    str or None
        The day that ends with the first one, as 2016-12-31.
    """
    between = (
        day for day, end_s in zip(_DAYS, _ENDS_S, strict=True) if begin_ns < end_s * 1_000_000_000 <= end_ns
    )
    return next(between, None)
