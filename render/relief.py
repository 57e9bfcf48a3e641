"""The gather operator of a height field: light that it sends to itself, exact in elevation, sampled in azimuth.

(K T)(x) = (1/π) ∫ T(y) cosθ dω over the directions d in which x sees another point y of the surface: the K of
`render.gather`, without rays, for a height field on a pixel grid. The half-plane through x and azimuth φ cuts the
surface in a profile. Walking outward along it, what rises above the steepest slope met so far is seen and the rest is
hidden (Max, "Horizon mapping", 1988), so T of a piece of profile counts times a closed form in the slopes that it adds:

    (1/π) Δφ ∫ (n_h sin²θ + n_z sinθ cosθ) dθ = (Δφ/π) ∫ (n_h + n_z t) / (1 + t²)² dt,     t = cotθ, the slope of d,

n_h = n_x cosφ + n_y sinφ. The lower limit of t is the larger of the steepest slope met so far and the slope of the
tangent plane, −n_h / n_z. A piece that is seen always shows its front. Only azimuth is sampled, by equally spaced
half-planes, rotated by a random angle at each point. The integrand is continuous with kinks there: the measured error
falls like azimuths^−1.6 (with rays: rays^−0.76).

The surface is the mesh of `scenes.surfaces.depth_mesh`: a vertex at each pixel centre, each cell cut along the diagonal
from top right to bottom left, nothing off the mask. There are two differences. A cell without its top right or bottom
left sample is missing as a whole, where the mesh has one triangle. And light that comes through a hole of the surface
from below its edge is lost. Profiles start at the point itself, so its immediate neighbourhood counts; rays that start
0.01 pixels off the surface lose 0.2 %.

Far from the point the profile uses every second vertex only, then every fourth and so on, counted from the point, so
that a step spans about the same angle everywhere, and the time grows little faster than the number of pixels. The
distance at which this begins grows with the number of azimuths, such that its bias stays under a fifth of their error
(tests).

In perspective the height field is h = f²/t − f over the picture, where t is the distance of a point along the camera's
axis. It is not the relief −f log t of docs/conventions.md: slopes of the relief follow from the normal alone, which
integration needs, but only the map to h takes straight lines of space to straight lines. So a half-plane through the
line of sight, with the unit vector v, still cuts the surface in a profile, and the same points are hidden. A slope τ of
the profile is the direction (f + h) e + τ f ρ v, where e is the unit step in the picture and ρ the length of (x/f, y/f,
1). So cotθ about v is an affine function of τ, and the azimuth about v changes by dφ / (ρ |e across v|²). With these
the same closed form holds.

NumPy and Numba only: recovery uses it too, on surfaces that it has estimated.

Tried and dropped (relief of 256², 16 azimuths): joining neighbouring pieces of profile, no gain in time; a bound for
each pixel in place of each tile, a fifth slower; helpers that take arrays inside the loop over azimuths, slower; points
in order of their turn, or one division in a band, no gain; entries summed by vertex as they come, an eighth slower.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numba
import numpy as np

PHASES = 16  # number of different rotations of the azimuths, which divide the angle between two azimuths evenly
MOST_HALF_PLANES = (
    2048  # most azimuths × phases, each of which has a table of its own; with more there are fewer phases
)
FINE = 7  # a profile uses every vertex up to FINE × azimuths pixels from its point
MOST_STRIDE = 16  # largest distance in pixels of the vertices that a profile uses
CHUNK = 8  # strides of a profile that one test against an upper bound of the surface may skip
TILE = 4  # side in strides of the squares that have an upper bound each; a chunk uses that of the square of its middle
REACH = CHUNK // 2 + 2 + TILE // 2  # half width in strides of the area of a bound: all vertices beside such a chunk
HOLE = -1e30  # height where there is no surface: below every slope
NO_HEIGHT = -1e20  # an interpolated height below this involved a hole
GRAZING = 1e-9  # a smaller excess over the slope of the tangent plane is rounding
ENTRIES_PER_AZIMUTH = 64  # first capacity of a row; a batch is repeated where it is too small
BATCH_ENTRIES = 1 << 21  # capacity of all rows of a batch together: bounds the memory beside the result
BLOCKS = 8  # parts into which a batch is divided for the threads

Report = Callable[[float], None]


def _silent(_: float) -> None:
    pass


@dataclass(frozen=True)
class ReliefKernel:
    """K as sparse rows, one for each object pixel, in row-major order of the mask; columns have the same order."""

    start: np.ndarray  # (n + 1,) int64: row i has the entries start[i]:start[i + 1]
    index: np.ndarray  # (e,) int32, column; a column may occur more than once in a row
    weight: np.ndarray  # (e,) float32, positive; a row sums to the share of its hemisphere that the surface fills
    sky: np.ndarray  # (n, 4) float32, as `open_sky`


def build_kernel(
    depth: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    *,
    step: float = 1.0,
    azimuths: int = 24,
    seed: int = 0,
    report: Report = _silent,
) -> ReliefKernel:
    """The gather operator K of a height field, at unit albedo.

    Parameters
    ----------
    depth: (H, W), toward the camera; any value off the mask.
    mask: (H, W) bool, where there is a surface.
    normals: (H, W, 3), unit, camera frame, n_z > 0: those that shade and cut the hemisphere (`depth_normals`).
    step: side of a pixel in units of depth.
    azimuths: half-planes from each point. Their quadrature is all the error there is against the mesh; row sums and
        sky add up to 1 within it (2e-3 at 16) where no rim is near.
    seed: of the turns. The same seed gives the same bits, whatever the number of threads.
    report: called with the share of the rows done.

    Measured on a scanned bust of 34 000 pixels: 218 entries of 8 bytes a row at 12 azimuths, 712 at 48, 1338 at 128.
    Errors of the colour under five lights, skin: 1e-3 at 12 azimuths, 1e-4 at 49 (rays: 425 and 8800).
    Raises ValueError for shapes that differ, azimuths < 1, and inside the mask values that are not finite or n_z ≤ 0.
    """
    batches = list(_Sweep(depth, mask, normals, step, azimuths, seed).batches(keep=True, report=report))
    counts = np.concatenate([rows.stop - rows.start for rows in batches])
    return ReliefKernel(
        start=np.concatenate([[0], np.cumsum(counts)]),
        index=np.concatenate([rows.index for rows in batches]),
        weight=np.concatenate([rows.weight for rows in batches]),
        sky=np.concatenate([rows.sky for rows in batches]),
    )


def apply_kernel(kernel: ReliefKernel, values: np.ndarray) -> np.ndarray:
    """K applied to ``values`` (n, C) at the object's pixels, linear between them; (n, C) float32."""
    return _apply(kernel.start[:-1], kernel.start[1:], kernel.index, kernel.weight, _columns(values))


# More than seven parameters: a height field with its normals, values, and options with defaults.
def gather_without_kernel(
    depth: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    values: np.ndarray,
    *,
    step: float = 1.0,
    azimuths: int = 24,
    seed: int = 0,
    rows: np.ndarray | None = None,
    focal_px: float | None = None,
    report: Report = _silent,
) -> np.ndarray:
    """K applied to ``values`` (n, C) without storing K: (n, C) float32.

    Bit for bit the result of `apply_kernel` with `build_kernel`, whose parameters it takes, but only a batch of rows is
    in memory at a time. ``rows`` (m,): compute these rows only, in this order. ``focal_px``: focal length f of a
    picture in perspective, with the principal point in its middle; then ``depth`` is the height f²/t − f of the
    module's header (from a relief by ``recover.geometry.rays.height_of``), and normals face the camera where n·v > 0.
    Raises ValueError as `build_kernel`.
    """
    columns = _columns(values)
    return np.concatenate(
        [
            _apply(batch.start, batch.stop, batch.index, batch.weight, columns)
            for batch in _Sweep(depth, mask, normals, step, azimuths, seed, rows, focal_px).batches(
                keep=False, report=report
            )
        ]
    )


def open_sky(
    depth: np.ndarray, mask: np.ndarray, normals: np.ndarray, *, step: float = 1.0, azimuths: int = 24, seed: int = 0
) -> np.ndarray:
    """The part of each pixel's hemisphere that the surface does not block, as four integrals: (n, 4) float32.

    (1/π) ∫ cosθ dω over unblocked directions d, then its first moments (1/π) ∫ d cosθ dω in the camera frame: light
    at albedo 1 under a dome of radiance (a + b·d) / π is a · sky[0] + b · sky[1:]. On an open plane 1 and (2/3) n.
    Directions below the horizon are open where no surface lies there.
    """
    return np.concatenate([b.sky for b in _Sweep(depth, mask, normals, step, azimuths, seed).batches(keep=False)])


def _columns(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32)


# ---- rows in batches -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Rows:
    """Rows of K for m consecutive pixels; row i has the entries start[i]:stop[i]."""

    start: np.ndarray  # (m,) int64
    stop: np.ndarray  # (m,) int64
    index: np.ndarray  # int32
    weight: np.ndarray  # float32
    sky: np.ndarray  # (m, 4) float32


class _Sweep:
    """A height field prepared for profiles: heights in pixels with a margin of holes, bounds, tables of half-planes."""

    # More than seven parameters: those of ``gather_without_kernel``, which it serves.
    def __init__(
        self,
        depth: np.ndarray,
        mask: np.ndarray,
        normals: np.ndarray,
        step: float,
        azimuths: int,
        seed: int,
        rows: np.ndarray | None = None,
        focal_px: float | None = None,
    ) -> None:
        row, col = np.nonzero(mask)
        x, y = col + 0.5 - mask.shape[1] / 2, mask.shape[0] / 2 - row - 0.5
        self.ray = np.zeros((len(row), 2)) if focal_px is None else np.stack([x, y], axis=-1) / focal_px  # (n, 2)
        self.nearness = 0.0 if focal_px is None else 1 / focal_px
        _check(depth, mask, normals, self.ray, azimuths)
        self.azimuths = azimuths
        self.normal = np.ascontiguousarray(normals[row, col], dtype=np.float64)  # (n, 3)
        if len(row) == 0:
            self.at = row
            return
        box = np.s_[row.min() : row.max() + 1, col.min() : col.max() + 1]
        filled = np.where(mask[box], np.asarray(depth, dtype=np.float64)[box] / step, HOLE)
        chunks = _chunks(math.hypot(*filled.shape), CHUNK * max(4, FINE * int(azimuths) // CHUNK))
        margin = int(chunks[:, 1].max()) + 2  # an edge beside a crossing ends at most a stride off
        self.height = np.pad(filled, margin, constant_values=HOLE)  # (H', W')
        width = self.height.shape[1]
        self.at = (row - row.min() + margin) * width + col - col.min() + margin  # (n,) of each pixel in the flat height
        self.column = np.full(self.height.size, -1, np.int32)  # of K, of each place of the flat height
        self.column[self.at] = np.arange(len(row))
        phases = max(1, min(PHASES, MOST_HALF_PLANES // azimuths))
        rng = np.random.default_rng(seed)
        self.half_planes = _half_planes(azimuths * phases, rng.random(), chunks, width)
        self.phase = rng.integers(0, phases, len(row))  # (n,)
        if rows is not None:
            self.at, self.normal, self.phase = self.at[rows], self.normal[rows], self.phase[rows]
            self.ray = self.ray[rows]
        self.box = np.array([margin, margin + filled.shape[0], margin, margin + filled.shape[1]])  # of the surface
        bounds = {int(m): _upper_planes(self.height, int(m)) for m in np.unique(chunks[:, 1])}
        # For the compiled walk: all planes in one list, and for each chunk its first plane there and how many to a row.
        first = dict(
            zip(bounds, np.cumsum([0, *(len(b) * b.shape[1] for b in bounds.values())]).tolist(), strict=False)
        )
        self.bound = np.concatenate([b.reshape(-1, 3) for b in bounds.values()])
        self.tiles = np.array([(first[m], bounds[m].shape[1]) for m in chunks[:, 1].tolist()], dtype=np.int64)

    def batches(self, *, keep: bool, report: Report = _silent) -> Iterator[_Rows]:
        """All rows of K in order, in batches.

        With ``keep`` the entries of a batch are packed in memory of its own; otherwise the next batch overwrites it.
        """
        if len(self.at) == 0:
            none, nothing = np.zeros(0, np.int64), np.zeros(0, np.float32)
            yield _Rows(none, none, none.astype(np.int32), nothing, np.zeros((0, 4), np.float32))
            return
        capacity = ENTRIES_PER_AZIMUTH * self.azimuths
        first, index, weight = 0, np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)
        while first < len(self.at):
            size = min(len(self.at) - first, max(1024, BATCH_ENTRIES // capacity))
            part = slice(first, first + size)
            if index.shape != (size, capacity):
                index, weight = np.empty((size, capacity), np.int32), np.empty((size, capacity), np.float32)
            count, sky = np.empty(size, np.int64), np.empty((size, 4), np.float32)
            surface = self.height, self.box, self.bound, self.tiles, self.column
            points = self.at[part], self.normal[part], self.phase[part], self.ray[part]
            out = index, weight, count, sky
            _sweep_rows(surface, points, self.azimuths, self.half_planes, self.nearness, out)
            if count.max() > capacity:
                capacity = int(1.25 * count.max())
                continue
            first += size
            report(first / len(self.at))
            if keep:
                stop = np.cumsum(count)
                packed_index, packed_weight = _pack(count, index, weight)
                yield _Rows(stop - count, stop, packed_index, packed_weight, sky)
            else:
                start = np.arange(size) * capacity
                yield _Rows(start, start + count, index.ravel(), weight.ravel(), sky)


def _check(depth: np.ndarray, mask: np.ndarray, normals: np.ndarray, ray: np.ndarray, azimuths: int) -> None:
    """Raise ValueError for arguments of ``build_kernel`` that are not valid."""
    if depth.ndim != 2 or mask.shape != depth.shape or normals.shape != (*depth.shape, 3):
        got = f"{depth.shape}, {mask.shape}, {normals.shape}"
        raise ValueError(f"depth, mask, normals: got {got}; expected (H, W), (H, W), (H, W, 3)")
    if azimuths < 1:
        raise ValueError(f"azimuths: got {azimuths}, expected 1 or more")
    if not (np.isfinite(depth[mask]).all() and np.isfinite(normals[mask]).all()):
        raise ValueError("depth or normals: got values that are not finite inside the mask")
    facing = normals[mask][:, 2] - (ray * normals[mask][:, :2]).sum(axis=1)
    if mask.any() and facing.min() <= 0:
        raise ValueError(f"normals: got n_z = {facing.min():.3g} inside the mask, expected n_z > 0")


@numba.njit(cache=True)
def _pack(count, index, weight):
    """The first ``count`` (m,) entries of each row of ``index`` and ``weight`` (m, capacity), as flat arrays."""
    total = count.sum()
    packed_index, packed_weight = np.empty(total, np.int32), np.empty(total, np.float32)
    at = 0
    for row in range(len(count)):
        for entry in range(count[row]):
            packed_index[at], packed_weight[at] = index[row, entry], weight[row, entry]
            at += 1
    return packed_index, packed_weight


@numba.njit(parallel=True, cache=True)
def _apply(start, stop, index, weight, values):
    out = np.zeros((start.shape[0], values.shape[1]), np.float32)
    for row in numba.prange(start.shape[0]):
        for entry in range(start[row], stop[row]):
            for column in range(values.shape[1]):
                out[row, column] += weight[entry] * values[index[entry], column]
    return out


# ---- what does not depend on the point -----------------------------------------------------------------------------


def _chunks(reach: float, fine: int) -> np.ndarray:
    """Distance in pixels from the point at which each chunk of a profile begins, and its stride: (C, 2), to ``reach``.

    The stride is 1 up to ``fine`` pixels from the point; beyond it doubles with the distance.
    """
    chunks, begin = [], 0
    while begin < reach:
        stride = min(MOST_STRIDE, 1 << (begin // fine).bit_length())
        chunks.append((begin, stride))
        begin += CHUNK * stride
    return np.array(chunks, dtype=np.int64).reshape(-1, 2)


@numba.njit(cache=True)
def _half_planes(count, turn, chunks, width):
    """Tables of the points where half-planes from a vertex cross the edges of the mesh, azimuths 2π (k + turn) / count.

    The origin is a vertex, so the crossings are the same for every vertex. Their distances s, in pixels, are multiples
    of m/|dx|, of m/|dy| and, for the diagonals, of m/|dx − dy|, where m is the stride there (``chunks`` of `_chunks`,
    which are returned too). Where m is more than 1, only the crossings with rows or only those with columns are used,
    whichever are more frequent. Returns for each half-plane: compass (dx, dy); number of the first crossing of each
    chunk, and one past the last; (row, col) of the pixel in the middle of each chunk. For each crossing: the two
    vertices of its edge, as offsets in the flat height; the weight of the second in linear interpolation, and s.
    """
    compass = np.empty((count, 2))
    chunk = np.empty((count, len(chunks) + 1), np.int64)
    middle = np.empty((count, len(chunks), 2), np.int64)
    edge = np.empty((count * 3 * (CHUNK + 1) * len(chunks), 2), np.int32)
    place = np.empty((len(edge), 2))
    total = 0
    for k in range(count):
        phi = 2 * math.pi * (k + turn) / count
        dx, dy = math.cos(phi), math.sin(phi)
        compass[k, 0], compass[k, 1] = dx, dy
        # steps in columns, in rows (row 0 at the top), and across the diagonals row + col = constant
        per_col, per_row, per_both = max(abs(dx), 1e-12), max(abs(dy), 1e-12), max(abs(dx - dy), 1e-12)
        for c in range(len(chunks)):
            begin, m = chunks[c]
            end = begin + CHUNK * m
            i, j = math.floor(begin * per_col / m) + 1, math.floor(begin * per_row / m) + 1
            l = math.floor(begin * per_both / m) + 1
            chunk[k, c] = total
            middle[k, c, 0] = round(-(begin + end) / 2 * dy)
            middle[k, c, 1] = round((begin + end) / 2 * dx)
            while True:
                if m == 1:
                    s = min(i / per_col, j / per_row, l / per_both)
                else:
                    s = i / per_col if per_col > per_row else j / per_row
                if s * m > end:
                    break
                if s == i / per_col:
                    col, along = i if dx > 0 else -i, -s * dy
                    low = math.floor(along)
                    edge[total, 0], edge[total, 1] = low * width + col, (low + 1) * width + col
                    i += 1
                elif s == j / per_row:
                    row, along = -j if dy > 0 else j, s * dx
                    low = math.floor(along)
                    edge[total, 0], edge[total, 1] = row * width + low, row * width + low + 1
                    j += 1
                else:
                    both, along = l if dx > dy else -l, s * dx
                    low = math.floor(along)
                    edge[total, 0] = (both - low) * width + low
                    edge[total, 1] = (both - low - 1) * width + low + 1
                    l += 1
                edge[total, 0] *= m
                edge[total, 1] *= m
                place[total, 0], place[total, 1] = along - low, s * m
                total += 1
        chunk[k, len(chunks)] = total
    return compass, chunks, chunk, middle, edge[:total], place[:total]


@numba.njit(parallel=True, cache=True)
def _upper_planes(height, stride):
    """For each tile a plane above all heights within REACH strides of its middle pixel: (tiles down, tiles across, 3).

    The three numbers are the value at the middle pixel and the slopes along rows and along columns. The slopes are
    those of a least-squares plane, so that the bound is tight where the surface is steep but smooth. Where there is no
    surface the value is HOLE.
    """
    rows, cols = height.shape
    tile, reach = TILE * stride, REACH * stride
    plane = np.zeros(((rows + tile - 1) // tile, (cols + tile - 1) // tile, 3))
    for tile_row in numba.prange(plane.shape[0]):
        for tile_col in range(plane.shape[1]):
            r, c = tile * tile_row + tile // 2, tile * tile_col + tile // 2
            top, bottom = max(0, r - reach), min(rows, r + reach + 1)
            left, right = max(0, c - reach), min(cols, c + reach + 1)
            n = 0
            z = y = x = yy = xx = yz = xz = 0.0
            for i in range(top, bottom):
                for j in range(left, right):
                    h = height[i, j]
                    if h > NO_HEIGHT:
                        v, u = float(i - r), float(j - c)
                        n += 1
                        z, y, x = z + h, y + v, x + u
                        yy, xx, yz, xz = yy + v * v, xx + u * u, yz + v * h, xz + u * h
            most = HOLE
            slope_y = slope_x = 0.0
            if n > 0:
                slope_y = (yz - y * z / n) / max(yy - y * y / n, 1.0)
                slope_x = (xz - x * z / n) / max(xx - x * x / n, 1.0)
                for i in range(top, bottom):
                    for j in range(left, right):
                        most = max(most, height[i, j] - slope_y * (i - r) - slope_x * (j - c))
            plane[tile_row, tile_col, 0] = most
            plane[tile_row, tile_col, 1], plane[tile_row, tile_col, 2] = slope_y, slope_x
    return plane


# ---- one profile ---------------------------------------------------------------------------------------------------


@numba.njit(cache=True, error_model="numpy")
def _band(n_h, n_z, t0, t1):
    """2 ∫ (n_h + n_z t) / (1 + t²)² dt from t0 to t1 ≥ t0, accurate also where t1 − t0 is small."""
    rise = t1 - t0
    x = rise / (1 + t0 * t1)
    if 0 <= x < 0.15:  # atan t1 − atan t0 = atan x, as a series: error below 1e-9 of x
        y = x * x
        angle = x * (1 - y * (1 / 3 - y * (1 / 5 - y * (1 / 7 - y * (1 / 9 - y / 11)))))
    else:
        angle = math.atan(t1) - math.atan(t0)
    both = rise / ((1 + t0 * t0) * (1 + t1 * t1))
    return n_h * (angle + both * (1 - t0 * t1)) + n_z * both * (t0 + t1)


@numba.njit(cache=True, error_model="numpy")
def _border(position, direction, low, high):
    """Distance from ``position``, along a line of that ``direction``, to the last of the places low … high − 1."""
    if direction > 0:
        return (high - 1 - position) / direction
    if direction < 0:
        return (low - position) / direction
    return np.inf


# More than seven parameters: compiled code for one place, without a record made for each call.
@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _below(plane, down, across, t, s0, s1, dx, dy):
    """Whether a chunk of a profile certainly lies below the line of sight of slope ``t`` from the point.

    The chunk reaches from ``s0`` to ``s1``, distances from the point in pixels, in the direction (``dx``, ``dy``), a
    unit vector with x to the right and y up. ``plane`` (value, slope along rows, slope along columns) bounds the
    surface there from above: a height in pixels relative to the point, and its change per row down and per column to
    the right. It has that value at the pixel ``down`` rows and ``across`` columns from the point. Slopes are pixels per
    pixel. Bound and line of sight are linear in the distance, so if one is below the other at both ends, it is below it
    in between.
    """
    value, slope_y, slope_x = plane
    above = value - slope_y * down
    above -= slope_x * across
    gain = slope_x * dx - slope_y * dy - t
    return above + gain * s0 < 0 and above + gain * s1 < 0


# More than seven parameters and more than sixty lines: a helper that takes arrays, called for each profile or each
# piece, makes the compiled loop a tenth slower, so the walk along a profile is one function.
@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _visible(i, surface, points, azimuths, half_planes, nearness, highest, profile, stop, seen, light):
    """Find what point ``i`` sees: outward along each half-plane, the pieces above the steepest slope met so far.

    Fills, for half-plane number a of ``azimuths``, ``profile[a]`` with n_h, the slope up to which everything is hidden,
    and the half-plane's share of the hemisphere. The crossings that are seen are ``seen[stop[a]:stop[a + 1]]``, and
    ``light`` is the weight of the light at each. Returns n_z, the cosine between normal and line of sight.
    """
    height, box, bound, tiles, _ = surface
    at, normal, phase, ray = points
    compass, chunks, chunk, middle, edge, place = half_planes
    width, z = height.shape[1], height.reshape(-1)
    o = at[i]
    z0, row, col = z[o], o // width, o % width
    # v = (−x, −y, 1) / far_off, toward the camera; (0, 0, 1) where rays are parallel.
    x, y = ray[i, 0], ray[i, 1]
    far_off = math.sqrt(1 + x * x + y * y)
    n_z = (normal[i, 2] - x * normal[i, 0] - y * normal[i, 1]) / far_off
    pieces, stop[0] = 0, 0
    for a in range(azimuths):
        k = phase[i] + a * (compass.shape[0] // azimuths)
        dx, dy = compass[k, 0], compass[k, 1]
        along = -(x * dx + y * dy) / far_off
        across = math.sqrt(1 - along * along)
        n_h = (normal[i, 0] * dx + normal[i, 1] * dy - along * n_z) / across
        # Slopes t of the height field; cotθ about v is scale · t + level.
        scale, level = far_off / ((1 + nearness * z0) * across), along / across
        away = min(_border(row, -dy, box[0], box[1]), _border(col, dx, box[2], box[3]))
        t = (-n_h / n_z - level) / scale  # the slope up to which all is hidden, at first by the tangent plane
        t += GRAZING * (1 + t * t)
        first, last = chunk[k, 0], -2
        for c in range(len(chunks)):
            s0, stride = float(chunks[c, 0]), chunks[c, 1]
            s1 = s0 + CHUNK * stride
            if s0 > away or (t > 0 and highest - z0 < t * s0):
                break
            end = chunk[k, c + 1]
            if s1 > away:  # nothing is farther off, not even a place in the array
                while end > chunk[k, c] and place[end - 1, 1] > away:
                    end -= 1
            elif c > 0:
                tile = TILE * stride
                tile_row, tile_col = (row + middle[k, c, 0]) // tile, (col + middle[k, c, 1]) // tile
                b = tiles[c, 0] + tile_row * tiles[c, 1] + tile_col
                plane = bound[b, 0] - z0, bound[b, 1], bound[b, 2]
                down, right = tile * tile_row + tile // 2 - row, tile * tile_col + tile // 2 - col
                if _below(plane, down, right, t, s0, s1, dx, dy):
                    continue
            for j in range(chunk[k, c], end):
                s = place[j, 1]
                h = z[o + edge[j, 0]]
                h += place[j, 0] * (z[o + edge[j, 1]] - h) - z0
                if h <= t * s:
                    continue
                # T is linear along a piece of the profile: each of its ends counts half.
                far = 0.5 * _band(n_h, n_z, scale * t + level, scale * h / s + level)
                if last == j - 1:
                    light[pieces - 1] += far
                else:
                    near = far
                    if j > first:
                        r = place[j - 1, 1]
                        g = z[o + edge[j - 1, 0]]
                        g += place[j - 1, 0] * (z[o + edge[j - 1, 1]] - g) - z0
                        if g > NO_HEIGHT:  # seen from where it comes up over the horizon, not from its near end
                            near *= 1 - min((t * r - g) / (h - g - t * (s - r)), 1.0)
                            far = 2 * far - near
                        else:  # the rim beyond a hole: it hides what is below, and shows nothing
                            near = far = 0.0
                    seen[pieces], light[pieces] = j - 1, near
                    pieces += 1
                seen[pieces], light[pieces] = j, far
                pieces += 1
                last = j
                t = h / s
        profile[a, 0], profile[a, 1], profile[a, 2] = n_h, t, 1 / azimuths / (far_off * across * across)
        stop[a + 1] = pieces
    return n_z


# More than seven parameters: arrays that ``_visible`` filled and arrays to fill, without a record made for each call.
@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _put_row(i, surface, points, azimuths, half_planes, profile, stop, seen, light, index, weight):
    """Write row ``i`` of K: the weight of each crossing is divided between the two vertices of its edge.

    Returns the number of entries. ``profile``, ``stop``, ``seen``, ``light`` are as `_visible` fills them. Entries
    beyond the capacity of the row are counted but not written. Successive edges share a vertex, so two vertices are
    kept back, and their weights summed, until an edge comes that has neither. The first piece of a half-plane begins at
    the point itself.
    """
    column, o = surface[4], points[0][i]
    compass, _, chunk, _, edge, place = half_planes
    met = 0
    for a in range(azimuths):
        first = chunk[points[2][i] + a * (compass.shape[0] // azimuths), 0]
        share = profile[a, 2]
        held0, held1, weight0, weight1 = o, o, 0.0, 0.0
        for e in range(stop[a], stop[a + 1] + 1):
            u = v = -1
            of_u = of_v = 0.0
            if e < stop[a + 1]:
                j, of_u = seen[e], share * light[e]
                u = v = o
                if j >= first:
                    u, v = o + edge[j, 0], o + edge[j, 1]
                    of_v = place[j, 0] * of_u
                    of_u -= of_v
            for _ in range(2):
                if held0 == u:
                    of_u += weight0
                elif held0 == v:
                    of_v += weight0
                elif weight0 > 0:
                    if met < index.shape[1]:
                        index[i, met], weight[i, met] = column[held0], weight0
                    met += 1
                held0, weight0 = held1, weight1
            held0, held1, weight0, weight1 = u, v, of_u, of_v
    return met


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _put_sky(i, points, azimuths, half_planes, profile, n_z, sky):
    """Write row ``i`` of `open_sky`, for parallel rays: the sky is open from the zenith to the horizon t = cotθ."""
    compass, once = half_planes[0], 1 / azimuths
    sky0 = sky1 = sky2 = sky3 = 0.0
    for a in range(azimuths):
        k = points[2][i] + a * (compass.shape[0] // azimuths)
        dx, dy = compass[k, 0], compass[k, 1]
        n_h, t = profile[a, 0], profile[a, 1]
        sin = 1 / math.sqrt(1 + t * t)
        cos = t * sin
        side = 0.5 * sin * sin
        down = 0.5 * (math.atan2(sin, cos) - sin * cos)
        sky0 += n_h * down + n_z * side
        down = 2 / 3 - cos + cos**3 / 3  # ∫ sin³θ dθ
        sky1 += dx * (n_h * down + n_z * sin**3 / 3)
        sky2 += dy * (n_h * down + n_z * sin**3 / 3)
        sky3 += n_h * sin**3 / 3 + n_z * (1 - cos**3) / 3
    sky[i, 0], sky[i, 1] = 2 * once * sky0, 2 * once * sky1
    sky[i, 2], sky[i, 3] = 2 * once * sky2, 2 * once * sky3


# More than seven parameters: compiled code takes the arrays of ``_Sweep`` in groups, and the numbers singly.
@numba.njit(cache=True)
def _sweep_block(begin, end, surface, points, azimuths, half_planes, nearness, out):
    """Write rows ``begin`` to ``end`` of K for ``points`` to ``out``: entries, their number, and the sky.

    The number of entries includes those for which there is no room. Each call handles all half-planes of a point,
    because a call takes as long as a short profile.
    """
    index, weight, count, sky = out
    highest = surface[0].max()
    most = 6 * (CHUNK + 1) * len(half_planes[1]) * azimuths  # crossings of a point's half-planes with the mesh, twice
    seen, light = np.empty(most, np.int64), np.empty(most)
    profile, stop = np.empty((azimuths, 3)), np.empty(azimuths + 1, np.int64)
    for i in range(begin, end):
        n_z = _visible(i, surface, points, azimuths, half_planes, nearness, highest, profile, stop, seen, light)
        count[i] = _put_row(i, surface, points, azimuths, half_planes, profile, stop, seen, light, index, weight)
        _put_sky(i, points, azimuths, half_planes, profile, n_z, sky)


@numba.njit(parallel=True, cache=True)
def _sweep_rows(surface, points, azimuths, half_planes, nearness, out):
    """The rows of all ``points``, in BLOCKS for the threads."""
    count = len(points[0])
    for b in numba.prange(BLOCKS):
        begin, end = count * b // BLOCKS, count * (b + 1) // BLOCKS
        _sweep_block(begin, end, surface, points, azimuths, half_planes, nearness, out)
