"""The same work on many things at once, on as many threads as Numba may use.

Compiled functions run without Python's global lock. The threads are started from here, because Numba takes half a
minute to compile a loop that it parallelises itself. Linear algebra within each thread runs on one thread
(``configs.threads``).
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

from huesphere.configs.threads import one_blas_thread

Thing = TypeVar("Thing")
Outcome = TypeVar("Outcome")


def in_threads(work: Callable[[Thing], Outcome], things: Iterable[Thing]) -> list[Outcome]:
    """``work`` of each of the ``things``, in their order."""
    with one_blas_thread(), ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, things))
