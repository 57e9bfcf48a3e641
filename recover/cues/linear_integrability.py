"""Whether an ellipsoid's pixels have the normals of a surface that faces the camera: a judge between shells.

With n = O N and rows r1, r2, r3 of the orthogonal O, p_y = q_x is, multiplied by n3² and hence without any division,

    r1·(N × N_x) + r2·(N × N_y) = 0,

linear in (r1, r2): one 6×6 matrix of sums over the pixels holds the error of every O. Along rays (x, y) of a picture in
perspective (``recover.geometry.rays``) the same reads

    (r1 + x r3)·(N × N_x) + (r2 + y r3)·(N × N_y) = 0,

for what the change of v adds to the one term it takes from the other. Two conditions keep O from
hiding it: all normals face the camera, and since every light stands in front of the object, a pixel that faces the
camera squarely, n = (0, 0, 1), sees them all, so it is among the shell's own. A blend of shells breaks one or another.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.robust_scale import mad_scale

DIRECTIONS = 1000  # of r3, over the sphere
SIGMA = 1.5  # pixels, of the derivatives
MOST_PIXELS = 1000
FACING = 0.97  # share of the normals that must face the camera
FRONTAL = np.cos(np.radians(8.0))  # …and among which some must lie this near to r3
MODEL_ERROR = 0.07  # of the size of the terms: what derivatives over several pixels may be off
ROUNDS = 3
TURNS, NEWTON_STEPS = 48, 4  # about r3, from which the best turn is looked for in perspective
FEWEST_FRONTAL = 0.004  # share of the normals that must lie near to r3
APART = np.cos(np.radians(12.0))  # r3 of different starts


@dataclass(frozen=True)
class Facing:
    """How far the best O is from making the normals those of a surface."""

    curl: float  # root mean square of the error over that of its terms: 0 integrable, 1 as bad as chance
    whiteness: float  # median of |error| over what noise and MODEL_ERROR make of it: about 0.7 if nothing is wrong
    frontal: bool  # some O faces the camera as it must
    aside_deg: float  # how far the normals keep from (0, 0, 1) under the best O that need not face the camera squarely


def facing(rgb: np.ndarray, core: np.ndarray, C: np.ndarray, *, noise: float, ray: np.ndarray | None = None) -> Facing:
    """The judgement on C (3, 3) from the pixels ``core`` (H, W) of the picture (H, W, 3), of this much ``noise``.

    ``ray`` (H, W, 2): of a picture in perspective.
    """
    h = symmetric_root(C)
    AB = _terms(rgb, core, h, ray)
    n = _unit_normals(rgb, core, h)
    faced, frontal = _directions(n)
    if not len(AB) or not len(frontal):
        return Facing(1.0, 9.0, False, 90.0)
    grain = noise / (np.sqrt(8 * np.pi) * SIGMA**2) * np.sqrt(np.trace(C) * 2 / 3)  # of a derivative of N
    variance = 2 * grain**2 + MODEL_ERROR**2 * np.einsum("pi,pi->p", AB[:, :6], AB[:, :6])
    rows, error = _robustly_best(AB, variance, frontal)
    terms = _size(AB, rows)
    curl = float(np.sqrt((error**2).sum() / terms.sum()))
    white = float(np.median(np.abs(error) / np.sqrt(2 * grain**2 + 0.01 * terms)))
    rows, _ = _robustly_best(AB, variance, faced)
    return Facing(curl, white, True, aside_deg(np.abs(n @ np.cross(rows[:3], rows[3:6]))))


def curl_under(
    rotation: np.ndarray, rgb: np.ndarray, core: np.ndarray, C: np.ndarray, *, ray: np.ndarray | None = None
) -> float:
    """The ``curl`` of ``Facing`` under one ``rotation`` (3, 3), n = rotation C^{1/2} ρ; 1 where pixels are too few."""
    AB = _terms(rgb, core, symmetric_root(C), ray)
    if not len(AB):
        return 1.0
    rows = rotation.ravel()[: AB.shape[1]]
    return float(np.sqrt(((AB @ rows) ** 2).sum() / _size(AB, rows).sum()))


def _size(AB: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Squared terms (P,) of which the error AB · rows is a difference."""
    (r1, r2), A, B = rows[:6].reshape(2, 3), AB[:, :3], AB[:, 3:6]
    return (A @ r1) ** 2 + (B @ r2) ** 2 + (A @ r2) ** 2 + (B @ r1) ** 2  # type: ignore[no-any-return]


def aside_deg(cosine: np.ndarray, *, fewest: int = 3) -> float:
    """How far normals keep from facing the camera squarely, degrees; ``cosine`` (P,): of the angles at which they do.

    At least so many of them, and FEWEST_FRONTAL of all, come as near.
    """
    count = max(fewest, int(FEWEST_FRONTAL * len(cosine)))
    return float(np.degrees(np.arccos(np.clip(np.sort(cosine)[-count], -1, 1))))


def likely_rotations(
    rgb: np.ndarray,
    core: np.ndarray,
    C: np.ndarray,
    *,
    noise: float,
    count: int,
    ray: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Up to ``count`` rotations and as many reflections (3, 3), n = R C^{1/2} ρ, apart from each other, the best first.

    Where no pixel faces the camera as it must, all directions that the normals face are tried.
    """
    h = symmetric_root(C)
    AB = _terms(rgb, core, h, ray)
    faced, frontal = _directions(_unit_normals(rgb, core, h))
    if not len(AB) or not len(faced):
        return []
    grain = noise / (np.sqrt(8 * np.pi) * SIGMA**2) * np.sqrt(np.trace(C) * 2 / 3)
    variance = 2 * grain**2 + MODEL_ERROR**2 * np.einsum("pi,pi->p", AB[:, :6], AB[:, :6])
    return _best_apart(AB, variance, frontal if len(frontal) else faced, count)


def _best_apart(AB: np.ndarray, variance: np.ndarray, r3: np.ndarray, count: int) -> list[np.ndarray]:
    """Up to ``count`` rotations, then as many reflections, of the least errors over all r3 (K, 3), APART in r3."""
    w = _robust_weights(AB @ _best(AB, 1 / variance, r3), variance)
    kept: list[np.ndarray] = []
    for hand, rows, value in _all(AB, w, r3):
        own: list[np.ndarray] = []
        for k in np.argsort(value, kind="stable"):
            r1, r2 = rows[k, :6].reshape(2, 3)
            rotation = np.stack([r1, r2, hand * np.cross(r1, r2)])
            if all(abs(rotation[2] @ other[2]) < APART for other in own):
                own.append(rotation)
                if len(own) == count:
                    break
        kept += own
    return kept


def _robustly_best(AB: np.ndarray, variance: np.ndarray, r3: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r1, r2) (6,) of the least error over all r3 (K, 3), and the errors (P,); in perspective (r1, r2, r3) (9,)."""
    w = 1 / variance
    for _ in range(ROUNDS):
        rows = _best(AB, w, r3)
        error = AB @ rows
        w = _robust_weights(error, variance)
    return rows, error


def _robust_weights(error: np.ndarray, variance: np.ndarray) -> np.ndarray:
    robust = max(1.0, mad_scale(error / np.sqrt(variance)))
    return 1 / variance / (1 + error**2 / variance / (4 * robust**2)) ** 2  # type: ignore[no-any-return]


def _unit_normals(rgb: np.ndarray, core: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Unit vectors (P, 3) of h ρ at some of the pixels of ``core`` (H, W)."""
    everyone = rgb[core][:: max(1, int(core.sum() // MOST_PIXELS))] @ h
    return everyone / np.linalg.norm(everyone, axis=1, keepdims=True)  # type: ignore[no-any-return]


def _terms(rgb: np.ndarray, core: np.ndarray, h: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """(N × N_x, N × N_y) (P, 6) at some of the pixels well within ``core``; (0, 6) if there are too few.

    In perspective (P, 9): then what r3 takes part with.
    """
    inside = ndimage.uniform_filter(core.astype(float), 7) > 0.999
    if inside.sum() < 50:
        inside = ndimage.binary_erosion(core, np.ones((5, 5)))
    if inside.sum() < 30:
        return np.empty((0, 6))
    chosen = np.flatnonzero(inside)[:: max(1, int(inside.sum() // MOST_PIXELS))]
    weight = np.maximum(ndimage.gaussian_filter(core.astype(float), SIGMA), 1e-6)[..., None]
    smooth = ndimage.gaussian_filter(np.where(core[..., None], rgb, 0.0), (SIGMA, SIGMA, 0)) / weight
    N_y, N_x = (g.reshape(-1, 3)[chosen] @ h for g in np.gradient(smooth, axis=(0, 1)))
    N = smooth.reshape(-1, 3)[chosen] @ h
    A, B = np.cross(N, N_x), -np.cross(N, N_y)  # rows run down, y up
    if ray is None:
        return np.concatenate([A, B], axis=1)
    x, y = ray.reshape(-1, 2)[chosen].T[:, :, None]
    return np.concatenate([A, B, x * A + y * B], axis=1)


def _directions(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r3 (K, 3) to which nearly all of the unit vectors n (P, 3) face, and those of them to which some come near."""
    r3 = fibonacci(DIRECTIONS)
    cosine = n @ r3.T
    faced = (cosine > 0).mean(axis=0) >= FACING
    near = (cosine > FRONTAL).sum(axis=0) >= max(3, FEWEST_FRONTAL * len(n))
    return r3[faced], r3[faced & near]


def _best(AB: np.ndarray, w: np.ndarray, r3: np.ndarray) -> np.ndarray:
    """(r1, r2) (6,), of either handedness, with the least weighted error over that of its terms, over all r3 (K, 3).

    In perspective (r1, r2, r3) (9,).
    """
    _, rows, value = min(_all(AB, w, r3), key=lambda entry: float(entry[2].min()))
    return rows[np.argmin(value)]  # type: ignore[no-any-return]


def _all(AB: np.ndarray, w: np.ndarray, r3: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """For either handedness, ±1: the best (r1, r2) (K, 6) about each r3 (K, 3) and its error over its terms (K,).

    In perspective (r1, r2, r3) (K, 9).
    """
    gram = (AB * w[:, None]).T @ AB
    terms = gram[:3, :3] + gram[3:6, 3:6]
    other = np.where(np.abs(r3[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    a = np.cross(r3, other)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(r3, a)
    scale = np.einsum("ki,ij,kj->k", a, terms, a) + np.einsum("ki,ij,kj->k", b, terms, b)
    found = []
    for hand in (1.0, -1.0):
        # r1 = cos t a + sin t b, r2 = hand (−sin t a + cos t b): the error is a quadratic form of (cos t, sin t).
        u, v = np.concatenate([a, hand * b], axis=1), np.concatenate([b, -hand * a], axis=1)
        if AB.shape[1] > 6:
            found.append((hand, *_turned(gram, u, v, r3, scale)))
            continue
        uu, vv, uv = (np.einsum("ki,ki->k", s @ gram, t) for s, t in ((u, u), (v, v), (u, v)))
        least = (uu + vv) / 2 - np.hypot((uu - vv) / 2, uv)
        t = (0.5 * np.arctan2(-2 * uv, vv - uu))[:, None]  # where cos² uu + sin² vv + 2 sin cos uv is least
        found.append((hand, np.cos(t) * u + np.sin(t) * v, least / scale))
    return found


def _turned(
    gram: np.ndarray, u: np.ndarray, v: np.ndarray, r3: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(cos t u + sin t v, r3) (K, 9) of least error, and that over ``scale`` (K,): a trigonometric polynomial in t."""
    still = np.concatenate([np.zeros_like(u), r3], axis=1)
    u, v = (np.concatenate([s, np.zeros_like(r3)], axis=1) for s in (u, v))
    uu, vv, uv, ud, vd, dd = (
        np.einsum("ki,ki->k", s @ gram, t)[:, None]
        for s, t in ((u, u), (v, v), (u, v), (u, still), (v, still), (still, still))
    )

    def error(t: np.ndarray) -> np.ndarray:
        c, s = np.cos(t), np.sin(t)
        return c * c * uu + s * s * vv + 2 * c * s * uv + 2 * c * ud + 2 * s * vd + dd  # type: ignore[no-any-return]

    around = np.arange(TURNS) * (2 * np.pi / TURNS)
    t = around[np.argmin(error(around), axis=1)][:, None]
    for _ in range(NEWTON_STEPS):
        c, s = np.cos(t), np.sin(t)
        slope = 2 * c * s * (vv - uu) + 2 * (c * c - s * s) * uv - 2 * s * ud + 2 * c * vd
        bend = 2 * (c * c - s * s) * (vv - uu) - 8 * c * s * uv - 2 * c * ud - 2 * s * vd
        step = np.where(bend > 0, -slope / np.where(bend > 0, bend, 1.0), 0.0)
        t = t + np.clip(step, -np.pi / TURNS, np.pi / TURNS)
    return np.cos(t) * u + np.sin(t) * v + still, np.maximum(error(t)[:, 0], 0.0) / scale
