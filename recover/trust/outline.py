"""What the outline of an object says of its normals: how they lean, and what one matrix makes of an inflated outline.

The matrix is regressed from colours to the normals of the inflated outline (``recover.cues.inflated_outline``). It
depends neither on integrability nor on the ellipsoid nor on any light, so it tests what rests on these (source: this
project, research log).
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
DARKEST = 0.15  # of the median length: the direction of darker colours is mostly noise


@dataclass(frozen=True)
class Outline:
    """How the normals of an estimate agree with the object's outline; the defaults hold where there is no outline."""

    outward: float = 0.0  # −1 (all normals lean inward) … 1 (all lean outward)
    rim_deg: float = LARGEST_DEG  # median angle of the normals next to the outline from the outline's own
    template_deg: float = LARGEST_DEG  # median angle of the normals from those by the matrix
    template_other_deg: float = LARGEST_DEG  # the same of the convex/concave twin's normals


def outline(normals: np.ndarray, given: np.ndarray, mask: np.ndarray, rgb: np.ndarray, usable: np.ndarray) -> Outline:
    """How ``normals`` (H, W, 3), known where ``given``, agree with the outline of the object ``mask`` (H, W).

    ``rgb`` (H, W, 3): colours, which count where ``usable`` (H, W).
    """
    if not given.any() or not has_silhouette(mask):
        return Outline()
    return Outline(
        outward_margin(normals, given, mask),
        _rim_deg(normals, given, mask),
        *_template_deg(normals, given, mask, rgb, usable),
    )


def _rim_deg(normals: np.ndarray, given: np.ndarray, mask: np.ndarray) -> float:
    """Median angle between the normals next to the outline and (u, 0), u its outward direction, degrees.

    Less that angle of a ball of the same area one pixel within its outline, √(2 / radius): pixels lie a little within.
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
    """Median angles, degrees, of the normals and of their twins from the directions that a matrix makes of colours.

    The matrix is regressed from the colours' directions to the template's normals, with robust weights.
    """
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
