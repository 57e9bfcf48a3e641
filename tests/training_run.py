"""A small sweep of ellipsoids that the tests of data sets share: one geometry each, direct light, three lights."""

from pathlib import Path

from huesphere.configs.load import load_configs
from huesphere.render.plan import Shard
from huesphere.render.run import render_configs

ELLIPSOIDS = """
shape: {kind: ellipsoid, semi_axes: [1.0, 0.7, 0.8], detail: 12}
lights:
  - {direction: [0.6, 0.3, 1.0], spectrum: {gaussian: {centre: 610, sigma: 25}}}
  - {direction: [-0.5, 0.4, 1.0], spectrum: {gaussian: {centre: 540, sigma: 25}}}
  - {kind: point, position: [0.2, -1.0, 3.0], spectrum: {gaussian: {centre: 460, sigma: 20}}}
camera: {resolution: [24, 32]}
render: {transport: [direct]}
sweep: {count: 8, seed: 3, shape.semi_axes.1: {uniform: [0.5, 0.9]}}
"""


def render_ellipsoids(folder: Path, name: str, *, shard: Shard | None = None, left_out: tuple[str, ...] = ()) -> Path:
    """Render them, or one part of them, into ``folder``/``name``; returns that path."""
    config = folder / "ellipsoids.yaml"
    config.write_text(ELLIPSOIDS)
    render_configs(
        load_configs(str(config)),
        folder / name,
        progress=lambda *_: None,
        log=lambda _: None,
        shard=shard,
        left_out=left_out,
    )
    return folder / name
