"""The simulation of a cluster agrees with queues whose answer is known."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

from scale_simulation import LAYOUTS, Costs, simulate

IDEAL = Costs(task=2.0, spread=0.0, start=0.0, item_bytes=0.0, manifest_item=0.0, scheduler=0.0, failure=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_without_costs_the_work_is_divided_exactly(layout):
    got = simulate(IDEAL, 8, 80, layout)
    assert got["seconds"] == pytest.approx(20.0)
    assert got["efficiency"] == pytest.approx(1.0)


def test_a_start_is_paid_once_by_each_process():
    assert simulate(replace(IDEAL, start=5.0), 8, 80, LAYOUTS[2])["seconds"] == pytest.approx(25.0)


def test_a_scheduler_serves_no_more_tasks_than_it_can():
    """1000 cores could do 500 tasks a second; the scheduler hands out 100."""
    got = simulate(replace(IDEAL, scheduler=0.01), 1000, 3000, "one folder, Dask")
    assert got["seconds"] == pytest.approx(30.0 + 2.0, rel=1e-3)
    assert simulate(replace(IDEAL, scheduler=0.01), 1000, 3000, LAYOUTS[0])["seconds"] == pytest.approx(6.0)


def test_the_lock_of_one_manifest_costs_the_square_of_the_items():
    """Σ b n over n < N is b N² / 2, one after the other, whatever the number of cores."""
    got = simulate(replace(IDEAL, manifest_item=0.01), 500, 1000, "one folder, array")
    assert got["seconds"] == pytest.approx(0.01 * 1000 * 999 / 2 + 2.0, rel=1e-2)


def test_a_task_whose_worker_died_is_done_again():
    """With deaths at rate r and memoryless retries, the mean time of a task of length w is (exp(r w) − 1) / r."""
    got = simulate(replace(IDEAL, failure=0.2), 1, 4000, LAYOUTS[2], seed=3)
    assert got["deaths"] > 1000
    assert got["seconds"] / 4000 == pytest.approx((2.718281828 ** (0.2 * 2.0) - 1) / 0.2, rel=0.05)
