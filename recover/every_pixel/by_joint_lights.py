"""Every pixel by lights that were found together with the surface (``recover.lights.lit_surface``): what it sees, its
normal.

The surface says which lights a pixel is turned away from; its own colour, which it lies within a few degrees. A pixel
that this does not explain may be in the cast shadow of one light more. What is left keeps the surface's normal, which
is that of the depth about it.
"""

from functools import partial

import numpy as np
from scipy import ndimage

from huesphere.recover.every_pixel.by_light_sets import LONE, Knitted
from huesphere.recover.geometry.sphere import near_normals
from huesphere.recover.lights.lit_surface import LitSurface
from huesphere.recover.lights.model import WITHIN, Light, Lights

NEAR_DEG = 5.0  # of the surface between blocks, where a pixel's own normal is sought
AT_ONCE = 16_384  # pixels


def lights_of(found: LitSurface, knitted: Knitted) -> Lights:
    """The lights as those that are found one by one, each with the pixels that miss it."""
    lights = []
    for j, (toward, colour) in enumerate(zip(found.toward, found.colour)):
        missed = knitted.explained & (knitted.off >> j & 1 > 0)
        attached = (knitted.normals[missed] @ toward < 0).mean() if missed.any() else 0.0
        lights.append(Light(toward, colour, int(missed.sum()), 0.0, float(attached)))
    return Lights(tuple(lights), missing=0.0)


def knit_lit(rgb: np.ndarray, usable: np.ndarray, mask: np.ndarray, found: LitSurface, noise: float) -> Knitted:
    """Normals of all of ``mask`` (H, W), from colours (H, W, 3) that count where ``usable`` (H, W).

    ``noise``: standard deviation of a channel, picture units.
    """
    normals, off = found.normals.copy(), np.full(mask.shape, -1)
    rho, start = rgb[usable].astype(np.float64), found.normals[usable]
    seen = start @ found.toward.T > 0
    own, distance = _nearest(rho, start, seen, found, noise)
    for light in range(len(found.toward)):
        doubtful = np.flatnonzero((distance > WITHIN * noise) & seen[:, light])
        if not len(doubtful):
            continue
        without = seen[doubtful]
        without[:, light] = False
        n, left = _nearest(rho[doubtful], start[doubtful], without, found, noise)
        near, image = np.zeros(len(rho)), np.zeros(mask.shape)
        near[doubtful] = left < WITHIN * noise
        image[usable] = near
        better = (near[doubtful] > 0) & (ndimage.uniform_filter(image, 3)[usable][doubtful] > LONE)
        own[doubtful[better]], distance[doubtful[better]] = n[better], left[better]
        seen[doubtful[better], light] = False
    explained = np.zeros(mask.shape, bool)
    explained[usable] = distance < WITHIN * noise
    normals[usable] = np.where(explained[usable][:, None], own, start)
    off[usable] = np.where(seen, 0, 1 << np.arange(seen.shape[1])).sum(axis=1)
    return Knitted(normals, off, explained, mask & ~explained, np.zeros(mask.shape, bool))


def _nearest(
    rho: np.ndarray, start: np.ndarray, seen: np.ndarray, found: LitSurface, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """(normals (P, 3), what they leave of the colours (P,)): near ``rho`` (P, 3) by the noise, and near ``start``.

    Of pixels that see the lights ``seen`` (P, K).
    """
    out, left = np.empty_like(rho), np.empty(len(rho))
    products = (found.colour[:, :, None] * found.toward[:, None, :]).reshape(-1, 9)
    for first in range(0, len(rho), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        M = (seen[part] @ products).reshape(-1, 3, 3)
        colour_of = partial(_lit_by, M)
        out[part] = near_normals(rho[part], colour_of, start[part], noise, NEAR_DEG)
        left[part] = np.linalg.norm(rho[part] - colour_of(out[part])[0], axis=1)
    return out, left


def _lit_by(M: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours (P, 3) of normals (P, 3) under the matrices M (P, 3, 3), and their change by the normal."""
    return np.einsum("pij,pj->pi", M, n), M
