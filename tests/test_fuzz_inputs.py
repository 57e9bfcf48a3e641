"""A small number of the cases of fuzz.py, drawn by hypothesis so that what goes wrong is shown at its smallest.

benchmarks/run_fuzz.py runs ten thousand.
"""

import tempfile
from pathlib import Path

import pytest
from fuzz import in_time
from fuzz_cases import CASES
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

QUICK = {"config": 150, "depth map": 60, "mesh": 40, "picture": 40, "run folder": 60}
QUICK |= {"any picture": 60, "mask": 40, "normal map": 40, "spectrum": 60, "no file": 30, "hostile run folder": 40}


@pytest.mark.parametrize("kind", QUICK)
@pytest.mark.filterwarnings("ignore")
def test_bad_input_is_one_line_and_never_a_wrong_answer(kind):
    @settings(max_examples=QUICK[kind], deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def case(rng):
        with tempfile.TemporaryDirectory() as folder, in_time():
            CASES[kind](rng, Path(folder))

    case()


@pytest.mark.slow
def test_what_the_schema_allows_is_rendered_or_refused(mi):
    @settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def case(rng):
        with tempfile.TemporaryDirectory() as folder, in_time():
            CASES["render"](rng, Path(folder))

    case()
