"""Silence for libraries of C++ that complain aloud of what they raise as well: that is told once, by us."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Nothing that compiled code says in here is heard, neither on stderr nor by way of Python's own stdout."""
    sys.stderr.flush()
    kept, void = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(void, 2)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(void)
