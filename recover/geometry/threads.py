"""The same work on many things at once, on as many threads as Numba may use: what is compiled runs without the lock.

Threads from here, for the compiler takes half a minute over a loop of its own that is shared out. The linear algebra
within each gets no threads of its own: two times two on two cores take longer than one after the other.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numba
from threadpoolctl import ThreadpoolController

Thing = TypeVar("Thing")
Outcome = TypeVar("Outcome")


@cache
def _pools() -> ThreadpoolController:
    """Looked for once, when all of them are loaded."""
    return ThreadpoolController()


@contextlib.contextmanager
def small_algebra() -> Iterator[None]:
    """Where matrices are small: the linear algebra within gets no threads of its own, which take longer to wake."""
    with _pools().limit(limits=1, user_api="blas"):
        yield


def in_threads(work: Callable[[Thing], Outcome], things: Iterable[Thing]) -> list[Outcome]:
    """``work`` of each of the ``things``, in their order."""
    with small_algebra(), ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, things))
