"""Which ellipsoid is the one of the pixels that see every light, when these may be as few as a tenth of the object.

Pixels that miss a light lie on ellipsoids of their own, and global fits blend them. Patches of the picture mostly do
not straddle two, so every small patch proposes an ellipsoid, the best proposals grow to all they hold
(``recover.ellipsoid.region_growing``), and of what has grown the one wins that most pixels support and whose normals
are those of a surface facing the camera (``recover.cues.linear_integrability``).
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.linear_integrability import Facing, facing
from huesphere.recover.ellipsoid import region_growing as growing
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import determination, whitening
from huesphere.recover.ellipsoid.noise_bias import without_noise
from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS, PRODUCTS, matrix_of
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.status import RecoveryFailure

WORKING_AREA = 16_000  # object pixels above which the search works on block means
USUAL_AREA = 11_000  # object pixels of the pictures on which the sizes below were set
HALF_WIDTHS = (4, 6, 9, 13, 18)  # pixels: patches are squares of twice this
STEP = 5.0  # pixels between patches
FULL = 0.7  # share of a patch that must be usable
MOST_MISFIT = 1.35  # of a patch's residual, over the noise
SEEDS = 40
REACHES = np.array([4, 4, 4, 4, 5, 6, 8, 10, 14, 20, 1000, 1000])
POLISHING = np.array([4.5, 4.0, 3.5, 3.0, 3.0])
CLEARLY = 0.4  # and above which one is clearly not the other
POLISHED, JUDGED = 30, 20  # candidates, the best supported
CURL, WHITENESS, ASIDE_DEG = 0.2, 1.2, 12.0  # where each alone halves the credit
EXCESS = 0.15  # of the scatter of its own pixels over the noise: the same
UNEXPLAINED = 0.1  # 1 − R² over all usable pixels: the same
OUTERMOST, BEYOND = 0.98, 1.0  # quantile of r over them, and where it halves the credit
NOT_FRONTAL = 0.3  # what is left of it by the third
WILD = 4.0  # standard deviations: what a distance counts at most
SAMPLE = 1000
SAME = 0.03  # of the largest |eigenvalue − 1| of C1^{-1/2} C2 C1^{-1/2}, below which two shells are one
LEAST_NOISE = 3e-4  # of the brightest colour


@dataclass(frozen=True)
class Shell:
    """One candidate ellipsoid, in picture units."""

    C: np.ndarray  # (3, 3)
    core: np.ndarray  # (h, w) bool, its pixels on the working grid
    support: float  # share of the usable pixels that it explains
    credit: float  # 0 … 1, how much its normals are those of a surface that faces the camera
    judgement: Facing

    @property
    def score(self) -> float:
        return self.support * self.credit


def bias_terms(V: np.ndarray) -> np.ndarray:
    """What noise of covariance V (3, 3) adds to normal equations, negated, (8, 6, 6).

    MᵀM needs Σ_a right_a · terms[a] + count · terms[6] added, and Mᵀ1 count · terms[7, 0]:
    ``recover.ellipsoid.noise_bias`` as numbers.
    """
    zero, units = np.zeros((6, 6)), np.eye(6)
    constant, right = without_noise(zero, np.zeros(6), 1, V)
    linear = [without_noise(zero, unit, 1, V)[0] - constant for unit in units]
    last = zero.copy()
    last[0] = right
    return np.stack([*linear, constant, last])


def working_grid(rgb: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """(block means (h, w, 3), blocks wholly usable (h, w), side of a block) of a picture too large to search whole."""
    block = max(1, round(np.sqrt(usable.sum() / WORKING_AREA)))
    if block == 1:
        return rgb, usable, 1
    h, w = rgb.shape[0] // block, rgb.shape[1] // block
    tiles = rgb[: h * block, : w * block].reshape(h, block, w, block, 3)
    whole = np.asarray(usable[: h * block, : w * block].reshape(h, block, w, block).all(axis=(1, 3)))
    return np.where(whole[..., None], tiles.mean(axis=(1, 3)), 0.0), whole, block


def clear_margin(shells: list[Shell]) -> float:
    """Score of the first over that of the best shell that is clearly another; inf if there is none."""
    others = [s.score for s in shells[1:] if difference(shells[0].C, s.C) > CLEARLY]
    return shells[0].score / max(max(others), 1e-300) if others else float("inf")


def find_shells(
    rgb: np.ndarray,
    usable: np.ndarray,
    *,
    noise: float,
    extra: list[np.ndarray] | None = None,
    ray: np.ndarray | None = None,
) -> list[Shell]:
    """Every shell that grows in the picture (h, w, 3), the best first.

    ``noise``: standard deviation of a channel, picture units. ``extra``: ellipsoids (3, 3) from elsewhere, as seeds.
    ``ray`` (h, w, 2): of a picture in perspective (``recover.geometry.rays``).
    """
    white = _whitened(rgb, usable, noise)
    T = white.T
    C, boxes = _seeds(white.rgb, usable, white.V, white.bias)
    if extra:
        inverse = np.linalg.inv(T)
        C = np.concatenate([C, [inverse.T @ E @ inverse for E in extra]])
        boxes = np.concatenate([boxes, np.tile([0, usable.shape[0], 0, usable.shape[1]], (len(extra), 1))])
    if not len(C):
        raise RecoveryFailure("no-dominant-shell", "no patch of the picture lies on an ellipsoid")
    cores = _grow(white, usable, C, boxes, REACHES, POLISHING[:0])
    C = C[_distinct(C, cores, POLISHED)]
    cores = _grow(
        white, usable, C, np.tile([0, usable.shape[0], 0, usable.shape[1]], (len(C), 1)), REACHES[:0], POLISHING
    )
    total = usable.sum()

    def judged(k: int) -> Shell:
        own, core = T.T @ C[k] @ T, cores[k].astype(bool)
        return Shell(own, core, float(core.sum() / total), *credited(rgb, usable, core, own, noise, ray))

    return sorted(in_threads(judged, _distinct(C, cores, JUDGED)), key=lambda shell: -shell.score)


def _distinct(C: np.ndarray, cores: np.ndarray, most: int) -> list[int]:
    """The largest of the shells that lived and are not the same as a larger one, at most so many."""
    kept: list[int] = []
    for k in np.argsort(-cores.sum(axis=(1, 2), dtype=np.int64), kind="stable"):
        if np.isfinite(C[k]).all() and all(difference(C[k], C[other]) > SAME for other in kept):
            kept.append(int(k))
            if len(kept) == most:
                break
    return kept


def credited(
    rgb: np.ndarray, usable: np.ndarray, core: np.ndarray, C: np.ndarray, noise: float, ray: np.ndarray | None = None
) -> tuple[float, Facing]:
    """(credit 0 … 1, judgement) of the ellipsoid C (3, 3) by its pixels ``core`` (h, w) of the picture (h, w, 3).

    Pixels that miss some of the lights of a shell keep near it and within: one that half of the ``usable`` are far
    from, by the robust R² of the report's 2.2, or that some are far beyond, is rather the shell of few lights.
    """
    judgement = facing(rgb, core, C, noise=noise, ray=ray)
    credit = 1 / (1 + (judgement.curl / CURL) ** 2) / (1 + (judgement.whiteness / WHITENESS) ** 2)
    credit /= 1 + (judgement.aside_deg / ASIDE_DEG) ** 2
    distance = np.clip(signed_distance(rgb[core], C) / max(noise, 1e-300), -WILD, WILD)
    credit /= 1 + (max(0.0, float(np.sqrt(np.mean(distance**2))) - 1) / EXCESS) ** 2
    r = residuals(rgb[usable], C)
    credit /= 1 + ((1 - determination(r)) / UNEXPLAINED) ** 2
    credit /= 1 + (max(0.0, float(np.quantile(r, OUTERMOST))) / BEYOND) ** 2
    return credit * (1.0 if judgement.frontal else NOT_FRONTAL), judgement


def refine(rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, *, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(C (3, 3), its pixels (H, W)): C refitted in rounds to its own among the ``usable``, at the size of the picture.

    Raises RecoveryFailure: no-dominant-shell where it loses its pixels.
    """
    white = _whitened(rgb, usable, noise)
    inverse = np.linalg.inv(white.T)
    own = np.ascontiguousarray((inverse.T @ C @ inverse)[None])
    boxes = np.array([[0, usable.shape[0], 0, usable.shape[1]]])
    cores = _grow(white, usable, own, boxes, REACHES[:0], POLISHING)
    if not np.isfinite(own).all():
        raise RecoveryFailure("no-dominant-shell", "the shell found on block means has no pixels of the whole picture")
    return white.T.T @ own[0] @ white.T, cores[0].astype(bool)


def difference(A: np.ndarray, B: np.ndarray) -> float:
    """max |eig(A⁻¹B) − 1|: how far two ellipsoids are apart in their worst direction, in squared radius."""
    from scipy.linalg import eigh

    return float(np.abs(eigh(B, A, eigvals_only=True) - 1).max())


@dataclass(frozen=True)
class _White:
    """Colours of the picture with second moments 𝟙, and what noise there is in them."""

    rgb: np.ndarray  # (h, w, 3), 0 where not usable
    T: np.ndarray  # (3, 3) from the picture's colours to these
    V: np.ndarray  # (3, 3) covariance of the noise of these
    bias: np.ndarray  # (8, 6, 6), of ``bias_terms``


def _whitened(rgb: np.ndarray, usable: np.ndarray, noise: float) -> _White:
    T = whitening(rgb[usable])
    V = noise**2 * (T @ T.T)
    return _White(np.where(usable[..., None], rgb @ T.T, 0.0), T, V, bias_terms(V))


def _grow(
    white: _White,
    usable: np.ndarray,
    C: np.ndarray,
    boxes: np.ndarray,
    reaches: np.ndarray,
    polishing: np.ndarray,
) -> np.ndarray:
    """Pixels (K, h, w) of the shells that C (K, 3, 3), changed in place, grow to from their boxes (K, 4)."""
    weight = np.empty(usable.shape)
    growing.box_sums(usable.astype(float), growing.HALF, weight)
    cores = np.zeros((len(C), *usable.shape), np.uint8)
    flags = usable.astype(np.uint8)

    def one(k: int) -> None:
        growing.grow(white.rgb, flags, weight, white.V, white.bias, boxes[k], C[k], reaches, polishing, cores[k])

    in_threads(one, range(len(C)))
    return cores


def _seeds(white: np.ndarray, usable: np.ndarray, V: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C (K, 3, 3), boxes (K, 4)) of the patches whose ellipsoids most of the picture supports."""
    scale = np.sqrt(usable.sum() / USUAL_AREA)
    sums = _tables(white, usable)
    z_all, box_all = [], []
    for half in HALF_WIDTHS:
        half = max(3, round(half * scale))
        step = max(2, round(STEP * scale * (1 + half / (30 * scale))))
        z, box = _fit_boxes(sums, half, step, V, bias)
        z_all.append(z)
        box_all.append(box)
    z, box = np.concatenate(z_all), np.concatenate(box_all)
    if not len(z):
        return np.empty((0, 3, 3)), box
    rows, columns = np.nonzero(usable)
    some = np.random.default_rng(0).choice(len(rows), min(SAMPLE, len(rows)), replace=False)
    cost = _cost(white[rows[some], columns[some]], z, V)
    chosen: list[int] = []
    middle = (box[:, :2].sum(axis=1) / 2, box[:, 2:].sum(axis=1) / 2)
    near = (1.5 * STEP * scale) ** 2
    for k in np.argsort(cost, kind="stable"):
        close = sum((middle[0][k] - middle[0][c]) ** 2 + (middle[1][k] - middle[1][c]) ** 2 < near for c in chosen)
        if close < 2:
            chosen.append(int(k))
        if len(chosen) == SEEDS:
            break
    return np.ascontiguousarray(matrix_of(z[chosen])), box[chosen]


def _tables(white: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Summed-area tables (22, h + 1, w + 1): count, 6 products of two colours, 15 of four (order of ``kernels``)."""
    x, y, z = np.moveaxis(white, -1, 0)
    two = [x * x, y * y, z * z, x * y, x * z, y * z]
    xx, yy, zz, xy, xz, yz = two
    four = [xx * xx, yy * yy, zz * zz, xx * xy, xx * xz, xy * yy, yy * yz, xz * zz, yz * zz]
    four += [xx * yy, xx * zz, yy * zz, xx * yz, xy * yz, xy * zz]
    tables = np.zeros((22, white.shape[0] + 1, white.shape[1] + 1))
    tables[:, 1:, 1:] = np.stack([usable.astype(float), *two, *four]).cumsum(axis=1).cumsum(axis=2)
    return tables


def _fit_boxes(
    sums: np.ndarray, half: int, step: int, V: np.ndarray, bias: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(z (K, 6), boxes (K, 4)) of the square patches that lie on an ellipsoid as well as noise lets them."""
    height, width = sums.shape[1] - 1, sums.shape[2] - 1
    centres = np.meshgrid(np.arange(half // 2, height, step), np.arange(half // 2, width, step), indexing="ij")
    r, c = centres[0].ravel(), centres[1].ravel()
    box = np.stack([(r - half).clip(0), (r + half).clip(0, height), (c - half).clip(0), (c + half).clip(0, width)], -1)
    total = sums[:, box[:, 1], box[:, 3]] - sums[:, box[:, 0], box[:, 3]]
    total = (total - sums[:, box[:, 1], box[:, 2]] + sums[:, box[:, 0], box[:, 2]]).T
    full = total[:, 0] > FULL * 4 * half * half
    total, box = total[full], box[full]
    count, second, fourth = total[:, 0], total[:, 1:7], total[:, 7:]
    gram = FACTOR[:, None] * FACTOR * fourth[:, PRODUCTS]
    right = FACTOR * second
    clean = gram + np.einsum("ka,aij->kij", right, bias[:6]) + count[:, None, None] * bias[6]
    clean_right = right + count[:, None] * bias[7, 0]
    sound = np.isfinite(clean).all(axis=(1, 2)) & np.isfinite(clean_right).all(axis=1)
    if not sound.all():  # no noise could be told, in a picture of a few pixels
        return np.empty((0, 6)), box[:0]
    if not len(clean):
        return np.empty((0, 6)), box
    definite = np.linalg.eigvalsh(clean)[:, 0] > 1e-12 * np.trace(clean, axis1=1, axis2=2)
    ridge = 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300  # a patch of one colour has no inverse
    clean = np.where(definite[:, None, None], clean, gram + ridge * np.eye(6))
    clean_right = np.where(definite[:, None], clean_right, right)
    z = np.linalg.solve(clean, clean_right[..., None])[..., 0]
    C = matrix_of(z)
    eigenvalues = np.linalg.eigvalsh(C)
    # Mean r² against what noise makes of it, 4 tr(CVC S): both from the same sums.
    squared = np.einsum("ki,kij,kj->k", z, gram, z) - 2 * np.einsum("ki,ki->k", z, right) + count
    expected = 4 * np.einsum("kij,jl,klm,kmi->k", C, V, C, matrix_of(second))
    good = (eigenvalues[:, 0] > 5e-4 * eigenvalues[:, 2]) & (squared < MOST_MISFIT**2 * expected)
    return z[good], box[good]


def _cost(colours: np.ndarray, z: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Mean of min(1, (d / 4.2)²) over the colours (n, 3) for each ellipsoid z (K, 6), (K,)."""
    rows, columns = zip(*MONOMIALS)
    M = colours[:, rows] * colours[:, columns] * FACTOR
    C = matrix_of(z)
    slope = np.einsum("kij,jl,klm->kim", C, V, C)[:, rows, columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = (M @ z.T - 1) ** 2 / (4 * (M @ slope.T))
    return np.minimum(1.0, np.nan_to_num(squared, nan=np.inf) / 4.2**2).mean(axis=0)
