"""Normals of pixels that nothing explains: the surface between their neighbours, leaning on what their colours say.

A pixel that misses lights which were not found has no matrix of its own. The surface interpolated between the explained
pixels knows nothing of its colour ρ, and in wide gaps it is far from the true one. The normal that ρ would have if the
pixel saw every light, v / |v| with v = F⁻¹ρ, is wrong too, by F⁻¹ Σ b (a·n) over the lights b aᵀ that are missed. Which
of the two is better depends on the lights and on the surface, and the picture shows it. An error of v in all directions
alike changes its length as much as it moves v along each direction across, so the mean square error of its angle is
2 ⟨(|v| − 1)²⟩. Where one light is missed alone the length may stay, but then v turns at the border of the gap. There
the interpolated normal is right, so the mean square angle between it and v is a second figure for the error of v (from
the median, which outliers do not move). The larger figure counts. The mean square of the angle between v and the
interpolated normal over the whole gap is the sum of the errors of both: what remains after that of v is subtracted is
the error of the interpolated normal. In the mean of the two directions each has the other's error as its weight, which
makes the error of their mean least (figures in docs/research-log.md).
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from huesphere.recover.every_pixel.by_light_sets import LabelledPixels, interpolated_normals
from huesphere.recover.geometry.rays import of_relief, of_surface
from huesphere.recover.geometry.sphere import unit
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

STEEPEST = 0.15  # least cosine to the direction of the camera of a normal whose slope is integrated
DARKEST = 3.0  # |F⁻¹ρ| in units of its noise at which the normal by colour and the interpolated one count alike
RMS_BY_MEDIAN = 1.2  # of the length of a vector in the plane whose components are Gaussian: 1 / √(ln 2)
LEAST_SHARE = 0.04  # least mean square error of the interpolated normal, over the mean square angle between both


def leaning_on_colour(labelled: LabelledPixels, problem: Problem, solution: Solution) -> LabelledPixels:
    """The labels, with other normals of the pixels that were ``interpolated``.

    Dark pixels, whose colour is noise, and those without a usable sample keep the interpolated normal.
    """
    gap, mask, ray = labelled.interpolated, problem.mask, problem.ray
    coloured = gap & problem.usable
    if not coloured.any():
        return labelled
    inverse = np.linalg.inv(solution.F)
    v = np.where(coloured[..., None], problem.rgb - solution.ambient, 0.0) @ inverse.T
    length = np.linalg.norm(v, axis=-1)
    noise = DARKEST * problem.noise * np.linalg.norm(inverse)
    # Weight from 0 to 1 of each pixel's own colour: 1 where it is bright against the noise.
    clear = np.where(coloured, length**2 / np.maximum(length**2 + noise**2, 1e-300), 0.0)[..., None]
    by_colour = _facing((1 - clear) * labelled.normals + clear * unit(v), ray)
    start = np.where(gap[..., None], by_colour, labelled.normals)
    surface = interpolated_normals(np.where(mask[..., None], start, 0.0), mask, mask, ray)
    border = coloured & ndimage.binary_dilation(mask & ~gap)
    weight = clear * _weight_of_colour(v, labelled.normals, coloured, border)
    # What colour says is itself a mean of two: each pixel's normal by its colour, which shows detail, and that of the
    # depth map integrated over all of them, whose errors are smoother. Neither is better throughout; both count alike.
    normals = unit(weight * unit(by_colour + surface) + (1 - weight) * labelled.normals)
    return replace(labelled, normals=np.where(gap[..., None], normals, labelled.normals))


def _weight_of_colour(v: np.ndarray, between: np.ndarray, gap: np.ndarray, border: np.ndarray) -> float:
    """Weight, 0 to 1, of the directions v (H, W, 3) in a mean with the interpolated normals ``between`` (H, W, 3).

    From the pixels ``gap`` (H, W), and those of them along the ``border`` (H, W).
    """
    squared = np.zeros(gap.shape)
    squared[gap] = np.arccos(np.clip(np.sum(unit(v[gap]) * between[gap], axis=-1), -1, 1)) ** 2
    of_colour = 2 * float(np.mean((np.linalg.norm(v[gap], axis=-1) - 1) ** 2))
    of_colour = max(of_colour, RMS_BY_MEDIAN**2 * float(np.median(squared[border])) if border.any() else 0.0)
    apart = float(squared[gap].mean())
    of_surface_between = max(apart - of_colour, LEAST_SHARE * apart)
    return of_surface_between / max(of_surface_between + of_colour, 1e-300)


def _facing(n: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Unit normals (H, W, 3) along ``n``, turned toward the camera where they are steeper than STEEPEST."""
    relief = unit(of_relief(n, ray))
    return of_surface(unit(np.concatenate([relief[..., :2], np.maximum(relief[..., 2:], STEEPEST)], axis=-1)), ray)
