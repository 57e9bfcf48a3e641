"""What several test files need: Mitsuba, with the variant that the transport engine would choose."""

import pytest

from huesphere.render.backend import choose_backend, load_mitsuba


@pytest.fixture(scope="session")
def mi():
    backend = choose_backend()
    if not backend.vectorised:
        pytest.skip(f"the transport engine needs LLVM or CUDA: {backend.reason}")
    return load_mitsuba(backend)
