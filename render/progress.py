"""How long work will take: a live bar with time left on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from huesphere.configs.commandline import say
from huesphere.configs.visible import visible
from huesphere.render.transport import Progress

LINE_EVERY = 10.0  # seconds between plain lines
SECONDS_OF_SWEEPS = 60.0  # likewise of work on many pictures


@contextmanager
def shown_progress(title: str, *, every: float = LINE_EVERY) -> Iterator[Progress]:
    """Yields ``progress(share_done, what)`` for one piece of work, share from 0 to 1.

    ``every``: seconds between two plain lines, where the output is no terminal.
    """
    if sys.stderr.isatty():
        with _bar(title) as progress:
            yield progress
    else:
        yield _lines(title, every)


@contextmanager
def _bar(title: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, TextColumn("{task.fields[what]}"), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(escape(visible(title)), total=1.0, what="")
        yield lambda share, what: bar.update(task, completed=share, what=escape(visible(what)))


def _lines(title: str, every: float) -> Progress:
    started = time.monotonic()
    last = started

    def progress(share: float, what: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < every or share <= 0:
            return
        last = now
        left = (now - started) * (1 - share) / share
        step = f", {what}" if what else ""
        say(f"{title}: {share:4.0%}{step}, about {left:.0f} s left", sys.stderr)

    return progress
