"""Ground truth of the mesh that was rendered, at pixel centres: normals, depth, mask, shadows of each light."""

import numpy as np

from render.dataset import Truth
from render.spectral import linear_model
from render.transport import Transport
from scenes.build import Scene


def ground_truth(scene: Scene, traced: Transport, gain: float, *, cast_shadows: bool) -> Truth:
    """Truth of one item; ``gain`` is the exposure, so that facts["F"] maps normals to the picture's own colours."""
    points = traced.pixels.points
    depth = points.position[:, 2] / scene.view.pixel_size
    facing, direct = traced.facing, traced.direct if cast_shadows else traced.facing
    attached = (facing <= 0).astype(np.float32)
    cast = np.where(facing > 0, 1.0 - direct / np.maximum(facing, 1e-30), 0.0)
    return Truth(
        normals=np.moveaxis(traced.image(points.normal.T, fill=np.nan), 0, -1),
        depth=traced.image(depth, fill=np.nan),
        mask=traced.mask(),
        attached_shadow=np.moveaxis(traced.image(attached), 0, -1),
        cast_shadow=np.moveaxis(traced.image(cast), 0, -1),
        facts={
            "F": (gain * linear_model(scene)).tolist(),
            "lights": [{"name": light.name, "direction": light.direction.tolist()} for light in scene.lights],
            "pixel_size": scene.view.pixel_size,
            "shape": scene.shape_label,
        },
    )
