"""Blocks of pixels and the depth at their corners: least squares on slopes, with a narrow band.

One slope a block, from the depths at its four corners, and no special case at the edge of a region. Frame: camera,
image row 0 at the top.
"""

from functools import cached_property

import numba
import numpy as np
from scipy import ndimage
from scipy.linalg import cholesky_banded

FULL = 0.6  # share of a block that must be inside
STIFF = 1e-3  # against the wave from cell to cell that no slope sees


class Cells:
    """Block means of N where most of a block is ``inside``, and the depth at the blocks' corners.

    Of a picture in perspective they hold the mean ``ray`` too, and the depth is the relief's
    (``recover.geometry.rays``).
    """

    def __init__(self, N: np.ndarray, inside: np.ndarray, block: int, ray: np.ndarray | None = None) -> None:
        h, w = (side // block for side in inside.shape)

        def sums(image: np.ndarray) -> np.ndarray:
            rest = image.shape[2:]
            return image[: h * block, : w * block].reshape(h, block, w, block, *rest).sum(axis=(1, 3))  # type: ignore[no-any-return]

        count = sums(inside.astype(float))
        self.where = count >= FULL * block * block  # (h, w)
        self.block = block
        self.count = count[self.where]  # (P,) pixels
        self.N = sums(np.where(inside[..., None], N, 0.0))[self.where] / self.count[:, None]  # (P, 3)
        self.ray = None  # (P, 2)
        if ray is not None:
            self.ray = sums(np.where(inside[..., None], ray, 0.0))[self.where] / self.count[:, None]
        corner = np.zeros((h + 1, w + 1), bool)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            corner[i : i + h, j : j + w] |= self.where
        number = np.cumsum(corner).reshape(h + 1, w + 1) - 1
        if w > h:  # along the shorter side, for a narrow band
            number = (np.cumsum(corner.T).reshape(w + 1, h + 1) - 1).T
        row, column = np.nonzero(self.where)
        self.corners = np.stack([number[row + i, column + j] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))], axis=-1)
        self.unknowns = int(corner.sum())
        self.pieces = int(ndimage.label(self.where, np.ones((3, 3)))[1])
        self.gradient = np.array([[-0.5, 0.5, -0.5, 0.5], [0.5, 0.5, -0.5, -0.5]]) / block  # (2, 4), of the corners
        pair = np.indices((4, 4)).reshape(2, 16)
        below = self.corners[:, pair[0]] - self.corners[:, pair[1]]
        lower = (below >= 0).all(axis=0)  # corners are numbered in the same order in every cell
        self._pair, self._below = pair[:, lower], below[:, lower]
        self._band = int(below.max(initial=0))

    def __len__(self) -> int:
        return len(self.N)

    @property
    def freedom(self) -> int:
        """Residuals less unknowns: of a piece's depth the mean is no unknown, nor the wave that no slope sees."""
        return 2 * len(self) - (self.unknowns - 2 * self.pieces) - 3

    def well_within(self, pixels: int) -> np.ndarray:
        """Which cells (P,) are so many pixels and more from the outline, at least one cell."""
        rounds = max(1, round(pixels / self.block))
        return ndimage.binary_erosion(self.where, np.ones((3, 3)), iterations=rounds)[self.where]  # type: ignore[no-any-return]

    def between(self, values: np.ndarray, at: np.ndarray) -> np.ndarray:
        """``values`` (P, K) of the cells at rows and columns ``at`` (2, N) of their grid, the nearest's off them."""
        image = np.zeros((*self.where.shape, values.shape[1]))
        image[self.where] = values
        nearest = ndimage.distance_transform_edt(~self.where, return_distances=False, return_indices=True)
        image = image[tuple(nearest)]
        channels = [ndimage.map_coordinates(image[..., k], at, order=1, mode="nearest") for k in range(values.shape[1])]
        return np.stack(channels, axis=-1)

    def normals_at_pixels(self, n: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Unit normals (N, 3) of the pixels of ``mask`` (H, W) between those of the cells (P, 3)."""
        out = self.between(n, (np.argwhere(mask).T + 0.5) / self.block - 0.5)
        return out / np.linalg.norm(out, axis=1, keepdims=True)  # type: ignore[no-any-return]

    def smoothed(self, values: np.ndarray, pixels: float) -> np.ndarray:
        """``values`` (P, K) averaged over neighbours under a Gaussian of that deviation."""
        image = np.zeros((*self.where.shape, values.shape[1] + 1))
        image[self.where, :-1], image[self.where, -1] = values, 1.0
        sigma = pixels / self.block
        smooth = ndimage.gaussian_filter(image, (sigma, sigma, 0), truncate=3)[self.where]
        return smooth[:, :-1] / smooth[:, -1:]  # type: ignore[no-any-return]

    def slopes_nearest(self, W: np.ndarray, factor: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """∇z (P, 2, K) for the K depth maps that make Σ (factor ∇z − wanted)ᵀ W (factor ∇z − wanted) least.

        ``W`` (P, 2, 2), ``factor`` (P,), ``wanted`` (P, 2, K).
        """
        scaled = W * (factor**2)[:, None, None]
        factors = self.factor(scaled[:, 0, 0], scaled[:, 0, 1], scaled[:, 1, 1])
        return self.solve(factors, (W @ wanted) * factor[:, None, None])

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (A, 2) of cells with their right neighbours, and (B, 2) with those below."""
        number = np.full(self.where.shape, -1)
        number[self.where] = np.arange(len(self))
        beside = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
        below = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
        return beside[(beside >= 0).all(axis=1)], below[(below >= 0).all(axis=1)]

    @cached_property
    def _bond(self) -> tuple[list[tuple[np.ndarray, np.ndarray, np.ndarray]], int]:
        """Of |∇z − ∇z'|² of pairs beside each other, and below: entries (E,), their rows and columns (·, E); the band.

        Lower triangle; two corners are common to both cells.
        """
        found = []
        for pairs, common in zip(self.pairs, (((1, 4), (3, 6)), ((2, 4), (3, 5)))):
            step = np.concatenate([-self.gradient, self.gradient], axis=1)  # (2, 8), of the corners of both cells
            for first, second in common:
                step[:, first] += step[:, second]
            kept = [k for k in range(8) if k not in {second for _, second in common}]
            step, corners = step[:, kept], self.corners[pairs].reshape(len(pairs), 8)[:, kept]
            a, b = np.indices((6, 6)).reshape(2, 36)
            lower = (corners[:, a] >= corners[:, b]).all(axis=0)
            a, b = a[lower], b[lower]
            found.append(((step.T @ step)[a, b], corners[:, a], corners[:, b]))
        return found, max(int((row - column).max(initial=0)) for _, row, column in found)

    def factor(
        self,
        xx: np.ndarray,
        xy: np.ndarray,
        yy: np.ndarray,
        *,
        damping: float = 1e-7,
        bonds: np.ndarray | None = None,
    ) -> np.ndarray:
        """Banded Cholesky factor of Σ ∇zᵀ (xx xy; xy yy) ∇z over the cells. Raises LinAlgError.

        ``bonds`` (A + B,), if given: to it is added Σ bond |∇z − ∇z'|² over the ``pairs``, which doubles the band.
        """
        a, b = self._pair
        D = self.gradient
        products = np.stack([D[0, a] * D[0, b], D[0, a] * D[1, b] + D[1, a] * D[0, b], D[1, a] * D[1, b]])
        wave = np.array([1.0, -1.0, -1.0, 1.0]) / (4 * self.block)
        entries = np.stack([xx, xy, yy], axis=-1) @ products + STIFF * (xx + yy)[:, None] * (wave[a] * wave[b])
        height = 1 + (self._band if bonds is None else max(self._band, self._bond[1]))
        place = self._below + height * self.corners[:, b]  # a column of the matrix in one piece, as LAPACK has it
        matrix = np.bincount(place.ravel(), entries.ravel(), height * self.unknowns)
        if bonds is not None:
            parts = np.split(bonds, [len(self.pairs[0])])
            for bond, (of_bond, row, column) in zip(parts, self._bond[0]):
                place = row + (height - 1) * column
                matrix += np.bincount(place.ravel(), (bond[:, None] * of_bond).ravel(), len(matrix))
        matrix = matrix.reshape(self.unknowns, height).T
        matrix[0] += damping * matrix[0] + 1e-9 * matrix[0].mean()  # each piece floats
        return cholesky_banded(matrix, lower=True, overwrite_ab=True, check_finite=False)  # type: ignore[no-any-return]

    def solve(self, factors: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """∇z (P, 2, K) of the K depth maps for which the form less Σ pullᵀ∇z, ``pull`` (P, 2, K), is least."""
        z = np.zeros((pull.shape[2], self.unknowns))
        _scatter(self.corners, self.gradient, np.ascontiguousarray(pull), z)
        _solve_banded(factors.T, z)
        slope = np.empty(pull.shape)
        _slopes(self.corners, self.gradient, z, slope)
        return slope


def varied(cells: Cells, slope: np.ndarray, J: np.ndarray) -> np.ndarray:
    """What colours (P,) vary by within a cell, for its slope (P, 2) does; ``J`` (P, 3, 2): colours by slopes.

    Slopes vary by a quarter of what the neighbours' mean is off the cell's own.
    """
    image = np.zeros((*cells.where.shape, 2))
    image[cells.where] = slope
    share = ndimage.uniform_filter(cells.where.astype(float), 3)
    mean = ndimage.uniform_filter(image, (3, 3, 1)) / np.maximum(share, 1e-9)[..., None]
    lacking = np.where(share < 0.999, 1.0, 0.25)[..., None] * (mean - image)
    return np.sqrt((np.einsum("pcd,pd->pc", J, lacking[cells.where]) ** 2).mean(axis=1))  # type: ignore[no-any-return]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _scatter(corners: np.ndarray, gradient: np.ndarray, pull: np.ndarray, z: np.ndarray) -> None:
    """To z (K, U), in place, each cell's pull (P, 2, K) on its corners (P, 4)."""
    for p in range(len(corners)):
        for c in range(4):
            for k in range(len(z)):
                z[k, corners[p, c]] += gradient[0, c] * pull[p, 0, k] + gradient[1, c] * pull[p, 1, k]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _slopes(corners: np.ndarray, gradient: np.ndarray, z: np.ndarray, out: np.ndarray) -> None:
    """out (P, 2, K), in place: the slopes of each cell, of the depths z (K, U) at its corners (P, 4)."""
    for p in range(len(corners)):
        i, j, m, n = corners[p]
        for d in range(2):
            for k in range(len(z)):
                value = gradient[d, 0] * z[k, i] + gradient[d, 1] * z[k, j]
                out[p, d, k] = value + gradient[d, 2] * z[k, m] + gradient[d, 3] * z[k, n]


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "reassoc"})  # type: ignore[untyped-decorator]
def _solve_banded(L: np.ndarray, z: np.ndarray) -> None:
    """z (K, U), in place: (L Lᵀ)⁻¹ z, L[j] (U, 1 + band) being column j of the factor from its diagonal on.

    All K at once: the factor, which no cache holds, is read twice, where LAPACK's dpbtrs reads it twice for each.
    """
    count, height = L.shape
    for j in range(count):
        column = L[j, 1 : count - j]
        for k in range(len(z)):
            z[k, j] /= L[j, 0]
            own, rest = z[k, j], z[k, j + 1 : j + height]
            for i in range(len(rest)):
                rest[i] -= column[i] * own
    for j in range(count - 1, -1, -1):
        column = L[j, 1 : count - j]
        for k in range(len(z)):
            own, rest = z[k, j], z[k, j + 1 : j + height]
            for i in range(len(rest)):
                own -= column[i] * rest[i]
            z[k, j] = own / L[j, 0]
