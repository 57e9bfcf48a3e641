"""One light that pixels miss, fitted to their colours alone: guessed from small windows, refined, and its partners.

Let F be the matrix that pixels would have if they saw a light of colour b and direction a (unit, camera frame). A pixel
that misses the light has the colour ρ = (F − b aᵀ) n. For a guessed *direction* of b, |n| = 1 gives the pixel's normal
and τ = −|b| a·n in closed form (a quadratic), and τ must be linear in n: three numbers, |b| a, follow by least squares
over a window. Everything here is compiled and runs without Python's lock, so that windows can be shared out to threads.
A light is an array of six numbers, (b, a).
"""

from typing import NamedTuple

import numba
import numpy as np

from huesphere.recover.geometry.sphere import nearest_normals
from huesphere.recover.lights.missed_light import add_equation, cofactors, matrix_without

WINDOW_PIXELS = 36  # pixels of a window that judge a guess, at most: bounds the work
FIRST_PIXELS = 12  # pixels that judge every guess before that
GUESSES_KEPT = 12  # one guess in so many is then judged by more than the first pixels
REWEIGHTINGS = 3  # fits of a guess to the pixels that agree with it best
WINDOW_ROUNDS, ROUNDS = 10, 12  # rounds of Gauss–Newton, at most: of a guess on its window, and on more pixels
NARROWING = 0.7  # by which the robust loss gets narrower from round to round
FAR = 3  # widths of the robust loss beyond which a pixel has next to no weight and is left out
CONVERGED = 1e-8  # relative move of a light, at the last width, below which it has converged
RIDGE = 1e-7  # of the trace, added to normal equations that may be singular


class WindowLimits(NamedTuple):
    """What a guess must hold to; see the parameters of these names (``recover.lights.parameters``)."""

    far_side_cosine: float
    far_side_share: float
    window_share: float
    alike_cosine: float
    alike_colour: float


def folds(base: np.ndarray, b: np.ndarray, a: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """All (b, a) for which (base − b aᵀ) n, |n| = 1, is the same ellipsoid: up to four, each with both signs of (b, a).

    ``base`` (3, 3) is the matrix that pixels would have if they saw the light, ``b`` (3,) the light's colour, ``a``
    (3,) its unit direction; the given (b, a) comes first. In units of the base, c = base⁻¹ b, the ellipsoid is
    1 + a eᵀ + e aᵀ with e = d + a |d|²/2 and d = c / (1 − a·c): a and e may change roles, and each (a, e) has two d.
    """
    c = np.linalg.solve(base, b)
    out = [(b, a)]
    if abs(1 - a @ c) < 1e-3:
        return out
    d = c / (1 - a @ c)
    e = d + a * (d @ d) / 2
    for first, second in ((a, e), (e, a)):
        length = float(np.linalg.norm(first))
        plane, partner = first / length, second * length
        middle = 1 + plane @ partner
        square = middle**2 - partner @ partner
        if square < 0:
            continue
        for root in (np.sqrt(square), -np.sqrt(square)):
            d = partner - (middle - root) * plane
            if abs(1 + plane @ d) < 1e-4:
                continue
            colour = base @ (d / (1 + plane @ d))
            for sign in (1.0, -1.0):
                fold = sign * colour, sign * plane
                if all(
                    np.linalg.norm(fold[0] - o[0]) > 0.02 * np.linalg.norm(o[0]) or fold[1] @ o[1] < 0.9995 for o in out
                ):
                    out.append(fold)
    return out


def refined(
    rho: np.ndarray, base: np.ndarray, start: np.ndarray, coarse: float, fine: float, *, rounds: int = ROUNDS
) -> np.ndarray:
    """The light (b, a) (6,) reached from ``start`` (6,), fitted to those colours ``rho`` (P, 3) that it explains.

    ``base`` (3, 3): the matrix that the pixels would have if they saw the light. The width of the robust loss shrinks
    from ``coarse`` to ``fine``, picture units.
    """
    out = start.copy()
    refine(rho, base, out, coarse, fine, rounds)
    return out


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def support(rho: np.ndarray, base: np.ndarray, guesses: np.ndarray, width: float) -> np.ndarray:
    """How many of the colours ρ (P, 3) each (b, a) of ``guesses`` (K, 6) explains (K,).

    A colour counts by 1 − (distance / ``width``)², and not at all beyond ``width`` (picture units).
    """
    out, M = np.zeros(len(guesses)), np.empty((3, 3))
    n, distance = np.empty((len(rho), 3)), np.empty(len(rho))
    for k in range(len(guesses)):
        matrix_without(base, guesses[k], M)
        nearest_normals(rho, M, n, distance)
        for p in range(len(rho)):
            out[k] += max(0.0, 1 - (distance[p] / width) ** 2)
    return out


# More than seven parameters and sixty lines: one compiled loop, whose arguments are arrays or numbers.
@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def scan(
    windows: np.ndarray,
    counts: np.ndarray,
    length: np.ndarray,
    rho: np.ndarray,
    c: np.ndarray,
    b: np.ndarray,
    base: np.ndarray,
    lit: np.ndarray,
    limits: WindowLimits,
    fine: float,
    out: np.ndarray,
) -> None:
    """out (W, best, 6), in place: (b, a) of the guesses that fit each window best, refined to it; NaN: there are none.

    ``windows`` (W, most) holds numbers of pixels, ``counts`` (W,) how many. ``length`` (P, 3) is base⁻¹ρ, ``c`` and
    ``b`` (K, 3) the guessed colours in units of the base and of the picture, ``lit`` (N, 3) normals of pixels that see
    every light, ``fine`` the last width of the robust loss, picture units. One compiled loop over windows, with all its
    arguments arrays or numbers, as Numba needs: hence their count, and its length.
    """
    best, guesses = out.shape[1], 2 * len(c)
    whole, beyond_1 = np.empty((WINDOW_PIXELS, 3)), np.empty(WINDOW_PIXELS)  # base⁻¹ρ, |base⁻¹ρ|² − 1
    room, kept = np.empty((WINDOW_PIXELS, 6)), np.empty(WINDOW_PIXELS, np.bool_)
    n, guess, M = np.zeros(3), np.empty(6), np.empty((3, 3))
    coarse, work = np.empty(guesses), np.empty(guesses)
    for w in range(len(windows)):
        scores = np.full(best, np.inf)
        out[w] = np.nan
        few = min(counts[w], WINDOW_PIXELS)
        for i in range(few):
            whole[i] = length[windows[w, i]]
            beyond_1[i] = whole[i, 0] ** 2 + whole[i, 1] ** 2 + whole[i, 2] ** 2 - 1
        limit = np.inf
        if few > 2 * FIRST_PIXELS:
            for k in range(guesses):
                coarse[k] = _misfit(whole, beyond_1, FIRST_PIXELS, c[k // 2], k % 2 == 0, limits, 1, room, kept, n)
            limit = _ranked(coarse, guesses, guesses // GUESSES_KEPT, work)
        for k in range(guesses):
            if few > 2 * FIRST_PIXELS and not coarse[k] <= limit:
                continue
            score = _misfit(whole, beyond_1, few, c[k // 2], k % 2 == 0, limits, REWEIGHTINGS, room, kept, n)
            place = int(np.argmax(scores))
            if score >= scores[place]:
                continue
            size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            beyond = 0
            for i in range(len(lit)):
                if lit[i, 0] * n[0] + lit[i, 1] * n[1] + lit[i, 2] * n[2] < -limits.far_side_cosine * size:
                    beyond += 1
            if beyond > 2 * limits.far_side_share * len(lit):
                continue
            guess[:3], guess[3:] = b[k // 2] * size, n / size
            # Of two that are nearly the same the better one is enough.
            for x in range(best):
                if np.isfinite(scores[x]) and alike(guess, out[w, x], limits.alike_cosine, limits.alike_colour):
                    place = x
                    break
            if score < scores[place]:
                scores[place] = score
                out[w, place] = guess
        near = np.empty((counts[w], 3))
        for i in range(counts[w]):
            near[i] = rho[windows[w, i]]
        for k in range(best):
            if np.isfinite(scores[k]):
                matrix_without(base, out[w, k], M)
                distance = np.empty(counts[w])
                nearest_normals(near, M, np.empty((counts[w], 3)), distance)
                most = int(limits.window_share * few)
                width = _ranked(distance, counts[w], most - 1, np.empty(counts[w]))
                refine(near, base, out[w, k], width, fine, WINDOW_ROUNDS)


# More than seven parameters: it is called in the innermost loop, with plain arrays.
@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _misfit(
    whole: np.ndarray,
    beyond_1: np.ndarray,
    few: int,
    c: np.ndarray,
    first_root: bool,
    limits: WindowLimits,
    fits: int,
    room: np.ndarray,
    kept: np.ndarray,
    n: np.ndarray,
) -> float:
    """Root mean square of τ + m·n, over |n|, of the first ``few`` pixels for one guessed colour; n (3,) in place.

    Least squares, then again, ``fits`` times at most, on the share of the pixels that it fits best: others may miss
    other lights. Infinite where no light can have that colour. ``c`` (3,): the guessed colour in units of the base;
    ``first_root``: which solution of the quadratic; ``room`` and ``kept``: working space. Called in the innermost loop,
    so its arguments are plain arrays.
    """
    c0, c1, c2 = c[0], c[1], c[2]
    cc = c0 * c0 + c1 * c1 + c2 * c2
    most, bad = int(limits.window_share * few), 0
    m, tau, left, work = room[:, :3], room[:, 3], room[:, 4], room[:, 5]
    for i in range(few):
        m0, m1, m2 = whole[i, 0], whole[i, 1], whole[i, 2]
        along = m0 * c0 + m1 * c1 + m2 * c2
        square = along * along - cc * beyond_1[i]
        kept[i] = square >= 0
        if square < 0:
            bad += 1
            if bad > few - most:
                return np.inf
            square = 0.0
        step = np.sqrt(square) if (along > 0) != first_root else -np.sqrt(square)
        tau[i] = (along + step) / cc
        m[i, 0], m[i, 1], m[i, 2] = m0 - c0 * tau[i], m1 - c1 * tau[i], m2 - c2 * tau[i]
    total = np.inf
    for _ in range(fits):
        if not _linear(m, tau, kept, few, n):
            break
        for i in range(few):
            left[i] = (tau[i] + m[i, 0] * n[0] + m[i, 1] * n[1] + m[i, 2] * n[2]) ** 2
        cut = _ranked(left, few, most - 1, work)
        total, moved = 0.0, False
        for i in range(few):
            near_enough = left[i] <= cut
            moved |= near_enough != kept[i]
            kept[i] = near_enough
            total += left[i] if near_enough else 0.0
        if not moved:
            break
    size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if size < 1e-6 or n[2] < -limits.far_side_cosine * size:
        return np.inf
    return np.sqrt(total / most) / size  # type: ignore[no-any-return]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _ranked(values: np.ndarray, count: int, rank: int, work: np.ndarray) -> float:
    """The element of this rank among the first ``count`` values (Hoare's selection): a few dozen, many times over."""
    work[:count] = values[:count]
    low, high = 0, count - 1
    while low < high:
        pivot, i, j = work[(low + high) // 2], low, high
        while i <= j:
            while work[i] < pivot:
                i += 1
            while work[j] > pivot:
                j -= 1
            if i <= j:
                work[i], work[j] = work[j], work[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return work[rank]  # type: ignore[no-any-return]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _linear(m: np.ndarray, tau: np.ndarray, kept: np.ndarray, few: int, n: np.ndarray) -> bool:
    """n (3,), in place, with least Σ (τ + m·n)² over the first ``few`` that are ``kept``; whether there is one."""
    xx = xy = xz = yy = yz = zz = gx = gy = gz = 0.0
    for i in range(few):
        if kept[i]:
            m0, m1, m2 = m[i, 0], m[i, 1], m[i, 2]
            xx += m0 * m0
            xy += m0 * m1
            xz += m0 * m2
            yy += m1 * m1
            yz += m1 * m2
            zz += m2 * m2
            gx -= tau[i] * m0
            gy -= tau[i] * m1
            gz -= tau[i] * m2
    ridge = RIDGE * (xx + yy + zz)
    xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
    # The symmetric 3×3 system by its cofactors.
    ax, ay, az = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * ax + xy * ay + xz * az
    if determinant <= 0:
        return False
    bx, cx, by = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    n[0] = (ax * gx + ay * gy + az * gz) / determinant
    n[1] = (ay * gx + bx * gy + cx * gz) / determinant
    n[2] = (az * gx + cx * gy + by * gz) / determinant
    return True


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def alike(one: np.ndarray, other: np.ndarray, least_cosine: float, most_colour: float) -> bool:
    """Whether the lights ``one`` and ``other``, both (b, a) (6,), are nearly the same.

    Their directions have at least this cosine, and their colours differ by at most this share of the other's.
    """
    along, apart, square = 0.0, 0.0, 0.0
    for x in range(3):
        along += one[3 + x] * other[3 + x]
        apart += (one[x] - other[x]) ** 2
        square += other[x] * other[x]
    return along > least_cosine and apart < most_colour**2 * square  # type: ignore[no-any-return]


# More than sixty lines: the compiled sums of one normal equation, written out.
@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def refine(rho: np.ndarray, base: np.ndarray, both: np.ndarray, coarse: float, fine: float, rounds: int) -> None:
    """both (6,) = (b, a), in place: Gauss–Newton on the distances of ``rho`` (P, 3) to the ellipsoid (base − b aᵀ) n.

    Weights of S. Geman and D. E. McClure (Bull. ISI 52, 1987), whose width shrinks from ``coarse`` to ``fine``.
    """
    n, distance = np.empty((len(rho), 3)), np.empty(len(rho))
    H, g, J, K, M = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    width = coarse
    for _ in range(rounds):
        b0, b1, b2, a0, a1, a2 = both[0], both[1], both[2], both[3], both[4], both[5]
        matrix_without(base, both, M)
        nearest_normals(rho, M, n, distance)
        cofactors(M, K)
        determinant = M[0, 0] * K[0, 0] + M[0, 1] * K[0, 1] + M[0, 2] * K[0, 2]
        H[:], g[:] = 0.0, 0.0
        for p in range(len(rho)):
            if distance[p] > FAR * width:
                continue
            n0, n1, n2 = n[p, 0], n[p, 1], n[p, 2]
            c0 = K[0, 0] * n0 + K[0, 1] * n1 + K[0, 2] * n2
            c1 = K[1, 0] * n0 + K[1, 1] * n1 + K[1, 2] * n2
            c2 = K[2, 0] * n0 + K[2, 1] * n1 + K[2, 2] * n2
            size = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
            if size < 1e-14:
                continue
            c0, c1, c2 = c0 / size, c1 / size, c2 / size
            r = c0 * rho[p, 0] + c1 * rho[p, 1] + c2 * rho[p, 2] - determinant / size
            lit, gain = a0 * n0 + a1 * n1 + a2 * n2, c0 * b0 + c1 * b1 + c2 * b2
            J[0], J[1], J[2] = c0 * lit, c1 * lit, c2 * lit
            J[3], J[4], J[5] = n0 * gain, n1 * gain, n2 * gain
            add_equation(H, g, J, r, 1 / (1 + (r / width) ** 2) ** 2)
        trace = H[0, 0] + H[1, 1] + H[2, 2] + H[3, 3] + H[4, 4] + H[5, 5]
        if not trace > 0:
            return
        for x in range(6):
            H[x, x] += RIDGE * trace
            for y in range(x):
                H[y, x] = H[x, y]
        move = np.linalg.solve(H, g)
        for x in range(6):
            both[x] -= move[x]
        size = np.sqrt(both[3] ** 2 + both[4] ** 2 + both[5] ** 2)
        step, largest = 0.0, 0.0
        for x in range(3):
            both[3 + x] /= size
            both[x] *= size
            step = max(step, abs(move[x]), abs(move[3 + x]))
            largest = max(largest, abs(both[x]), abs(both[3 + x]))
        if width == fine and step < CONVERGED * largest:
            return
        width = max(fine, NARROWING * width)
