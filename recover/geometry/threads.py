"""One function applied to many items in parallel, on as many threads as Numba may use.

Compiled functions run without Python's global lock. Python's threads are used, because Numba takes half a minute to
compile a loop that it parallelises itself. Linear algebra within each of them runs on one thread
(``configs.threads``).
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

from huesphere.configs.threads import one_blas_thread

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item], *, most: int | None = None) -> list[Result]:
    """The results of ``function`` for each of the ``items``, in their order. Raises what ``function`` raises.

    ``most``: number of threads that their memory allows; None: any.
    """
    count = numba.get_num_threads()
    with one_blas_thread(), ThreadPoolExecutor(count if most is None else min(count, most)) as pool:
        return list(pool.map(function, items))
