"""Limits linear algebra to one thread, because its matrices are small here.

To wake the threads of BLAS takes longer than a product of 6×6 or 3000×9 matrices, and with several workers they compete
for the processors. Every command, library call and worker process runs within ``one_blas_thread``.
"""

import contextlib
from collections.abc import Iterator
from functools import cache
from typing import Any


@cache
def _pools() -> Any:
    """The thread pools of the process, searched for once, after NumPy and SciPy have loaded their libraries."""
    import scipy.linalg  # noqa: F401 (loads the BLAS whose pool is to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run linear algebra within the block on one thread; the former number of threads is restored after it."""
    with _pools().limit(limits=1, user_api="blas"):
        yield
