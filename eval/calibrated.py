"""Method ``woodham1980``: calibrated least squares from one picture under each light, all directions known.

R. J. Woodham, "Photometric method for determining surface orientation from multiple images", Optical Engineering 19(1),
1980: with I_l the brightness of a pixel under light l of unit intensity and direction a_l, the vector g = albedo · n is
the least-squares solution of A g = I, and n = g / |g|. Shadowed and shining pixels are kept, as in the row "BASELINE"
of the DiLiGenT benchmark. The single-light pictures are those of the item's layers: the method is a mark by which to
measure what one picture under all lights at once gives, not a rival of methods that see one picture.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside
from huesphere.eval.references import REFERENCES
from huesphere.eval.score import Item
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.render.dataset import Truth, read_observation, read_truth
from huesphere.render.layers import Layers, read_layers
from huesphere.render.manifest import sha256_of
from huesphere.render.photographs.item import COMPONENTS, KIND

METHOD = "woodham1980"
# Brightness of a photograph from its red, green and blue. Blue is left out: on the ball of DiLiGenT, an orange surface
# with a highlight, blue alone errs 4.88°, red and green 4.07° and 4.15°; red and green give the published 4.10°, the
# mean of all three 4.29° (docs/photographs.md).
BRIGHTNESS = np.array([0.5, 0.5, 0.0])
LEAST_LIGHTS = 3
LARGEST_CONDITION = 1e6  # of the directions (L, 3): above, they lie in a plane


def known_lights_estimate(layers: Layers, truth: Truth) -> Estimate:
    """Normals by least squares from the ``layers`` of an item and the directions of its lights in ``truth``.

    Raises InputError for lights without a direction, for layers that do not tell the lights' intensities, and for
    fewer than three lights or lights in one plane.
    """
    directions = _directions(layers, truth)
    mask = layers.material >= 0
    images = single_light_pictures(layers, truth)[:, mask]
    g = np.linalg.lstsq(directions, images, rcond=None)[0].T  # (n, 3), albedo times normal
    length = np.linalg.norm(g, axis=1, keepdims=True)
    normals = np.full((*mask.shape, 3), np.nan, np.float32)
    normals[mask] = np.where(length > 0, g / np.where(length > 0, length, 1.0), np.nan)
    valid = np.asarray(np.isfinite(normals).all(axis=-1))
    return Estimate(
        method=METHOD,
        status="ok",
        message=f"{REFERENCES[METHOD]}: {len(directions)} pictures",
        normals=normals,
        valid=valid,
        inlier=valid,
        uncertainty_deg=np.full(mask.shape, np.nan, np.float32),  # what it errs by is no noise that it could state
        diagnostics={"lights": len(directions), "knows": REFERENCES[METHOD]},
    )


def single_light_pictures(layers: Layers, truth: Truth) -> np.ndarray:
    """(L, H, W) brightness under each light alone, of unit intensity.

    Of photographs the images themselves. Of a rendered item the amplitude of the light's colour b on a surface that
    faces it, Σ_c b_c ρ_c / Σ_c b_c²: for direct light exactly max(0, a·n) times visibility.
    Raises InputError for layers of the stock integrator, whose colours do not tell the intensities.
    """
    kinds = {str(light.get("kind")) for light in truth.facts.get("lights") or []}
    if layers.names == COMPONENTS and kinds == {KIND}:
        pictures: np.ndarray = np.einsum("lchw,c->lhw", layers.images.astype(np.float64), BRIGHTNESS)
        return pictures
    if "direct" not in layers.names:
        raise InputError(
            f"{METHOD}: these layers do not tell the intensities of the lights", got=str(layers.names)[:60]
        )
    facing = layers.colours[:, layers.names.index("direct"), 0]  # (L, 3)
    lit = [layers.of_light(light) for light in range(len(layers.lights))]
    return np.stack([one @ b / np.sum(b**2) for one, b in zip(lit, facing, strict=True)])


def _directions(layers: Layers, truth: Truth) -> np.ndarray:
    """Unit directions (L, 3) toward the lights of ``layers``. Raises InputError."""
    found = {str(light.get("name")): light.get("direction") for light in truth.facts.get("lights") or []}
    unknown = [name for name in layers.lights if found.get(name) is None]
    if unknown:
        raise InputError(f"{METHOD}: a light of unknown direction", got=unknown[0], expected="distant lights")
    directions = np.array([found[name] for name in layers.lights], dtype=np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if len(directions) < LEAST_LIGHTS or np.linalg.cond(directions) > LARGEST_CONDITION:
        got = f"{len(directions)} lights"
        raise InputError(f"{METHOD}: three lights that do not lie in one plane are needed", got=got)
    return directions


def run_references(items: list[Item], methods: list[str], *, overwrite: bool, say: Callable[[str], None]) -> None:
    """Write the estimates of the reference ``methods`` that the finished ``items`` lack. Raises InputError."""
    for item in (item for item in items if item.status == "done"):
        for method in methods:
            picture = inside(item.folder, "observation.exr")
            place = (item.results or item.folder) / "estimates"
            if not overwrite and _is_there(item, method, sha256_of(picture)):
                continue
            started = time.perf_counter()
            layers = read_layers(inside(item.folder, "layers.exr"))
            try:
                estimate = known_lights_estimate(layers, read_truth(inside(item.folder, "truth.exr")))
            except InputError as problem:
                estimate = _failed(str(problem), read_observation(picture).mask)
            seconds = time.perf_counter() - started
            write_estimate(place, replace(estimate, seconds=seconds), picture)
            say(f"{item.id}  {method}  {estimate.status}: {estimate.message}")


def _failed(message: str, mask: np.ndarray) -> Estimate:
    """An estimate without normals. The status is one that `recover` has for such pictures."""
    nothing = np.zeros(mask.shape, bool)
    normals = np.full((*mask.shape, 3), np.nan, np.float32)
    return Estimate(METHOD, "lights-not-known", message, normals, nothing, nothing, normals[..., 0])


def _is_there(item: Item, method: str, sha256: str) -> bool:
    folder = item.estimates_of(method)
    if folder is None:
        return False
    try:
        return read_estimate(folder, method)[1] == sha256
    except InputError:
        return False
