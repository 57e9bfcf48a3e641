"""How many threads linear algebra gets: one, for its matrices are small.

Threads of BLAS take longer to wake than a product of 6×6 or 3000×9 matrices takes, and where several workers run at
once they stand in each other's way. Every command, library call and worker process enters through ``one_blas_thread``.
"""

import contextlib
from collections.abc import Iterator
from functools import cache
from typing import Any


@cache
def _pools() -> Any:
    """The thread pools of the process, looked for once: after NumPy and SciPy have loaded their libraries."""
    import scipy.linalg  # noqa: F401 (loads the BLAS whose pool is to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """The linear algebra within runs on one thread; what was set before is set again behind."""
    with _pools().limit(limits=1, user_api="blas"):
        yield
