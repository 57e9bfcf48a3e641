"""The public function that renders a configuration, as the command ``render`` does."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from huesphere.configs.load import load_configs
from huesphere.configs.yaml_values import CoreSchemaDumper
from huesphere.render.dataset import RunItem, open_run
from huesphere.render.run import render_configs


def render_scene(
    config: str | Path,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    out: str | Path = "run",
    *,
    shape: str | Path | None = None,
    engine: str = "auto",
    overwrite: bool = False,
    jobs: int = 1,
) -> tuple[RunItem, ...]:
    """Render the scenes of a configuration into the run folder ``out``; returns its items, one for each transport.

    ``config``: a path, or the bare name of a packaged configuration. ``overrides``: keys of it with their values, as a
    mapping ({"camera.read_noise": 1e-3}) or as written for ``--set`` (["camera.read_noise=1e-3"]). ``shape``: a mesh or
    depth map in place of the configuration's shape. ``engine``: "transport" (light is traced once, without wavelengths:
    docs/render.md), "reference" (Mitsuba's own path tracer, with noise), or "auto", which is transport if this machine
    has LLVM or CUDA and reference otherwise. ``jobs``: number of processes. Items that ``out`` has already are kept,
    unless ``overwrite``. Raises InputError for bad input, and Unfinished if items of a sweep fail.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     small = {"camera.resolution": [24, 24], "render.transport": ["linear"]}
    ...     items = render_scene("sphere_quick", small, folder)
    ...     [item.id for item in items], items[0].observation().rgb.shape
    (['sphere_quick/linear'], (24, 24, 3))
    """
    run = Path(out)
    settings = (
        [f"{key}={_yaml(value)}" for key, value in overrides.items()] if isinstance(overrides, Mapping) else overrides
    )
    configs = load_configs(str(config), overrides=list(settings), shape=None if shape is None else str(shape))
    ids = render_configs(
        configs,
        run,
        progress=lambda share, what: None,
        log=lambda line: None,
        engine=engine,
        overwrite=overwrite,
        jobs=jobs,
    )
    return tuple(item for item in open_run(run) if item.id in set(ids))


def _yaml(value: Any) -> str:
    """``value`` as YAML on one line, as ``--set`` takes it."""
    text: str = yaml.dump(value, Dumper=CoreSchemaDumper, default_flow_style=True, width=10**6)
    return text.removesuffix("\n...\n").strip()
