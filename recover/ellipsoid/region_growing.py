"""Ellipsoids grown from small patches of the picture: fit, accept the neighbours that lie on it, fit again. Compiled.

Colours here are whitened (``recover.ellipsoid.fit.whitening``) and their noise has covariance V. Distances to an
ellipsoid are Sampson's, in standard deviations of that noise: on the true ellipsoid they are independent with standard
deviation 1, and their means over 5×5 pixels have 1/5. The means reject the strips of pixels between two ellipsoids,
which a cut on single distances accepts.

Compiled code cannot read the parameters: callers pass them as the vector ``settings`` that ``growth_settings`` makes.
"""

import numba
import numpy as np

from huesphere.recover.ellipsoid.parameters import ELLIPSOID

# Growth ends, in the later half of its rounds, below this change (relative change of the number of pixels).
GROWTH_TOLERANCE = 0.01

FAR = 1e9  # the distance of a pixel that is not usable
FEWEST_NEAR = 6.0  # pixels of a window that must be near: as many as C has unknowns
FEWEST_FITTED = 12  # pixels of a fit: twice the unknowns of C
SINGULAR = 1e-13  # least over largest eigenvalue of the normal equations, to rounding
FLAT = 1e-5  # least over largest eigenvalue of C in whitened colours: less is a cylinder, to rounding

DISTANCE_CUT, NEAR_SHARE, MEAN_CUT, FEWEST_REGION, TOLERANCE, HALF_WINDOW = range(6)  # places in ``settings``


def growth_settings() -> np.ndarray:
    """The parameters of ``recover.ellipsoid.parameters`` that growth uses, in the order of the names above."""
    return np.array(
        [
            ELLIPSOID.growing_distance_cut,
            ELLIPSOID.near_share,
            ELLIPSOID.window_mean_cut,
            ELLIPSOID.fewest_region_pixels,
            GROWTH_TOLERANCE,
            ELLIPSOID.averaging_window_px // 2,
        ],
        dtype=np.float64,
    )


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def distances(rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, V: np.ndarray, out: np.ndarray) -> None:
    """out (H, W) = (ρᵀCρ − 1) / (2 √(ρᵀC V Cρ)), standard deviations; FAR where not usable.

    ``rgb`` (H, W, 3) whitened colours ρ, V (3, 3) the covariance of their noise.
    """
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            out[i, j] = FAR
            if usable[i, j]:
                x, y, z = rgb[i, j, 0], rgb[i, j, 1], rgb[i, j, 2]
                a = C[0, 0] * x + C[0, 1] * y + C[0, 2] * z
                b = C[1, 0] * x + C[1, 1] * y + C[1, 2] * z
                c = C[2, 0] * x + C[2, 1] * y + C[2, 2] * z
                square = V[0, 0] * a * a + V[1, 1] * b * b + V[2, 2] * c * c
                square += 2 * (V[0, 1] * a * b + V[0, 2] * a * c + V[1, 2] * b * c)
                d = (x * a + y * b + z * c - 1.0) / (2 * np.sqrt(square) + 1e-300)
                out[i, j] = d


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def box_sums(image: np.ndarray, half: int, out: np.ndarray) -> None:
    """Write to ``out`` (H, W) the sums of ``image`` (H, W) over the square of (2·half + 1)² pixels around each pixel.

    Parts of a square beyond the picture count as 0. Running sums: the time does not depend on ``half``.
    """
    height, width = image.shape
    columns = np.zeros(width)
    for i in range(-half, height):
        for j in range(width):
            if i + half < height:
                columns[j] += image[i + half, j]
            if i - half - 1 >= 0:
                columns[j] -= image[i - half - 1, j]
        if i < 0:
            continue
        running = 0.0
        for j in range(-half, width):
            if j + half < width:
                running += columns[j + half]
            if j - half - 1 >= 0:
                running -= columns[j - half - 1]
            if j >= 0:
                out[i, j] = running


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def accept(
    distance: np.ndarray,
    weight: np.ndarray,
    mean_cut: float,
    settings: np.ndarray,
    near_distance: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """out (H, W) = 1 where both the distance and its mean over the window are those of a pixel on the ellipsoid.

    The mean is over the pixels of the window that are near the ellipsoid: where two ellipsoids meet at an edge, pixels
    of the other do not count. But ``near_share`` of the usable pixels of the window, ``weight`` (H, W), must be near.
    ``mean_cut`` is in standard deviations of the mean. ``near_distance`` (H, W) and ``work`` (3, H, W) are scratch.
    """
    height, width = distance.shape
    half = int(settings[HALF_WINDOW])
    for i in range(height):
        for j in range(width):
            work[0, i, j] = abs(distance[i, j]) < settings[DISTANCE_CUT]
            near_distance[i, j] = distance[i, j] if work[0, i, j] else 0.0
    box_sums(work[0], half, work[1])
    box_sums(near_distance, half, work[2])
    for i in range(height):
        for j in range(width):
            count = work[1, i, j]
            mean_is_noise = abs(work[2, i, j]) < mean_cut * np.sqrt(count)
            enough = count >= max(settings[NEAR_SHARE] * weight[i, j], FEWEST_NEAR)
            out[i, j] = work[0, i, j] > 0 and mean_is_noise and enough


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def flood(accepted: np.ndarray, region: np.ndarray, reach: int, queue: np.ndarray) -> int:
    """Make ``region`` (H, W), in place, the accepted pixels within ``reach`` steps of it; returns how many.

    Steps go through ``accepted`` (H, W) pixels, up, down, left or right. ``queue`` (H·W,) int is scratch.
    """
    height, width = accepted.shape
    tail = 0
    for i in range(height):
        for j in range(width):
            region[i, j] = region[i, j] and accepted[i, j]
            if region[i, j]:
                queue[tail] = i * width + j
                tail += 1
    head = 0
    for _ in range(reach):
        end = tail
        if head == end:
            break
        while head < end:
            i, j = queue[head] // width, queue[head] % width
            head += 1
            for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                k, l = i + di, j + dj
                if 0 <= k < height and 0 <= l < width and accepted[k, l] and not region[k, l]:
                    region[k, l] = 1
                    queue[tail] = k * width + l
                    tail += 1
    return tail


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def fit_region(rgb: np.ndarray, region: np.ndarray, bias: np.ndarray, C: np.ndarray) -> bool:
    """C (3, 3), in place: least squares over ``region`` (H, W) without the noise's bias, Eq. (10); False: no ellipsoid.

    ``bias`` (8, 6, 6) is explained in ``recover.ellipsoid.candidates.bias_terms``.
    """
    gram, right, count = np.zeros((6, 6)), np.zeros(6), 0.0
    m = np.empty(6)
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            if region[i, j]:
                x, y, z = rgb[i, j, 0], rgb[i, j, 1], rgb[i, j, 2]
                m[0], m[1], m[2], m[3], m[4], m[5] = x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z
                count += 1.0
                for a in range(6):
                    right[a] += m[a]
                    for b in range(a, 6):
                        gram[a, b] += m[a] * m[b]
    for a in range(6):
        for b in range(a):
            gram[a, b] = gram[b, a]
    return solve_unbiased(gram, right, count, bias, C)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def solve_unbiased(gram: np.ndarray, right: np.ndarray, count: float, bias: np.ndarray, C: np.ndarray) -> bool:
    """C (3, 3), in place, from the normal equations of ``count`` pixels less their bias; False: no ellipsoid."""
    clean = gram + count * bias[6]
    for a in range(6):
        clean += right[a] * bias[a]
    clean_right = right + count * bias[7, 0]
    if count < FEWEST_FITTED:
        return False
    # Where there is as much noise as signal the unbiased equations have no ellipsoid: then the biased ones are solved.
    for attempt in range(2):
        if attempt == 1:
            clean, clean_right = gram, right
        pivot = np.linalg.eigvalsh(clean)
        if not pivot[0] > SINGULAR * pivot[5]:
            continue
        z = np.linalg.solve(clean, clean_right)
        C[0, 0], C[1, 1], C[2, 2] = z[0], z[1], z[2]
        C[0, 1], C[0, 2], C[1, 2] = z[3], z[4], z[5]
        C[1, 0], C[2, 0], C[2, 1] = z[3], z[4], z[5]
        eigenvalues = np.linalg.eigvalsh(C)
        if eigenvalues[0] > FLAT * eigenvalues[2]:
            return True
    return False


# More than seven parameters: compiled code takes arrays where others take a record.
@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def grow(
    rgb: np.ndarray,
    usable: np.ndarray,
    weight: np.ndarray,
    V: np.ndarray,
    bias: np.ndarray,
    box: np.ndarray,
    C: np.ndarray,
    reaches: np.ndarray,
    final_cuts: np.ndarray,
    settings: np.ndarray,
    region: np.ndarray,
) -> None:
    """Grow one seed: C (3, 3) in place, NaN where it failed, and its pixels ``region`` (H, W) uint8 in place.

    ``rgb`` (H, W, 3) whitened, ``usable`` (H, W) uint8, ``weight`` (H, W) the usable pixels of each window, V (3, 3)
    the covariance of the noise, ``bias`` (8, 6, 6) of it. ``box`` (4,) is the first region (row, row end, column,
    column end), ``reaches`` the steps of growth in each round, and ``final_cuts`` the mean cuts of the rounds after
    growth, in which pixels need not be connected. ``settings``: ``growth_settings``. The arguments are many because
    compiled code takes arrays and no records.
    """
    height, width = usable.shape
    distance, near_distance = np.empty((height, width)), np.empty((height, width))
    half = int(settings[HALF_WINDOW])
    work = np.empty((3, height, width))
    accepted = np.empty((height, width), np.uint8)
    queue = np.empty(height * width, np.int64)
    region[:] = 0
    top, bottom, left, right = box[0], box[1], box[2], box[3]
    region[top:bottom, left:right] = 1
    before, alive = 0, True
    for t in range(len(reaches) + len(final_cuts)):
        growing = t < len(reaches)
        if growing and before < 0:
            continue
        # Only pixels that the region can reach in this round matter, with the window about each.
        margin = reaches[t] + half if growing else height + width
        top, bottom = max(0, top - margin), min(height, bottom + margin)
        left, right = max(0, left - margin), min(width, right + margin)
        colours, own = rgb[top:bottom, left:right], region[top:bottom, left:right]
        far, taken = distance[top:bottom, left:right], accepted[top:bottom, left:right]
        distances(colours, usable[top:bottom, left:right], C, V, far)
        cut = settings[MEAN_CUT] if growing else final_cuts[t - len(reaches)]
        scratch, scratch_near = work[:, top:bottom, left:right], near_distance[top:bottom, left:right]
        accept(far, weight[top:bottom, left:right], cut, settings, scratch_near, scratch, taken)
        if growing:
            count = flood(taken, own, reaches[t], queue)
            converged = t >= len(reaches) // 2 and abs(count - before) < settings[TOLERANCE] * count
            before = -1 if converged else count
        else:
            open3(taken, own)
            count = int(own.sum())
        if count < settings[FEWEST_REGION] or not fit_region(colours, own, bias, C):
            alive = False
            break
    if not alive:
        C[:] = np.nan


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def open3(accepted: np.ndarray, out: np.ndarray) -> None:
    """out (H, W) = the union of the 3×3 squares that lie wholly in ``accepted`` (H, W): a morphological opening."""
    out[:] = 0
    for i in range(1, accepted.shape[0] - 1):
        for j in range(1, accepted.shape[1] - 1):
            if accepted[i - 1 : i + 2, j - 1 : j + 2].all():
                out[i - 1 : i + 2, j - 1 : j + 2] = 1
