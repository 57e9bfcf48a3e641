"""What is said of independent tasks, wherever they are done: their functions, progress and results."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

Progress = Callable[[float, str], None]
Log = Callable[[str], None]
Function = Callable[[Any, Progress, Log], Any]
Results = Generator[tuple[int, Any], None, None]


@dataclass(frozen=True)
class Lost:
    """The result of a task that has none because a worker died each time that the task was tried."""

    why: str  # how the last worker died
    ended: bool = False  # by a signal that asks a process to end: then nothing is wrong with the task


class Shares:
    """Computes the progress of all work from that of each task."""

    def __init__(self, count: int, progress: Progress) -> None:
        self.shares, self.progress = [0.0] * count, progress

    def put(self, number: int, share: float, what: str) -> None:
        """Record that a ``share`` of task ``number`` is done, and report the mean of all shares."""
        self.shares[number] = max(self.shares[number], share)
        self.progress(sum(self.shares) / len(self.shares), what)
