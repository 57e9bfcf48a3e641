"""Work on many things at once: order, errors, and one BLAS thread for each."""

import threading

import numba
import pytest
from threadpoolctl import threadpool_info

from huesphere.recover.geometry.threads import in_threads


def test_outcomes_come_in_the_order_of_the_things():
    def slow_first(k):
        threading.Event().wait(0.02 if k == 0 else 0)
        return k * k

    assert in_threads(slow_first, range(6)) == [0, 1, 4, 9, 16, 25]


def test_an_error_of_one_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 / k, [1, 0, 2])


def test_linear_algebra_within_has_one_thread_and_afterwards_as_many_as_before():
    def blas_threads(_=None):
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = blas_threads()
    assert all(set(threads) <= {1} for threads in in_threads(blas_threads, range(3)))
    assert blas_threads() == before


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_things_are_worked_on_at_the_same_time():
    both = threading.Barrier(2, timeout=10)  # breaks unless two wait together
    assert sorted(in_threads(lambda _: both.wait(), range(2))) == [0, 1]
