"""What the outline of an object says of its normals: how they lean, and what one matrix makes of an inflated outline.

One matrix that is regressed from colours to the normals of the inflated outline (``recover.cues.inflated_outline``) has
no part in integrability, in the ellipsoid or in any light (source: this project, research log).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.convexity import outward_margin
from huesphere.recover.cues.inflated_outline import inflated
from huesphere.recover.cues.parameters import CUES
from huesphere.recover.cues.silhouette import has_silhouette
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.trust.without_result import FEWEST, LARGEST_DEG

MOST_PIXELS = 10_000  # of the template's mask: larger ones are thinned out
ROUNDS = 10  # of reweighting
WIDTH_DEG = 15.0  # of Cauchy's weights in the regression
DARKEST = 0.15  # of the median length: darker colours have no direction to speak of


@dataclass(frozen=True)
class Outline:
    """How the normals of an estimate agree with the object's outline; without an outline they neither do nor not."""

    outward: float = 0.0  # −1 … 1
    rim_deg: float = LARGEST_DEG
    template_deg: float = LARGEST_DEG
    template_other_deg: float = LARGEST_DEG


def outline(normals: np.ndarray, given: np.ndarray, mask: np.ndarray, rgb: np.ndarray, usable: np.ndarray) -> Outline:
    """Of ``normals`` (H, W, 3) known where ``given``, of the object ``mask``, whose colours are ``rgb`` (H, W, 3)."""
    if not given.any() or not has_silhouette(mask):
        return Outline()
    return Outline(
        outward_margin(normals, given, mask),
        _rim_deg(normals, given, mask),
        *_template_deg(normals, given, mask, rgb, usable),
    )


def _rim_deg(normals: np.ndarray, given: np.ndarray, mask: np.ndarray) -> float:
    """Median angle between the normals next to the outline and (u, 0), u its outward direction, degrees.

    Less the angle that a ball of the same area has there, since pixels lie a little within the outline.
    """
    near = ndimage.gaussian_filter(mask.astype(float), CUES.outward_blur_px, mode="constant")
    down, right = np.gradient(near)
    rim = given & (ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] <= 2)
    if rim.sum() < FEWEST:
        return LARGEST_DEG
    u = np.stack([-right, down], axis=-1)[rim]
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    cosine = np.clip((normals[rim][:, :2] * u).sum(axis=1), -1, 1)
    of_ball = np.degrees(np.sqrt(2 / np.sqrt(mask.sum() / np.pi)))
    return float(max(np.degrees(np.median(np.arccos(cosine))) - of_ball, 0.0))


def _template_deg(
    normals: np.ndarray, given: np.ndarray, mask: np.ndarray, rgb: np.ndarray, usable: np.ndarray
) -> tuple[float, float]:
    """(median angle of the normals, of their twins, from G ρ), G regressed on the template's normals, degrees."""
    step = max(1, int(np.ceil(np.sqrt(mask.sum() / MOST_PIXELS))))
    normals, given, mask, rgb, usable = (image[::step, ::step] for image in (normals, given, mask, rgb, usable))
    template = inflated(mask)
    length = np.linalg.norm(rgb, axis=-1)
    bright = usable & mask & (length > DARKEST * np.median(length[usable & mask])) if (usable & mask).any() else usable
    if bright.sum() < FEWEST or (bright & given).sum() < FEWEST:
        return LARGEST_DEG, LARGEST_DEG
    X, wanted = rgb[bright] / length[bright][:, None], template[bright]
    weight = np.ones(len(X))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        G = np.linalg.lstsq(X * root, wanted * root, rcond=None)[0]
        found = X @ G
        found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
        angle = np.degrees(np.arccos(np.clip((found * wanted).sum(axis=1), -1, 1)))
        weight = 1 / (1 + (angle / WIDTH_DEG) ** 2)
    both = given[bright]
    n = normals[bright][both]
    cosines = [np.clip((found[both] * n * turn).sum(axis=1), -1, 1) for turn in (np.ones(3), np.diag(TWIN))]
    own, other = (float(np.degrees(np.median(np.arccos(cosine)))) for cosine in cosines)
    return own, other
