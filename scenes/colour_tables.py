"""colour-science, for its tables, without its plotting: that imports Matplotlib, longer than all the rest together."""

import functools
import sys
from types import ModuleType


@functools.cache
def colour_science() -> ModuleType:
    """The package `colour`. Whoever imports `colour.plotting` afterwards gets it as it is."""
    plotting = "colour.plotting"
    if "colour" in sys.modules or plotting in sys.modules:
        import colour

        return colour
    sys.modules[plotting] = ModuleType(plotting)
    try:
        import colour
    finally:
        del sys.modules[plotting]
    return colour
