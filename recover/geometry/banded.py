"""Linear equations with a symmetric positive definite band matrix, eliminated from both ends at the same time.

In a matrix with nonzero entries only within ``band`` of the diagonal, any ``band`` consecutive unknowns separate those
before them from those after them. So the unknowns are divided into a first part, the separator and a last part; the
first part is eliminated forwards and the last part backwards, in two threads, and the Schur complement of the separator
remains, a small dense matrix. The result does not depend on the number of threads.

LAPACK's dpbtrf eliminates each part together with the separator. For that the separator's own block D stands in both
matrices: the trailing block of a Cholesky factor L of (A B; Bᵀ D) satisfies L Lᵀ = D − Bᵀ A⁻¹ B, from which what the
elimination subtracted from D follows.
"""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numba.extending import get_cython_function_address
from scipy.linalg import cho_solve

from huesphere.recover.geometry.threads import in_threads

# Unknowns × band²: with less work than this, starting threads costs more time than it saves.
LEAST_WORK_FOR_THREADS = 1e7
# Share of the mean diagonal that is added to the diagonal. It fixes what the equations do not determine at all, such as
# the mean depth of each connected component of a surface of which only slopes are known.
FLOATING = 1e-9

# SciPy's own wrapper of dpbtrf holds Python's global lock, and the two threads would run one after the other.
_int_p, _double_p = ctypes.POINTER(ctypes.c_int), ctypes.POINTER(ctypes.c_double)
_dpbtrf = ctypes.CFUNCTYPE(None, ctypes.c_char_p, _int_p, _int_p, _double_p, _int_p, _int_p)(
    get_cython_function_address("scipy.linalg.cython_lapack", "dpbtrf")
)


@dataclass(frozen=True)
class Part:
    """A sum of N small quadratic forms of like pattern, E entries each, which is added to a band matrix.

    Form i adds (``weights`` @ ``products``)[i, e] at row ``rows``[i, e] and column ``columns``[i, e], row ≥ column.
    """

    weights: np.ndarray  # (N, K)
    products: np.ndarray  # (K, E)
    rows: np.ndarray  # (N, E) int32
    columns: np.ndarray  # (N, E) int32


@dataclass(frozen=True)
class BandedFactor:
    """A factorised matrix of U unknowns, S of which are the separator."""

    forwards: np.ndarray  # (first + S, 1 + band): column j of the Cholesky factor, from its diagonal on
    backwards: np.ndarray  # (last + S, 1 + band): likewise, with the unknowns numbered from the end
    separator: np.ndarray  # (S, S) lower Cholesky factor of the Schur complement

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The solutions (K, U) for K right sides (K, U)."""
        S, ends = len(self.separator), (self.forwards, self.backwards)
        first, last = (len(L) - S for L in ends)
        z = [np.array(right[:, : first + S], order="C"), np.array(right[:, ::-1][:, : last + S], order="C")]
        z[0][:, first:], z[1][:, last:] = 0.0, 0.0
        work = [(L, part, len(L) - S) for L, part in zip(ends, z)]
        run = _runner(right.shape[1], self.forwards.shape[1])
        run(lambda one: _forward(*one), work)
        middle = right[:, first : first + S] + z[0][:, first:] + z[1][:, last:][:, ::-1]
        middle = cho_solve((self.separator, True), middle.T, check_finite=False).T
        z[0][:, first:], z[1][:, last:] = middle, middle[:, ::-1]
        run(lambda one: _backward(*one), work)
        return np.concatenate([z[0], z[1][:, :last][:, ::-1]], axis=1)


def factor_banded(parts: Sequence[Part], unknowns: int, *, damping: float) -> BandedFactor:
    """The Cholesky factor of the sum of the ``parts``, its diagonal multiplied by 1 + ``damping``.

    ``FLOATING`` times the mean of the diagonal is added to the diagonal. Raises LinAlgError if the matrix is not
    positive definite.
    """
    band = max(int((part.rows - part.columns).max(initial=0)) for part in parts)
    S = min(max(band, 1), unknowns)
    first = (unknowns - S) // 2
    diagonal = sum(float((part.weights @ part.products)[part.rows == part.columns].sum()) for part in parts)
    added = FLOATING * diagonal / unknowns

    def eliminated(reverse: bool) -> tuple[np.ndarray, np.ndarray]:
        count = unknowns - first if reverse else first + S
        matrix = np.zeros((count, band + 1))
        for part in parts:
            _add(matrix, part.weights, part.products, part.rows, part.columns, unknowns if reverse else 0)
        matrix[:, 0] += damping * matrix[:, 0] + added
        own = _lower_block(matrix, S)
        _factorise(matrix)
        return matrix, own

    (forwards, D), (backwards, _) = _runner(unknowns, band + 1)(eliminated, (False, True))
    one, other = (_lower_block(L, S) for L in (forwards, backwards))
    D = D + np.tril(D, -1).T
    schur = one @ one.T + (other @ other.T)[::-1, ::-1] - D
    return BandedFactor(forwards, backwards, np.linalg.cholesky(schur))


def _runner(unknowns: int, height: int) -> Callable[..., list]:
    """``in_threads`` where there is work enough for them, or else a loop of the same form."""
    if unknowns * height**2 >= LEAST_WORK_FOR_THREADS:
        return in_threads
    return lambda function, items: [function(item) for item in items]


def _lower_block(matrix: np.ndarray, size: int) -> np.ndarray:
    """The last ``size`` rows and columns (S, S), lower triangle, of a ``matrix`` in band storage (U, 1 + band)."""
    block, columns = np.zeros((size, size)), matrix[len(matrix) - size :]
    for j in range(size):
        entries = columns[j, : size - j]
        block[j : j + len(entries), j] = entries
    return block


def _factorise(matrix: np.ndarray) -> None:
    """Replace a ``matrix`` in band storage (U, 1 + band) by its Cholesky factor. Raises LinAlgError."""
    count, height = matrix.shape
    info = ctypes.c_int(0)
    sizes = [ctypes.byref(ctypes.c_int(size)) for size in (count, height - 1, height)]
    _dpbtrf(b"L", sizes[0], sizes[1], matrix.ctypes.data_as(_double_p), sizes[2], ctypes.byref(info))
    if info.value:
        raise np.linalg.LinAlgError(f"the band matrix is not positive definite at column {info.value}")


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _add(
    matrix: np.ndarray,
    weights: np.ndarray,
    products: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    reverse: int,
) -> None:
    """Add a ``Part`` to a ``matrix`` in band storage (M, 1 + band), of the first M unknowns only.

    ``reverse``: 0, or the number U of unknowns if they are numbered from the end; M is then counted from there.
    """
    count = len(matrix)
    for i in range(len(rows)):
        for e in range(rows.shape[1]):
            row, column = rows[i, e], columns[i, e]
            if reverse:
                row, column = reverse - 1 - column, reverse - 1 - row
            if row >= count:
                continue
            entry = 0.0
            for k in range(weights.shape[1]):
                entry += weights[i, k] * products[k, e]
            matrix[column, row - column] += entry


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "reassoc"})  # type: ignore[untyped-decorator]
def _forward(L: np.ndarray, z: np.ndarray, count: int) -> None:
    """Eliminate the first ``count`` unknowns from z (K, M), in place; L[j] is column j of the factor.

    All K right sides at once: the factor is larger than the caches, and is read twice, where LAPACK's dpbtrs reads it
    twice for each right side.
    """
    total, height = L.shape
    for j in range(count):
        column = L[j, 1 : total - j]
        for k in range(len(z)):
            z[k, j] /= L[j, 0]
            own, rest = z[k, j], z[k, j + 1 : j + height]
            for i in range(len(rest)):
                rest[i] -= column[i] * own


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "reassoc"})  # type: ignore[untyped-decorator]
def _backward(L: np.ndarray, z: np.ndarray, count: int) -> None:
    """Solve for the first ``count`` unknowns of z (K, M), in place, after ``_forward`` and with the others known."""
    total, height = L.shape
    for j in range(count - 1, -1, -1):
        column = L[j, 1 : total - j]
        for k in range(len(z)):
            own, rest = z[k, j], z[k, j + 1 : j + height]
            for i in range(len(rest)):
                own -= column[i] * rest[i]
            z[k, j] = own / L[j, 0]
