"""Blocks of pixels and the depth at their corners: least squares on slopes, with a narrow band.

One slope a block, from the depths at its four corners, and no special case at the edge of a region. Frame: camera,
image row 0 at the top.
"""

from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.linalg import cho_solve_banded, cholesky_banded

FULL = 0.6  # share of a block that must be inside
STIFF = 1e-3  # against the wave from cell to cell that no slope sees


class Cells:
    """Block means of N where most of a block is ``inside``, and the depth at the blocks' corners.

    Of a picture in perspective they hold the mean ``ray`` too, and the depth is the relief's (``recover.rays``).
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
        self._pair, self._lower = pair, below >= 0
        self._band = int(below.max(initial=0))
        self._entry = (below * self.unknowns + self.corners[:, pair[1]])[self._lower]

    def __len__(self) -> int:
        return len(self.N)

    @property
    def freedom(self) -> int:
        """Residuals less unknowns: of a piece's depth the mean is no unknown, nor the wave that no slope sees."""
        return 2 * len(self) - (self.unknowns - 2 * self.pieces) - 3

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
    def _bond(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Of |∇z − ∇z'|² of each pair: entries (64,), which of them are kept, where in the band, its width."""
        pairs = np.concatenate(self.pairs)
        corners = self.corners[pairs].reshape(len(pairs), 8)
        step = np.concatenate([-self.gradient, self.gradient], axis=1)  # (2, 8)
        a, b = np.indices((8, 8)).reshape(2, 64)
        below = corners[:, a] - corners[:, b]
        lower = below >= 0
        return (step.T @ step)[a, b], lower, (below * self.unknowns + corners[:, b])[lower], int(below.max(initial=0))

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
        band = self._band if bonds is None else max(self._band, self._bond[3])
        matrix = np.bincount(self._entry, entries[self._lower], (band + 1) * self.unknowns)
        if bonds is not None:
            of_bond, lower, entry, _ = self._bond
            matrix += np.bincount(entry, (bonds[:, None] * of_bond)[lower], len(matrix))
        matrix = matrix.reshape(band + 1, self.unknowns)
        matrix[0] += damping * matrix[0] + 1e-9 * matrix[0].mean()  # each piece floats
        return cholesky_banded(matrix, lower=True, overwrite_ab=True, check_finite=False)  # type: ignore[no-any-return]

    def solve(self, factors: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """∇z (P, 2, K) of the K depth maps for which the form less Σ pullᵀ∇z, ``pull`` (P, 2, K), is least."""
        right = np.stack(
            [
                np.bincount(self.corners.ravel(), (pull[:, :, k] @ self.gradient).ravel(), self.unknowns)
                for k in range(pull.shape[2])
            ],
            axis=-1,
        )
        z = cho_solve_banded((factors, True), right, check_finite=False)
        return np.einsum("dc,pck->pdk", self.gradient, z[self.corners])  # type: ignore[no-any-return]
