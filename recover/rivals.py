"""Which of several shells sees every light, where each is a true shell: the one that faces the camera squarely.

Pixels that miss one and the same light lie on an ellipsoid as true as that of the all-lit ones, and may be more. Since
max(0, x) = x + max(0, −x), a light and one opposite it tell the two apart as little as their colours do; but lights
stand in front of the object, so that the normal (0, 0, 1) sees them all and is on the shell of all-lit pixels. Which
shell holds it is seen once its rotation is known: so the likeliest of each rival is found by tangents
(``recover.tangents``), roughly, without asking that any normal face the camera squarely.
"""

from dataclasses import replace

import numpy as np

from recover.facing import aside_deg, likely_rotations, unit_normals
from recover.faint import without_faint
from recover.root import symmetric_root
from recover.shells import Shell, credited, difference
from recover.tangents import rough_rotation

MOST, WORTH = 10, 4.0  # shells looked at; how many times less than the best one may score to be a rival
APART = 0.1  # ``difference`` of shells that are rivals and not the same
STARTS = 2  # of each handedness, facing squarely and not
NEAR_DEG, UNSURE_DEG = 5.0, 8.0  # aside by so little is not at all; and where, beyond that, the score is halved


def without_rivals(
    rgb: np.ndarray, usable: np.ndarray, shells: list[Shell], noise: float, ray: np.ndarray | None = None
) -> list[Shell]:
    """``shells``, the best first, anew in order, until the first is credited by how squarely it faces the camera.

    ``rgb`` (h, w, 3) is the picture that they were found in among its ``usable`` pixels (h, w), ``noise`` the standard
    deviation of a channel of it, ``ray`` (h, w, 2) its rays in perspective. As they are where no other scores nearly as
    much as the first.
    """
    best = shells[0]
    if not any(s.score > best.score / WORTH and difference(s.C, best.C) > APART for s in shells[1:]):
        return shells
    waiting, judged = list(shells), list[tuple[np.ndarray, float, Shell]]()
    for _ in range(MOST):
        first = waiting.pop(0)
        factor = next((factor for C, factor, _ in judged if difference(first.C, C) < APART), None)
        if factor is None:
            first = _pure(rgb, usable, first, noise, ray)
            factor = _squareness(rgb, first, noise, ray)
        judged.append((first.C, factor, replace(first, credit=first.credit * factor)))
        if not waiting or max(shell.score for *_, shell in judged) >= waiting[0].score:
            break
    return sorted([*(shell for *_, shell in judged), *waiting], key=lambda shell: -shell.score)


def _pure(rgb: np.ndarray, usable: np.ndarray, shell: Shell, noise: float, ray: np.ndarray | None) -> Shell:
    """The shell judged without the pixels that miss lights too faint to be seen missing, which still support it."""
    C, core, _ = without_faint(rgb, shell.core, shell.C, noise=noise, grain=noise)
    credit, judgement = credited(rgb, usable, core, C, noise, ray)
    return replace(shell, C=C, core=core, credit=credit, judgement=judgement)


def _squareness(rgb: np.ndarray, shell: Shell, noise: float, ray: np.ndarray | None) -> float:
    """0 … 1: 1 where some normals face the camera squarely, as far as the rotation is known."""
    G = symmetric_root(shell.C)
    starts = likely_rotations(rgb, shell.core, shell.C, noise=noise, count=STARTS, aside=True, ray=ray)
    found = rough_rotation(rgb @ G, shell.core, noise**2 * G @ G.T, starts, ray)
    if found is None:
        return 0.5
    rotation, stderr = found
    aside = max(0.0, aside_deg(np.abs(unit_normals(rgb, shell.core, G) @ rotation[2])) - NEAR_DEG)
    return 1 / (1 + aside**2 / (UNSURE_DEG**2 + np.degrees(stderr) ** 2))  # type: ignore[no-any-return]
