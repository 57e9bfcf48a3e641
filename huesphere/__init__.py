"""Normals from one colour picture: scenes with known normals, their recovery, and how well it went.

>>> import huesphere as hs
>>> sorted(hs.METHODS)[:3]
['alternation', 'auto', 'drew-kontsevich']

``recover_normals`` takes arrays and returns an Estimate; ``render_scene`` renders a configuration into a run folder,
``open_run`` opens one; ``score`` compares normals with the truth; ``relight`` shows a traced scene under other lights;
``integrate`` turns normals into depth; ``Rig`` gives both for each frame of a calibrated rig. Everything is imported
when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from huesphere.configs.errors import InputError
    from huesphere.eval.datasets.samples import Augmentation, RunSamples
    from huesphere.eval.scores import Scores, score
    from huesphere.recover.arrays import integrate, recover_normals
    from huesphere.recover.io.estimate import Estimate
    from huesphere.recover.methods.table import METHODS
    from huesphere.recover.rig.live import Rig
    from huesphere.recover.solution import Solution
    from huesphere.render.dataset import Observation, RunItem, open_run
    from huesphere.render.relighting import relight
    from huesphere.render.scene import render_scene

__all__ = [
    "METHODS",
    "Augmentation",
    "Estimate",
    "InputError",
    "Observation",
    "Rig",
    "RunItem",
    "RunSamples",
    "Scores",
    "Solution",
    "integrate",
    "open_run",
    "recover_normals",
    "relight",
    "render_scene",
    "score",
]

_WHERE = {
    "METHODS": "recover.methods.table",
    "Augmentation": "eval.datasets.samples",
    "Estimate": "recover.io.estimate",
    "InputError": "configs.errors",
    "Observation": "render.dataset",
    "Rig": "recover.rig.live",
    "RunItem": "render.dataset",
    "RunSamples": "eval.datasets.samples",
    "Scores": "eval.scores",
    "Solution": "recover.solution",
    "integrate": "recover.arrays",
    "open_run": "render.dataset",
    "recover_normals": "recover.arrays",
    "relight": "render.relighting",
    "render_scene": "render.scene",
    "score": "eval.scores",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("huesphere")
    if name not in _WHERE:
        raise AttributeError(f"module 'huesphere' has no attribute {name!r}")
    return getattr(import_module(f"huesphere.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
