"""What several test files need: Mitsuba, with the variant that the transport engine would choose; and few threads.

Tests run in several processes at once (`pytest -n`), each of which would else start a thread for every core.
"""

import os
import shutil
import tempfile

if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")

import pytest

from huesphere.render.backend import choose_backend, load_mitsuba

SHARED_ESTIMATES = "HUESPHERE_SHARED_ESTIMATES"  # the environment's name of a folder that worker processes inherit
MADE_HERE = SHARED_ESTIMATES not in os.environ  # and not by the process that started this one
if MADE_HERE:
    os.environ[SHARED_ESTIMATES] = tempfile.mkdtemp(prefix="huesphere-estimates-")


def pytest_sessionfinish() -> None:
    """Remove the results that the processes of this run have shared (tests/sharing.py).

    Workers, and test runs that a test starts, use the folder of this run and leave it there.
    """
    if MADE_HERE:
        shutil.rmtree(os.environ[SHARED_ESTIMATES], ignore_errors=True)


@pytest.fixture(scope="session")
def mi():
    backend = choose_backend()
    if not backend.vectorised:
        pytest.skip(f"the transport engine needs LLVM or CUDA: {backend.reason}")
    return load_mitsuba(backend)


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures take most of a report's time; where a test is not about them it goes without."""
    monkeypatch.setattr("huesphere.eval.report.ALL_FIGURES_UP_TO", 0)
    monkeypatch.setattr("huesphere.eval.report.FIRST_AND_WORST", 0)


@pytest.fixture(scope="module")
def as_the_method_says():
    """Estimates as methods make them, before they are judged: their own status and their own stated errors."""
    from huesphere.recover.methods import calling

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calling, "_judged_by", lambda function, observation, otherwise: function(observation))
        yield
