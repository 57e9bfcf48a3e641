"""Shells grown from small patches of the picture: fit, take the neighbours that lie on it, fit again. Compiled.

Colours here are whitened (``recover.ellipsoid.fit.whitening``) and their noise has covariance V. Distances to an
ellipsoid are Sampson's, in standard deviations of that noise, so that on a true shell they are white with deviation 1,
and their means over 5×5 pixels have 1/5: the means find the contact strips between shells that single pixels do not.
"""

import numba
import numpy as np

FAR = 1e9  # the distance of a pixel that is not usable
NEAR_SHARE = 0.85  # of the usable pixels of a window that must be near the shell
MEAN_CUT = 3.0  # standard deviations of a mean: beyond, a stranger
PIXEL_CUT = 4.0  # of a single distance: wide, for the bias correction needs a cut that does not hang on single values
HALF = 2  # pixels: means are over (2·HALF + 1)²


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def distances(rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, V: np.ndarray, out: np.ndarray) -> None:
    """out (H, W) = (ρᵀCρ − 1) / (2 √(ρᵀC V Cρ)), FAR where not usable."""
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
    """out (H, W) = sums of ``image`` over (2·half + 1)², less at the picture's edge."""
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
    distance: np.ndarray, weight: np.ndarray, cut: float, near: np.ndarray, work: np.ndarray, out: np.ndarray
) -> None:
    """out (H, W) = 1 where both the distance and its mean over the window are those of a pixel on the shell.

    The mean is over those of the window that are near: where shells meet at an edge it does not ask the other's pixels,
    but half of the ``weight`` (H, W), the usable pixels of each window, must be near. The rest is room to work in.
    """
    height, width = distance.shape
    for i in range(height):
        for j in range(width):
            work[0, i, j] = abs(distance[i, j]) < PIXEL_CUT
            near[i, j] = distance[i, j] if work[0, i, j] else 0.0
    box_sums(work[0], HALF, work[1])
    box_sums(near, HALF, work[2])
    for i in range(height):
        for j in range(width):
            count = work[1, i, j]
            white = abs(work[2, i, j]) < cut * np.sqrt(count)
            out[i, j] = work[0, i, j] > 0 and white and count >= max(NEAR_SHARE * weight[i, j], 6.0)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def flood(accepted: np.ndarray, region: np.ndarray, reach: int, queue: np.ndarray) -> int:
    """Make ``region`` (H, W) the accepted pixels within ``reach`` steps of it, through accepted ones; how many."""
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
    """C (3, 3), in place: least squares over ``region`` (H, W) without the noise's bias; False: no ellipsoid.

    ``bias`` (7, 6, 6) and what it means: ``recover.ellipsoid.candidates.bias_terms``.
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
    return solve(gram, right, count, bias, C)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def solve(gram: np.ndarray, right: np.ndarray, count: float, bias: np.ndarray, C: np.ndarray) -> bool:
    """C (3, 3), in place, from normal equations less their bias; False if it is not positive definite."""
    clean = gram + count * bias[6]
    for a in range(6):
        clean += right[a] * bias[a]
    clean_right = right + count * bias[7, 0]
    if count < 12:
        return False
    # Where there is as much noise as signal the unbiased equations have no ellipsoid; the biased ones are tried then.
    for attempt in range(2):
        if attempt == 1:
            clean, clean_right = gram, right
        pivot = np.linalg.eigvalsh(clean)
        if not pivot[0] > 1e-13 * pivot[5]:
            continue
        z = np.linalg.solve(clean, clean_right)
        C[0, 0], C[1, 1], C[2, 2] = z[0], z[1], z[2]
        C[0, 1], C[0, 2], C[1, 2] = z[3], z[4], z[5]
        C[1, 0], C[2, 0], C[2, 1] = z[3], z[4], z[5]
        eigenvalues = np.linalg.eigvalsh(C)
        if eigenvalues[0] > 1e-5 * eigenvalues[2]:
            return True
    return False


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
    polishing: np.ndarray,
    region: np.ndarray,
) -> None:
    """Grow one seed: C (3, 3) in place, NaN where it died, and its pixels ``region`` (H, W) uint8.

    ``box`` (4,) is the first region (row, row end, column, column end); ``reaches`` the steps of growth in each
    round; ``polishing`` the cuts of the rounds after it, in which pixels need not hang together any more.
    """
    height, width = usable.shape
    distance, near = np.empty((height, width)), np.empty((height, width))
    work = np.empty((3, height, width))
    accepted = np.empty((height, width), np.uint8)
    queue = np.empty(height * width, np.int64)
    region[:] = 0
    top, bottom, left, right = box[0], box[1], box[2], box[3]
    region[top:bottom, left:right] = 1
    before, alive = 0, True
    for t in range(len(reaches) + len(polishing)):
        growing = t < len(reaches)
        if growing and before < 0:
            continue
        # Nothing farther off than the region may reach this round, and a window about that, need be looked at.
        margin = reaches[t] + HALF if growing else height + width
        top, bottom = max(0, top - margin), min(height, bottom + margin)
        left, right = max(0, left - margin), min(width, right + margin)
        colours, own = rgb[top:bottom, left:right], region[top:bottom, left:right]
        far, taken = distance[top:bottom, left:right], accepted[top:bottom, left:right]
        distances(colours, usable[top:bottom, left:right], C, V, far)
        cut = MEAN_CUT if growing else polishing[t - len(reaches)]
        room = work[:, top:bottom, left:right]
        accept(far, weight[top:bottom, left:right], cut, near[top:bottom, left:right], room, taken)
        if growing:
            count = flood(taken, own, reaches[t], queue)
            settled = t >= len(reaches) // 2 and abs(count - before) < 0.01 * count
            before = -1 if settled else count
        else:
            open3(taken, own)
            count = int(own.sum())
        if count < 40 or not fit_region(colours, own, bias, C):
            alive = False
            break
    if not alive:
        C[:] = np.nan


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def open3(accepted: np.ndarray, out: np.ndarray) -> None:
    """out (H, W) = the union of the whole 3×3 squares in ``accepted`` (H, W)."""
    out[:] = 0
    for i in range(1, accepted.shape[0] - 1):
        for j in range(1, accepted.shape[1] - 1):
            if accepted[i - 1 : i + 2, j - 1 : j + 2].all():
                out[i - 1 : i + 2, j - 1 : j + 2] = 1
