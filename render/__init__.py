"""What the camera measures: light transport, sensor, ground truth, and the data set on disk."""

from typing import Any


def __getattr__(name: str) -> Any:
    """`from huesphere.render import relight, open_item`, loaded when it is asked for: the commands start without it."""
    if name in ("relight", "open_item"):
        from huesphere.render import relighting

        return getattr(relighting, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
