"""Ground truth of the mesh that was rendered, at pixel centres: normals, depth, mask, shadows of each light."""

import numpy as np

from huesphere.render.dataset import KnownLights, Truth
from huesphere.render.spectral import linear_model
from huesphere.render.transport import Transport
from huesphere.scenes.build import Scene


def ground_truth(scene: Scene, traced: Transport, gain: float, *, cast_shadows: bool) -> Truth:
    """Truth of one item; ``gain`` is the exposure, so that facts["F"] maps normals to the picture's own colours."""
    points = traced.pixels.points
    depth = points.position[:, 2] / scene.view.pixel_size
    facing = traced.facing
    direct = traced.images[:, :, 0].mean(axis=0) if cast_shadows else facing
    attached = (facing <= 0).astype(np.float32)
    cast = np.where(facing > 0, np.clip(1.0 - direct / np.maximum(facing, 1e-30), 0.0, 1.0), 0.0)
    model = linear_model(scene)
    extra = (
        {"material": traced.image(traced.pixels.material.astype(np.float32), fill=-1)}
        if scene.is_object.sum() > 1
        else {}
    )
    if scene.view.eye is not None:
        rows, cols = np.indices(traced.shape) + 0.5
        extra |= {f"ray.{a}": d for a, d in zip("XYZ", np.moveaxis(scene.view.rays(rows, cols)[1], -1, 0), strict=True)}
    return Truth(
        normals=np.moveaxis(traced.image(points.normal.T, fill=np.nan), 0, -1),
        depth=traced.image(depth, fill=np.nan),
        mask=traced.mask(),
        attached_shadow=np.moveaxis(traced.image(attached), 0, -1),
        cast_shadow=np.moveaxis(traced.image(cast), 0, -1),
        extra=extra,
        facts={
            "F": None if model is None else (gain * model).tolist(),
            "lights": [light.facts() for light in scene.lights],
            "pixel_size": scene.view.pixel_size,
            "shape": scene.shape_label,
        },
    )


def known_lights(scene: Scene) -> KnownLights:
    """Positions and directions of the lights, for a config that gives them to recovery; no colour and no intensity."""
    near = [light.known_position / scene.view.pixel_size for light in scene.lights if light.known_position is not None]
    far = [light.known_direction for light in scene.lights if light.known_direction is not None]
    return KnownLights(np.reshape(near, (-1, 3)), np.reshape(far, (-1, 3)))
