"""A grid of square cells over the picture and the depth at their corners: least squares on slopes, with a narrow band.

A cell is a block of pixels (1 × 1 at the finest). It has one slope (z_x, z_y), which the depths at its four corners
give: z is bilinear in the cell, and its gradient is taken at the middle. So a depth map is fitted to slopes of cells
without a special case at the edge of a region, and its normal equations are a banded matrix. In perspective z is the
relief of ``recover.geometry.rays``. Frame: camera, x right, y up, z toward the camera, image row 0 at the top; depths
and lengths are in pixels.
"""

from functools import cached_property

import numba
import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.banded import BandedFactor, Part, factor_banded
from huesphere.recover.geometry.blocks import block_sums
from huesphere.recover.geometry.parameters import GEOMETRY

# Weight, over that of the slopes, of the depth that alternates from corner to corner, which no slope of a cell sees.
TWIST_STIFFNESS = 1e-3

# Relative damping of the diagonal; without it rounding would leave the matrix of a large grid indefinite.
LEAST_DAMPING = 1e-7


class DepthGrid:
    """The grid of square cells over a region: means of an image in the cells, and least squares for depths at corners.

    A cell is used if enough of its pixels are inside the region (``GEOMETRY.least_cell_share``). P cells are used, in
    raster order; they have U corners, and the depth at each corner is an unknown.
    """

    def __init__(self, image: np.ndarray, inside: np.ndarray, block: int, ray: np.ndarray | None = None) -> None:
        """The grid over ``inside`` (H, W), with means of ``image`` (H, W, K) over each cell's pixels inside.

        ``ray`` (H, W, 2): of a picture in perspective (``recover.geometry.rays``); None where rays are parallel.
        """
        count = block_sums(inside.astype(float), block)
        h, w = count.shape
        self.where = count >= GEOMETRY.least_cell_share * block * block  # (h, w) bool, cells that are used
        self.block = block  # pixels
        self.count = count[self.where]  # (P,) pixels inside
        self.mean = self._mean(image, inside)  # (P, K)
        self.ray = None if ray is None else self._mean(ray, inside)  # (P, 2)
        corner = np.zeros((h + 1, w + 1), bool)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            corner[i : i + h, j : j + w] |= self.where
        number = np.cumsum(corner).reshape(h + 1, w + 1) - 1
        if w > h:  # number the corners along the shorter side, which makes the band of the matrix narrow
            number = (np.cumsum(corner.T).reshape(w + 1, h + 1) - 1).T
        row, column = np.nonzero(self.where)
        self.corners = np.stack([number[row + i, column + j] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))], axis=-1)
        self.unknowns = int(corner.sum())  # U
        self.pieces = int(ndimage.label(self.where, np.ones((3, 3)))[1])
        # (2, 4) ∂/∂x and ∂/∂y of a cell's depth by its corners (P, 4): top left, top right, bottom left, bottom right
        self.gradient = np.array([[-0.5, 0.5, -0.5, 0.5], [0.5, 0.5, -0.5, -0.5]]) / block
        pair = np.indices((4, 4)).reshape(2, 16)
        lower = (self.corners[:, pair[0]] >= self.corners[:, pair[1]]).all(axis=0)  # numbered alike in every cell
        a, b = pair[:, lower]
        self._cell = _quadratic_form_of_a_cell(self.gradient, a, b, block)
        self._rows, self._columns = (self.corners[:, one].astype(np.int32) for one in (a, b))

    def _mean(self, image: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Means (P, K) of an ``image`` (H, W, K) over the pixels ``inside`` (H, W) of each cell."""
        sums = block_sums(np.where(inside[..., None], image, 0.0), self.block)
        return sums[self.where] / self.count[:, None]  # type: ignore[no-any-return]

    def __len__(self) -> int:
        """P."""
        return len(self.corners)

    @property
    def freedom(self) -> int:
        """Degrees of freedom, residuals less unknowns, of a fit of depths and a rotation to two residuals a cell.

        In each connected component two combinations of the depths do not change any slope, so they do not count as
        unknowns: a constant, and a depth that alternates in sign from corner to corner.
        """
        return 2 * len(self) - (self.unknowns - 2 * self.pieces) - 3

    def well_within(self, pixels: int) -> np.ndarray:
        """Cells (P,) bool that are at least ``pixels`` pixels, and at least one cell, from the edge of the region."""
        rounds = max(1, round(pixels / self.block))
        return ndimage.binary_erosion(self.where, np.ones((3, 3)), iterations=rounds)[self.where]  # type: ignore[no-any-return]

    def interpolated(self, values: np.ndarray, at: np.ndarray) -> np.ndarray:
        """``values`` (P, K) of cells, interpolated bilinearly at rows and columns ``at`` (2, N) of the grid: (N, K).

        Outside the region, the value of the nearest cell that is used is interpolated.
        """
        image = np.zeros((*self.where.shape, values.shape[1]))
        image[self.where] = values
        nearest = ndimage.distance_transform_edt(~self.where, return_distances=False, return_indices=True)
        image = image[tuple(nearest)]
        channels = [ndimage.map_coordinates(image[..., k], at, order=1, mode="nearest") for k in range(values.shape[1])]
        return np.stack(channels, axis=-1)

    def normals_at_pixels(self, n: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Unit normals (N, 3) of the pixels of ``mask`` (H, W), interpolated between those of the cells (P, 3)."""
        out = self.interpolated(n, (np.argwhere(mask).T + 0.5) / self.block - 0.5)
        return out / np.linalg.norm(out, axis=1, keepdims=True)  # type: ignore[no-any-return]

    def smoothed(self, values: np.ndarray, pixels: float) -> np.ndarray:
        """``values`` (P, K) averaged over neighbouring cells with Gaussian weights, standard deviation ``pixels``."""
        image = np.zeros((*self.where.shape, values.shape[1] + 1))
        image[self.where, :-1], image[self.where, -1] = values, 1.0
        sigma = pixels / self.block
        smooth = ndimage.gaussian_filter(image, (sigma, sigma, 0), truncate=3)[self.where]
        return smooth[:, :-1] / smooth[:, -1:]  # type: ignore[no-any-return]

    def least_squares_slopes(self, W: np.ndarray, factor: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Slopes ∇z (P, 2, K) of the K depth maps that minimise Σ (factor ∇z − wanted)ᵀ W (factor ∇z − wanted).

        The sum is over the cells. ``W`` (P, 2, 2), ``factor`` (P,), ``wanted`` (P, 2, K). Raises LinAlgError if a depth
        is undetermined.
        """
        scaled = W * (factor**2)[:, None, None]
        factors = self.factor(scaled[:, 0, 0], scaled[:, 0, 1], scaled[:, 1, 1])
        return self.solve(factors, (W @ wanted) * factor[:, None, None])

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of neighbouring cells, by number: (A, 2) left and right, and (B, 2) upper and lower."""
        number = np.full(self.where.shape, -1)
        number[self.where] = np.arange(len(self))
        beside = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
        below = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
        return beside[(beside >= 0).all(axis=1)], below[(below >= 0).all(axis=1)]

    @cached_property
    def _bonds(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """The form |∇z − ∇z'|² of the A ``pairs`` side by side, and of the B pairs one above the other.

        Each as the E entries (E,) that a pair adds to the lower triangle, the same for all pairs, and their rows and
        columns (A or B, E). The two cells of a pair have eight corners, two of which are common to both.
        """
        found = []
        for pairs, common in zip(self.pairs, (((1, 4), (3, 6)), ((2, 4), (3, 5)))):
            step = np.concatenate([-self.gradient, self.gradient], axis=1)  # (2, 8), of the corners of both cells
            for first, second in common:
                step[:, first] += step[:, second]
            kept = [k for k in range(8) if k not in {second for _, second in common}]
            step, corners = step[:, kept], self.corners[pairs].reshape(len(pairs), 8)[:, kept].astype(np.int32)
            a, b = np.indices((6, 6)).reshape(2, 36)
            lower = (corners[:, a] >= corners[:, b]).all(axis=0)
            a, b = a[lower], b[lower]
            found.append(((step.T @ step)[a, b], corners[:, a], corners[:, b]))
        return found

    def factor(
        self,
        xx: np.ndarray,
        xy: np.ndarray,
        yy: np.ndarray,
        *,
        damping: float = LEAST_DAMPING,
        bonds: np.ndarray | None = None,
    ) -> BandedFactor:
        """Cholesky factor of the quadratic form Σ ∇zᵀ (xx xy; xy yy) ∇z of the depths, for ``solve``.

        ``xx``, ``xy``, ``yy`` (P,) are each cell's weights. The diagonal is multiplied by 1 + ``damping``. ``bonds``
        (A + B,), if given, adds Σ bond |∇z − ∇z'|² over the ``pairs``, which doubles the band. Raises LinAlgError if
        the form is not positive definite.
        """
        weights = np.stack([xx, xy, yy, TWIST_STIFFNESS * (xx + yy)], axis=-1)
        parts = [Part(weights, self._cell, self._rows, self._columns)]
        if bonds is not None:
            for bond, (form, rows, columns) in zip(np.split(bonds, [len(self.pairs[0])]), self._bonds):
                parts.append(Part(np.ascontiguousarray(bond[:, None]), form[None], rows, columns))
        return factor_banded(parts, self.unknowns, damping=damping)

    def solve(self, factors: BandedFactor, right: np.ndarray) -> np.ndarray:
        """Slopes ∇z (P, 2, K) of the K depth maps that minimise ½ q(z) − Σ rightᵀ∇z, with ``right`` (P, 2, K).

        q is the quadratic form of which ``factor`` returned ``factors``; the sum is over the cells.
        """
        z = np.zeros((right.shape[2], self.unknowns))
        _scatter(self.corners, self.gradient, np.ascontiguousarray(right), z)
        slope = np.empty(right.shape)
        _slopes(self.corners, self.gradient, factors.solve(z), slope)
        return slope


def _quadratic_form_of_a_cell(gradient: np.ndarray, a: np.ndarray, b: np.ndarray, block: int) -> np.ndarray:
    """What the depths at the corners ``a`` and ``b`` (E,) of a cell add to its form, for each of its weights: (4, E).

    The weights are those of z_x², of 2 z_x z_y and of z_y², and that of the square of the depth that alternates in sign
    from corner to corner, which the ``gradient`` (2, 4) does not see.
    """
    x, y = gradient
    wave = np.array([1.0, -1.0, -1.0, 1.0]) / (4 * block)
    return np.stack([x[a] * x[b], x[a] * y[b] + y[a] * x[b], y[a] * y[b], wave[a] * wave[b]])


def variation_within_cells(grid: DepthGrid, slope: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Variation of colours within each cell (P,) that the variation of the ``slope`` (P, 2) in it causes, RMS.

    In the units of the colours, over channels. ``J`` (P, 3, 2): derivatives of colours by slopes. The slope is assumed
    to vary within a cell by a quarter of the difference between the mean slope of the 3 × 3 cells around and the cell's
    own slope, and by the whole difference at the edge of the region.
    """
    image = np.zeros((*grid.where.shape, 2))
    image[grid.where] = slope
    share = ndimage.uniform_filter(grid.where.astype(float), 3)
    mean = ndimage.uniform_filter(image, (3, 3, 1)) / np.maximum(share, 1e-9)[..., None]
    difference = np.where(share < 0.999, 1.0, 0.25)[..., None] * (mean - image)
    return np.sqrt((np.einsum("pcd,pd->pc", J, difference[grid.where]) ** 2).mean(axis=1))  # type: ignore[no-any-return]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _scatter(corners: np.ndarray, gradient: np.ndarray, right: np.ndarray, z: np.ndarray) -> None:
    """Add to z (K, U), in place, gradientᵀ ``right`` (P, 2, K) at the corners (P, 4) of each cell."""
    for p in range(len(corners)):
        for c in range(4):
            for k in range(len(z)):
                z[k, corners[p, c]] += gradient[0, c] * right[p, 0, k] + gradient[1, c] * right[p, 1, k]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _slopes(corners: np.ndarray, gradient: np.ndarray, z: np.ndarray, out: np.ndarray) -> None:
    """Write to ``out`` (P, 2, K) each cell's slope, from the depths z (K, U) at its corners (P, 4)."""
    for p in range(len(corners)):
        i, j, m, n = corners[p]
        for d in range(2):
            for k in range(len(z)):
                value = gradient[d, 0] * z[k, i] + gradient[d, 1] * z[k, j]
                out[p, d, k] = value + gradient[d, 2] * z[k, m] + gradient[d, 3] * z[k, n]
