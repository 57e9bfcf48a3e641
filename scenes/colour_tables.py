"""Imports the package colour-science, of which only tables of spectra are used, without its module for plotting.

`import colour` imports `colour.plotting` and with it Matplotlib, which takes longer than everything else together. So a
placeholder stands for `colour.plotting` while `colour` is imported, and is removed afterwards.
"""

import functools
import sys
from types import ModuleType


@functools.cache
def colour_science() -> ModuleType:
    """The package `colour`. A later `import colour.plotting` by other code works as usual."""
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
