"""How firmly integrability holds a rotation: how far parts of the object disagree, and how good the best rival is.

The condition is that of ``recover.cues.linear_integrability``, r1·(N × N_x) + r2·(N × N_y) = 0. The normals N are
already turned by the rotation in question, so that r1 and r2 are the first two axes e1, e2 for it. A further small
rotation w adds w·(e1 × A + e2 × B) to the error, where A and B are the two vectors of a pixel's terms.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.geometry.tangent_uncertainty import DEG
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.trust.without_result import FEWEST, LARGEST_DEG

PARTS = 3  # for the jackknife: thirds of the pixels by row, times thirds by column
STEPS = 6  # of Gauss–Newton, for the own rotation and for rivals
LONGEST_STEP = 0.3  # radians
APART_DEG = 20.0  # a rotation is a rival from here on; nearer ones are part of the own rotation's uncertainty
STARTS = 200  # directions over the sphere of a rival's third row
TURNS = 12  # rotations about each of these directions
LEAST_FACING = 0.3  # least third component of a rival's third row r3, for r3·N > 0 of normals N that face the camera
SCANNED = 800  # pixels of the scan over rivals
KEPT = 8  # rivals that are refined
# Curl below which two rotations are equally good, as a share of the size of the curl's terms: rounding and the means
# over the areas of pixels leave less. So do both a quadric surface and its mirror image, which is a surface too.
LEAST_CURL = 1e-3


@dataclass(frozen=True)
class Turns:
    """What integrability says about a rotation."""

    spread_deg: float  # standard error by the jackknife over parts of the object
    moved_deg: float  # distance of the rotation of least curl nearby
    rival: float  # curl of the best distinct rotation over that of the best one nearby; 1: as good


def turns(AB: np.ndarray, row: np.ndarray, column: np.ndarray) -> Turns:
    """From the terms ``AB`` (P, 6 or 9) of ``integrability_terms``, already turned into the camera frame.

    ``row``, ``column`` (P,): places of the pixels.
    """
    if len(AB) < FEWEST:
        return Turns(LARGEST_DEG, LARGEST_DEG, 1.0)
    own = _descend(AB, np.eye(3))
    moved = np.linalg.norm(Rotation.from_matrix(own).as_rotvec()) * DEG
    part = parts_of(row, column)
    left_out = []
    for number in np.unique(part):
        rest = AB[part != number]
        if len(rest) >= FEWEST:
            left_out.append(Rotation.from_matrix(_descend(rest, own) @ own.T).as_rotvec())
    spread = float(np.linalg.norm(jackknife_stderr(np.array(left_out)))) * DEG if len(left_out) > 1 else LARGEST_DEG
    return Turns(min(spread, LARGEST_DEG), min(float(moved), LARGEST_DEG), _rival(AB, own))


def jackknife_stderr(left_out: np.ndarray) -> np.ndarray:
    """Standard errors (D,) of D numbers that were found K times, each time without one of K parts, ``left_out`` (K, D).

    √((K − 1) / K Σ (x_k − x̄)²): B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans" (1982), chapter 3.
    """
    count = len(left_out)
    return np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))  # type: ignore[no-any-return]


def parts_of(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Number (P,) of the part of the object, of PARTS² by row and by column, in which each of P pixels lies."""
    return _part(row) * PARTS + _part(column)


def _part(position: np.ndarray) -> np.ndarray:
    """Number (P,) of the third, of equal count, in which a position lies."""
    edges = np.quantile(position, np.linspace(0, 1, PARTS + 1)[1:-1])
    return np.searchsorted(edges, position, side="right")


def _rows(AB: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The first two rows of a ``rotation`` (3, 3), or all three in perspective, as the terms take them."""
    return rotation.ravel()[: AB.shape[1]]


def _curl(AB: np.ndarray, rotation: np.ndarray) -> float:
    """Robust scale of the errors over the root of the median sum of squares of their terms."""
    A, B, (r1, r2, _) = AB[:, :3], AB[:, 3:6], rotation
    size = (A @ r1) ** 2 + (B @ r2) ** 2 + (A @ r2) ** 2 + (B @ r1) ** 2
    return float(mad_scale(AB @ _rows(AB, rotation)) / max(np.sqrt(np.median(size)), 1e-300))


def _descend(AB: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The orthogonal matrix of least robust curl near ``start`` (3, 3), by Gauss–Newton with Cauchy's weights."""
    rotation = start
    for _ in range(STEPS):
        error = AB @ _rows(AB, rotation)
        scale = max(mad_scale(error), 1e-300)
        weight = 1 / (1 + (error / (2 * scale)) ** 2)
        J = np.zeros((len(AB), 3))
        for k, axis in enumerate(rotation[: AB.shape[1] // 3]):
            # Turning row r_k by w adds (w × r_k) · AB_k = w · (r_k × AB_k) to the error.
            J += np.cross(axis, AB[:, 3 * k : 3 * k + 3])
        gram = (J * weight[:, None]).T @ J
        step = -np.linalg.lstsq(gram + 1e-9 * np.trace(gram) * np.eye(3), J.T @ (weight * error), rcond=None)[0]
        size = float(np.linalg.norm(step))
        turn = Rotation.from_rotvec(step * min(1.0, LONGEST_STEP / max(size, 1e-12))).as_matrix()
        rotation = rotation @ turn.T  # each row is turned
    return np.asarray(rotation)


def _rival(AB: np.ndarray, own: np.ndarray) -> float:
    """Curl of the best rotation or reflection that is not near ``own`` or its twin, over the curl of ``own``."""
    some = AB[:: max(1, len(AB) // SCANNED)]
    candidates = _candidates()
    apart = candidates[_distances_deg(candidates, own) > APART_DEG]
    error = np.median(np.abs(some @ apart.reshape(len(apart), 9)[:, : AB.shape[1]].T), axis=0)
    ends = np.stack([_descend(some, apart[k]) for k in np.argsort(error)[:KEPT]])
    distinct = ends[(_distances_deg(ends, own) > APART_DEG) & (ends[:, 2, 2] > 0)]
    if not len(distinct):
        return float("inf")
    return max(min(_curl(AB, end) for end in distinct), LEAST_CURL) / max(_curl(AB, own), LEAST_CURL)


@cache
def _candidates() -> np.ndarray:
    """(C, 3, 3) rotations and reflections whose third row is not far from the camera's direction, about evenly."""
    found = []
    for r3 in fibonacci(STARTS):
        if r3[2] < LEAST_FACING:
            continue
        u = np.linalg.svd(r3[None])[2][1]
        v = np.cross(r3, u)
        for t in np.arange(TURNS) * (2 * np.pi / TURNS):
            a, b = np.cos(t) * u + np.sin(t) * v, -np.sin(t) * u + np.cos(t) * v
            found += [np.stack([a, b, r3]), np.stack([a, -b, r3])]
    return np.stack(found)


def _distances_deg(several: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Angles (C,) of orthogonal matrices (C, 3, 3) from ``one`` or its twin, whichever is nearer, degrees.

    180 where the determinants differ in sign.
    """
    relative = several @ one.T
    diagonal = np.einsum("cii->ci", relative)
    trace = np.maximum(diagonal.sum(axis=1), diagonal @ np.diag(TWIN))
    angle = np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    return np.where(np.linalg.det(relative) < 0, 180.0, angle)
