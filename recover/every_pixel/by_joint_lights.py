"""Every pixel labelled by lights that were found together with the surface (``recover.lights.lit_surface``).

The surface shows which lights a pixel is turned away from, and gives its normal to a few degrees; within these, the
pixel's own colour gives the normal. A pixel that this does not explain may be in the cast shadow of one light more. A
pixel that remains unexplained keeps the normal of the surface, which is interpolated between blocks of pixels; its own
colour then has no influence.
"""

from functools import partial

import numpy as np

from huesphere.recover.every_pixel.by_light_sets import LabelledPixels, with_explained_neighbours
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.geometry.sphere import near_normals
from huesphere.recover.lights.lit_surface import LitSurface
from huesphere.recover.lights.model import Light, Lights
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem

PIXELS_AT_ONCE = 16_384  # bounds the memory


def lights_of(found: LitSurface, labelled: LabelledPixels) -> Lights:
    """The lights in the form of those that are found one by one, each with the pixels that miss it."""
    lights = []
    for j, (toward, colour) in enumerate(zip(found.toward, found.colour)):
        missed = labelled.explained & (labelled.missed >> j & 1 > 0)
        attached = (labelled.normals[missed] @ toward < 0).mean() if missed.any() else 0.0
        lights.append(Light(toward, colour, int(missed.sum()), 0.0, float(attached)))
    return Lights(tuple(lights), missing=0.0)


def label_by_joint_lights(problem: Problem, found: LitSurface) -> LabelledPixels:
    """Labels and normals of all pixels of the object, by the lights and the surface that were ``found`` together."""
    usable, mask, within = problem.usable, problem.mask, LIGHTS.outlier_deviations * problem.noise
    normals, missed = found.normals.copy(), np.full(mask.shape, -1)
    rho, start = problem.rgb[usable].astype(np.float64), found.normals[usable]
    seen = start @ found.toward.T > 0
    own, distance = _nearest(rho, start, seen, found, problem.noise)
    for light in range(len(found.toward)):
        unexplained = np.flatnonzero((distance > within) & seen[:, light])
        if not len(unexplained):
            continue
        without = seen[unexplained]
        without[:, light] = False
        n, residual = _nearest(rho[unexplained], start[unexplained], without, found, problem.noise)
        near, image = np.zeros(len(rho), bool), np.zeros(mask.shape, bool)
        near[unexplained] = residual < within
        image[usable] = near
        better = near[unexplained] & with_explained_neighbours(image)[usable][unexplained]
        own[unexplained[better]], distance[unexplained[better]] = n[better], residual[better]
        seen[unexplained[better], light] = False
    explained = np.zeros(mask.shape, bool)
    explained[usable] = distance < within
    normals[usable] = np.where(explained[usable][:, None], own, start)
    missed[usable] = np.where(seen, 0, 1 << np.arange(seen.shape[1])).sum(axis=1)
    return LabelledPixels(normals, missed, explained, mask & ~explained, np.zeros(mask.shape, bool))


def _nearest(
    rho: np.ndarray, start: np.ndarray, seen: np.ndarray, found: LitSurface, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """(normals (P, 3), lengths of the residuals (P,)) of pixels that see the lights ``seen`` (P, K).

    Normals whose colours are near ``rho`` (P, 3), by the ``noise`` of a channel, and which are near ``start`` (P, 3).
    """
    out, residual = np.empty_like(rho), np.empty(len(rho))
    products = (found.colour[:, :, None] * found.toward[:, None, :]).reshape(-1, 9)
    for first in range(0, len(rho), PIXELS_AT_ONCE):
        part = slice(first, first + PIXELS_AT_ONCE)
        M = (seen[part] @ products).reshape(-1, 3, 3)
        colour_of = partial(_lit_by, M)
        out[part] = near_normals(rho[part], colour_of, start[part], noise, EVERY_PIXEL.between_blocks_deg)
        residual[part] = np.linalg.norm(rho[part] - colour_of(out[part])[0], axis=1)
    return out, residual


def _lit_by(M: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours (P, 3) of normals (P, 3) under the matrices M (P, 3, 3), and their derivative by the normal."""
    return np.einsum("pij,pj->pi", M, n), M
