"""Work on the rims of one image in threads."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Apply a function whose kernels release the lock to each of some items.

    As many threads work on them as OpenCV has, which workers on a core each set to one.

    Parameters
    ----------
    work : callable
    items : iterable

    Returns
    -------
    list
        Results in the order of the items.
    """
    count = max(cv2.getNumThreads(), 1)
    if count == 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(work, items))
