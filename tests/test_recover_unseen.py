"""How much of a surface's own light comes from parts that the camera does not see: no kernel on its depth holds it."""

import numpy as np
import pytest

from huesphere.configs.load import load_config
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.gather import mean_over_rays
from huesphere.render.raycast import ray_caster
from huesphere.render.relief import gather_without_kernel
from huesphere.render.run import render_config
from huesphere.render.transport import OFFSET_PIXELS, find_pixels
from huesphere.scenes.build import build_scene
from huesphere.scenes.quadrature import fibonacci_lattice

ALBEDO, SIDE, RAYS = 0.8, 64, 256


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "unseen", "off"), [("{kind: bowl, opening: 60}", 0.0, 0.03), ("{kind: bust}", 0.084, 0.11)]
)
def test_share_of_the_light_that_comes_from_unseen_parts(tmp_path, mi, shape, unseen, off):
    """A bowl shows all that lights it; of the bust's indirect light a twelfth comes from what no pixel sees."""
    changes = [f"surface.reflectance={ALBEDO}", f"camera.resolution=[{SIDE},{SIDE}]", "render.transport=[direct, full]"]
    changes.append(f"shape={shape}")
    config = load_config("mozart_5lights.yaml", overrides=changes)
    render_config(config, tmp_path, progress=lambda *_: None, log=lambda _: None)
    pictures = {t: read_observation(tmp_path / f"mozart_5lights/{t}/observation.exr") for t in ("direct", "full")}
    truth = {t: read_truth(tmp_path / f"mozart_5lights/{t}/truth.exr") for t in ("direct", "full")}
    exposure = np.linalg.norm(truth["full"].facts["F"]) / np.linalg.norm(truth["direct"].facts["F"])
    mask, light = truth["full"].mask, pictures["full"].rgb.astype(float)
    indirect = (light - exposure * pictures["direct"].rgb)[mask]

    scene = build_scene(config)
    view = scene.view
    caster = ray_caster(mi, scene.mesh, OFFSET_PIXELS * view.pixel_size)
    points = find_pixels(scene, caster).points
    turns = np.random.default_rng(0).random((mask.sum(), 2)).astype(np.float32)
    hits, _ = caster.hemisphere_hits(points, slice(0, mask.sum()), fibonacci_lattice(RAYS), turns)
    met = caster.points_on(hits.face, hits.uv).position.astype(float)
    row, column = view.height / 2 - met[:, 1] / view.pixel_size, view.width / 2 + met[:, 0] / view.pixel_size
    looked, first = caster.first_hits(*view.rays(row, column))
    front = np.full(len(met), np.inf)
    front[looked] = first.position[:, 2]
    row, column = (np.clip(at.astype(int), 0, SIDE - 1) for at in (row, column))
    seen = (met[:, 2] > front - 0.05 * view.pixel_size) & mask[row, column]
    values = np.where(seen[:, None], ALBEDO * light[row, column], 0.0)
    by_seen = mean_over_rays(hits, np.zeros(len(met), np.int32), 1, values, RAYS)[:, 0]
    assert 1 - by_seen.sum() / indirect.sum() == pytest.approx(unseen, abs=0.01)

    # The kernel on the visible depth lacks that light, and has walls drawn down from every rim that give light instead.
    normals = np.where(mask[..., None], truth["full"].normals, [0.0, 0.0, 1.0])
    depth = np.where(mask, truth["full"].depth, 0.0).astype(float)
    by_kernel = ALBEDO * gather_without_kernel(depth, mask, normals, light[mask], azimuths=48)
    assert np.abs(indirect - by_kernel).sum() / indirect.sum() == pytest.approx(off, abs=0.02)
