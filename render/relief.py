"""prototype"""

import math
from dataclasses import dataclass

import numba
import numpy as np

CHUNK = 8.0
HOLE = -1e30
PHASES = 16


@numba.njit(cache=True)
def _tables(count, turn, reach, stride, chunk):
    chunks = int(math.ceil(reach / chunk))
    length = chunks * chunk
    capacity = int(2.5 * length) + 8
    total = 0
    start = np.zeros((count, chunks + 1), np.int64)
    corner = np.empty((count * capacity, 2), np.int32)
    place = np.empty((count * capacity, 2), np.float64)
    middle = np.empty((count, chunks, 2), np.float64)
    for k in range(count):
        phi = 2 * math.pi * (k + turn) / count
        dc, dr = math.cos(phi), -math.sin(phi)
        dd = dc + dr
        nc = nr = nd = 1
        s = 0.0
        start[k, 0] = total
        for c in range(chunks):
            end = (c + 1) * chunk
            middle[k, c, 0] = math.floor((c + 0.5) * chunk * dc + 0.5)
            middle[k, c, 1] = math.floor((c + 0.5) * chunk * dr + 0.5)
            while True:
                sc, sr, sd = nc / max(abs(dc), 1e-12), nr / max(abs(dr), 1e-12), nd / max(abs(dd), 1e-12)
                s = min(sc, sr, sd)
                if s > end:
                    break
                if s == sc:
                    col = nc if dc > 0 else -nc
                    row = s * dr
                    low = math.floor(row)
                    corner[total, 0] = low * stride + col
                    corner[total, 1] = (low + 1) * stride + col
                    place[total, 0] = row - low
                    nc += 1
                elif s == sr:
                    row = nr if dr > 0 else -nr
                    col = s * dc
                    low = math.floor(col)
                    corner[total, 0] = row * stride + low
                    corner[total, 1] = row * stride + low + 1
                    place[total, 0] = col - low
                    nr += 1
                else:
                    both = nd if dd > 0 else -nd
                    col = s * dc
                    low = math.floor(col)
                    corner[total, 0] = (both - low) * stride + low
                    corner[total, 1] = (both - low - 1) * stride + low + 1
                    place[total, 0] = col - low
                    nd += 1
                place[total, 1] = s
                total += 1
            start[k, c + 1] = total
    return start, corner[:total], place[:total], middle


@numba.njit(parallel=True, cache=True)
def _bounds(z, radius):
    H, W = z.shape
    out = np.zeros((H, W, 3))
    for r in numba.prange(H):
        for c in range(W):
            r0, r1, c0, c1 = max(0, r - radius), min(H, r + radius + 1), max(0, c - radius), min(W, c + radius + 1)
            n = 0
            sz = sx = sy = sxx = syy = sxz = syz = 0.0
            for i in range(r0, r1):
                for j in range(c0, c1):
                    v = z[i, j]
                    if v > -1e20:
                        dx, dy = j - c, i - r
                        n += 1
                        sz += v
                        sx += dx
                        sy += dy
                        sxx += dx * dx
                        syy += dy * dy
                        sxz += dx * v
                        syz += dy * v
            if n == 0:
                out[r, c, 0] = -1e30
                continue
            p = (sxz - sx * sz / n) / max(sxx - sx * sx / n, 1e-9) if n > 8 else 0.0
            q = (syz - sy * sz / n) / max(syy - sy * sy / n, 1e-9) if n > 8 else 0.0
            top = -1e300
            for i in range(r0, r1):
                for j in range(c0, c1):
                    v = z[i, j]
                    if v > -1e20:
                        top = max(top, v - p * (j - c) - q * (i - r))
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = top, p, q
    return out


@numba.njit(cache=True, fastmath={"contract", "nsz"}, inline="always")
def _march(z, bound, stride, o, dc, dr, nh, nz, start, corner, place, middle, exit, chunk, top, index, weight):
    """Returns entries, last slope."""
    z0 = z[o]
    t = -nh / nz
    t += 1e-9 * (1 + t * t)
    q = 1 / (1 + t * t)
    found = 0
    last = -2
    first = start[0]
    for c in range(start.shape[0] - 1):
        s0 = c * chunk
        if s0 >= exit:
            break
        if c > 0:
            if top - z0 < t * s0 and t > 0:
                break
            mc, mr = middle[c, 0], middle[c, 1]
            m = o + int(mr) * stride + int(mc)
            g = bound[m, 1] * dc + bound[m, 2] * dr - t
            b = bound[m, 0] - bound[m, 1] * mc - bound[m, 2] * mr - z0
            if b + g * s0 < 0 and b + g * (s0 + chunk) < 0:
                continue
        for j in range(start[c], start[c + 1]):
            za = z[o + corner[j, 0]]
            zb = z[o + corner[j, 1]]
            w = place[j, 0]
            s = place[j, 1]
            h = za + w * (zb - za) - z0
            if h > t * s:
                new = h / s
                qn = 1 / (1 + new * new)
                share = 0.0
                if j == first:
                    index[found] = o
                    index[found + 1] = o
                    weight[found] = weight[found + 1] = 0.0
                    found += 2
                    valid = True
                    wl = 0.0
                elif last == j - 1:
                    valid = True
                    wl = place[last, 0]
                else:
                    wl = place[j - 1, 0]
                    ha = z[o + corner[j - 1, 0]]
                    ha = ha + wl * (z[o + corner[j - 1, 1]] - ha) - z0
                    valid = ha > -1e20
                    if valid:
                        sa = place[j - 1, 1]
                        gap = t * sa - ha
                        share = gap / (h - ha - t * (s - sa))
                        index[found] = o + corner[j - 1, 0]
                        index[found + 1] = o + corner[j - 1, 1]
                        weight[found] = weight[found + 1] = 0.0
                        found += 2
                if valid:
                    d = new - t
                    x = d / (1 + t * new)
                    if x > 0.1 or x < 0:
                        turn = math.atan(new) - math.atan(t)
                    else:
                        y = x * x
                        turn = x * (1 - y * (1 / 3 - y * (0.2 - y * (1 / 7 - y / 9))))
                    qq = q * qn
                    W = 0.5 * (nh * (turn + d * (1 - t * new) * qq) + nz * d * (t + new) * qq)
                    A = 0.5 * (1 - share) * W
                    B = W - A
                    weight[found - 2] += A * (1 - wl)
                    weight[found - 1] += A * wl
                    index[found] = o + corner[j, 0]
                    index[found + 1] = o + corner[j, 1]
                    weight[found] = B * (1 - w)
                    weight[found + 1] = B * w
                    found += 2
                    last = j
                t = new
                q = qn
    return found, t


@numba.njit(cache=True, inline="always")
def _exit(at, d, size):
    if d > 1e-9:
        return (size - 1 - at) / d
    if d < -1e-9:
        return at / -d
    return 1e30


@numba.njit(parallel=True, cache=True)
def _direct(z, bound, row, col, normal, T, pad, top, turn, phase, azimuths, start, corner, place, middle, chunk):
    H, W = z.shape
    zf = z.reshape(-1)
    bf = bound.reshape(-1, 3)
    n = row.shape[0]
    C = T.shape[1]
    out = np.zeros((n, C), np.float32)
    block = 64
    M = start.shape[0]
    stats = np.zeros((n,), np.int64)
    for b in numba.prange((n + block - 1) // block):
        index = np.empty(4 * start.shape[1] * int(3 * chunk), np.int64)
        weight = np.empty(4 * start.shape[1] * int(3 * chunk))
        acc = np.zeros(C)
        for i in range(b * block, min(n, b * block + block)):
            o = (row[i] + pad) * W + col[i] + pad
            acc[:] = 0
            for k in range(azimuths):
                a = k * (M // azimuths) + phase[i]
                phi = 2 * math.pi * (a + turn) / M
                dc, dr = math.cos(phi), -math.sin(phi)
                nh = normal[i, 0] * dc - normal[i, 1] * dr
                ex = min(_exit(row[i], dr, H - 2 * pad), _exit(col[i], dc, W - 2 * pad))
                found, t = _march(
                    zf,
                    bf,
                    W,
                    o,
                    dc,
                    dr,
                    nh,
                    normal[i, 2],
                    start[a],
                    corner,
                    place,
                    middle[a],
                    ex,
                    chunk,
                    top,
                    index,
                    weight,
                )
                stats[i] += found
                for e in range(found):
                    for ch in range(C):
                        acc[ch] += weight[e] * T[index[e], ch]
            for ch in range(C):
                out[i, ch] = acc[ch] * (2 / azimuths)
    return out, stats


def gather_direct(depth, mask, normals, T, *, step=1.0, azimuths=24, seed=0, phases=PHASES, chunk=CHUNK, verbose=False):
    import time

    pad = int(chunk) + 2
    rows, cols = np.nonzero(mask)
    z = np.where(mask, depth / step, HOLE)
    H, W = mask.shape
    z = np.pad(z, pad, constant_values=HOLE)
    t0 = time.time()
    bound = _bounds(z, int(np.ceil(chunk / 2 + 1.5)))
    t1 = time.time()
    rng = np.random.default_rng(seed)
    turn = rng.random()
    phase = rng.integers(0, phases, len(rows))
    tables = _tables(azimuths * phases, turn, math.hypot(H, W), z.shape[1], chunk)
    t2 = time.time()
    Tp = np.zeros((z.size, T.shape[1]), np.float32)
    Tp[(rows + pad) * z.shape[1] + cols + pad] = T
    N = np.ascontiguousarray(normals[rows, cols], dtype=np.float64)
    out, stats = _direct(z, bound, rows, cols, N, Tp, pad, z.max(), turn, phase, azimuths, *tables, chunk)
    if verbose:
        print(f"bounds {t1 - t0:.3f} tables {t2 - t1:.3f} march {time.time() - t2:.3f} entries/pt {stats.mean():.1f}")
    return out
