"""One matrix from colours to normals, regressed on the normals of the inflated outline.

Where ρ = a F n with a brightness a that is free at every pixel, n ∝ Gρ with G = F⁻¹ up to a factor. G is the matrix
for which the directions of Gρ are nearest to those of the template (``inflated_outline``). The template is far off at
single pixels; but one matrix has eight unknowns, thousands of pixels decide, and what the template lacks of the surface
is mostly no linear function of the colour. A robust loss bounds the pull of places where the template is wrong.
Shadowed pixels take part: those near the outline carry the conditioning.

Source: this project (research log, "What the outline tells without an ellipsoid").
"""

import numpy as np

ROUNDS = 30  # of reweighting
WIDTH_DEG = 15.0  # of Cauchy's weights: about the angle that the template is off by
DARKEST = 0.15  # of the median length: darker colours have no direction to speak of
GUARD = 1e-12  # of a division by a length


def bright_enough(rgb: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of ``usable`` that are not so dark that their colour has no direction to speak of."""
    length = np.linalg.norm(rgb, axis=-1)
    return usable & (length > DARKEST * np.median(length[usable])) if usable.any() else usable


def whitening(colours: np.ndarray) -> np.ndarray:
    """W (3, 3), symmetric, that gives colours (P, 3) second moments of 1: so results do not depend on the channels.

    Raises LinAlgError where the colours span fewer than three dimensions.
    """
    moments, axes = np.linalg.eigh(colours.T @ colours / len(colours))
    if not moments[0] > 0:
        raise np.linalg.LinAlgError("the colours lie in a plane")
    return (axes / np.sqrt(moments)) @ axes.T  # type: ignore[no-any-return]


def matrix_to_template(directions: np.ndarray, template: np.ndarray, rounds: int = ROUNDS) -> np.ndarray:
    """G (3, 3) of |det G| = 1 with G d ∝ n for unit colours ``directions`` (P, 3) and normals ``template`` (P, 3).

    Iteratively reweighted least squares of |G d / |G d| − n|, with the weights 1 / √(1 + (angle / WIDTH_DEG)²).
    Raises LinAlgError where the colours span fewer than three dimensions.
    """
    G, scale = np.eye(3), np.ones(len(directions))
    weight: np.ndarray = np.ones(len(directions))
    for _ in range(rounds):
        root = (np.sqrt(weight) / scale)[:, None]
        G = np.linalg.lstsq(directions * root, template * root * scale[:, None], rcond=None)[0].T
        found = directions @ G.T
        scale = np.maximum(np.linalg.norm(found, axis=1), GUARD)
        angle = np.degrees(np.arccos(np.clip((found * template).sum(axis=1) / scale, -1, 1)))
        weight = 1 / np.sqrt(1 + (angle / WIDTH_DEG) ** 2)
    determinant = abs(float(np.linalg.det(G)))
    if not determinant > 0:
        raise np.linalg.LinAlgError("the colours lie in a plane")
    return G / np.cbrt(determinant)
