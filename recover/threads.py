"""The same work on many things at once, on as many threads as Numba may use: what is compiled runs without the lock.

Threads from here, for the compiler takes half a minute over a loop of its own that is shared out.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

Thing = TypeVar("Thing")
Outcome = TypeVar("Outcome")


def in_threads(work: Callable[[Thing], Outcome], things: Iterable[Thing]) -> list[Outcome]:
    """``work`` of each of the ``things``, in their order."""
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, things))
