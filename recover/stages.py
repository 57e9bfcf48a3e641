"""What a method is at work on, told to whoever listens: a command shows it while it goes on.

A method calls ``at_work_on``; without a listener nothing happens. The listener is that of the calling thread's context,
so that methods in other threads and processes do not tell each other's stages.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import Enum

Listener = Callable[[float, str], None]  # (share of the time that has passed, what comes now)

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


class Stage(Enum):
    """The stages of ``auto`` in their order; other methods pass through some of them.

    Each has the share of the time that has passed when it begins, as a guide only, and its name for people.
    """

    REDUCTION = (0.0, "means over blocks of pixels")
    ELLIPSOID = (0.02, "ellipsoid and rotation")
    INTERREFLECTION = (0.1, "interreflection")
    LIGHTS = (0.35, "lights and every pixel")
    JOINT_FIT = (0.7, "depth and F fitted together")
    VERDICT = (0.9, "verdict")
    FULL_SIZE = (0.93, "every pixel at full size")

    @property
    def begins(self) -> float:
        """Share of the time that has passed when it begins."""
        return self.value[0]

    @property
    def told(self) -> str:
        """Its name for people."""
        return self.value[1]


def at_work_on(stage: Stage) -> None:
    """Tell the listener, if there is one, which stage begins."""
    listener = _listener.get()
    if listener is not None:
        listener(stage.begins, stage.told)


@contextmanager
def told_to(listener: Listener) -> Iterator[None]:
    """Within this context the ``listener`` hears which stages begin."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
