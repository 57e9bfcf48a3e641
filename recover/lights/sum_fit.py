"""All lights fitted at once so that together they are all the light there is: Σ b aᵀ = F.

Where colours are a little wrong, as after interreflection was removed, the pixels that miss a light leave its colour
uncertain along one direction, while its direction is certain. That the lights add up to F holds them there. It is no
evidence for them: wrong lights can be made to add up as well.
"""

import numpy as np

from huesphere.recover.lights.polish import equations_beside, loss_beside

ROUNDS = 12  # of damped least squares, at most
DAMPING, MOST_DAMPING = 1e-6, 1e2  # at the start, and at most; relative to the diagonal of H
MORE, LESS = 10.0, 0.3  # factors of the damping after a step that raised the cost, and after one that lowered it

Pixels = tuple[np.ndarray, np.ndarray, np.ndarray]  # rho, bases, ends, as in ``polish.polished_beside``


def fitted_to_sum(pixels: list[Pixels], F: np.ndarray, lights: np.ndarray, width: float, slack: float) -> np.ndarray:
    """The ``lights`` (K, 6), each (b, a), fitted to the pixels that miss each of them and to F (3, 3) together.

    ``pixels``: K entries, the pixels that miss each light. ``width`` of Cauchy's loss of a pixel, and standard
    deviation ``slack`` of each element of Σ b aᵀ − F, both in picture units. The matrices ``bases``, which the pixels
    would have if they saw their light, stay as they are given, though the other lights in them are fitted too.
    """
    count = len(lights)

    def penalty(both: np.ndarray) -> np.ndarray:
        return (np.einsum("ki,kj->ij", both[:, :3], both[:, 3:]) - F).ravel() / slack

    def cost(both: np.ndarray) -> float:
        data = sum(len(one[0]) * loss_beside(*one, each, width) for one, each in zip(pixels, both) if len(one[0]))
        return float(data + (penalty(both) ** 2).sum())

    now, damping = lights.copy(), DAMPING
    best = cost(now)
    for _ in range(ROUNDS):
        H, g, J = np.zeros((6 * count, 6 * count)), np.zeros(6 * count), np.zeros((9, 6 * count))
        for k, (b, a) in enumerate(zip(now[:, :3], now[:, 3:])):
            own = slice(6 * k, 6 * k + 6)
            if len(pixels[k][0]):
                H[own, own], g[own] = equations_beside(*pixels[k], now[k], width)
            J[:, own] = np.hstack([np.kron(np.eye(3), a[:, None]), np.kron(b[:, None], np.eye(3))]) / slack
        H, g = H / width**2 + J.T @ J, g / width**2 + J.T @ penalty(now)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), 1e-300))
        moved = False
        while damping < MOST_DAMPING and not moved:
            A = H * np.outer(scale, scale) + damping * np.eye(len(g))
            trial = now - (np.linalg.solve(A, g * scale) * scale).reshape(now.shape)
            size = np.linalg.norm(trial[:, 3:], axis=1, keepdims=True)
            trial = np.hstack([trial[:, :3] * size, trial[:, 3:] / size])
            reached = cost(trial)
            moved = reached < best
            damping *= LESS if moved else MORE
        if not moved:
            break
        now, best = trial, reached
    return now
