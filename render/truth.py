"""Ground truth of an item, from the mesh that was rendered, at pixel centres: normals, depth, mask, shadows.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

import numpy as np

from huesphere.render.dataset import KnownLights, Truth
from huesphere.render.spectral import linear_model
from huesphere.render.transport import Transport
from huesphere.scenes.build import Scene


def ground_truth(scene: Scene, traced: Transport, gain: float, *, cast_shadows: bool) -> Truth:
    """Truth of one item, from its scene and the light transport that was ``traced`` in it.

    Normals (H, W, 3) and depth (H, W), in pixels toward the camera, are NaN off the mask (H, W). The shadow images are
    (L, H, W) before their axes are moved to (H, W, L), one for each light: ``attached_shadow`` is 1 where the surface
    faces away from the light, and ``cast_shadow`` the share of the direct light, 0 to 1, that other parts of the
    surface block; it is 0 everywhere unless ``cast_shadows``. ``gain`` is the exposure, the factor from colours of the
    scene to values of the picture: facts["F"] is the matrix F in ρ = F n multiplied by it, None for scenes without F.
    "material" (H, W) is added for scenes of several materials; where reflectance varies over the surface, "weight.<m>",
    the weight of each reflectance, and "albedo.R", "albedo.G", "albedo.B", what the camera measures of the surface as a
    share of a white one under light of equal energy at all wavelengths; and the directions "ray.X", "ray.Y", "ray.Z"
    (H, W) of the rays from the camera in perspective; "depth_mm" (H, W), toward the camera, for scenes of that unit.
    """
    points = traced.pixels.points
    depth = points.position[:, 2] / scene.view.pixel_size
    unoccluded = traced.facing  # (L, n)
    direct = traced.images[:, :, 0].mean(axis=0) if cast_shadows else unoccluded  # mean of the independent estimates
    attached = (unoccluded <= 0).astype(np.float32)
    cast = np.where(unoccluded > 0, np.clip(1.0 - direct / np.maximum(unoccluded, 1e-30), 0.0, 1.0), 0.0)
    model = linear_model(scene)
    extra = (
        {"material": traced.image(traced.pixels.material.astype(np.float32), fill=-1)}
        if scene.is_object.sum() > 1 and scene.albedo is None
        else {}
    )
    if scene.unit is not None:
        extra[f"depth_{scene.unit}"] = traced.image(points.position[:, 2], fill=np.nan)
    if traced.pixels.weights is not None:
        extra |= _albedo(scene, traced, traced.pixels.weights)
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
            "unit": scene.unit,
        },
    )


def _albedo(scene: Scene, traced: Transport, weights: np.ndarray) -> dict[str, np.ndarray]:
    """Weights and albedo, as ``ground_truth`` names them, from the ``weights`` (n, M) at the pixels."""
    of_object = np.flatnonzero(scene.is_object)
    extra = {f"weight.{m}": traced.image(weights[:, m], fill=np.nan) for m in of_object}
    shares = scene.reflectances[of_object] @ scene.sensitivity / scene.sensitivity.sum(axis=0)  # (M, 3)
    albedo = traced.image((weights[:, of_object] @ shares).T, fill=np.nan)
    return extra | {f"albedo.{name}": image for name, image in zip("RGB", albedo, strict=True)}


def known_lights(scene: Scene) -> KnownLights:
    """Positions (P, 3), pixels, and directions (D, 3) of the lights, for a config that gives them to recovery.

    Colours and intensities of the lights are not given.
    """
    near = [light.known_position / scene.view.pixel_size for light in scene.lights if light.known_position is not None]
    far = [light.known_direction for light in scene.lights if light.known_direction is not None]
    return KnownLights(np.reshape(near, (-1, 3)), np.reshape(far, (-1, 3)))
