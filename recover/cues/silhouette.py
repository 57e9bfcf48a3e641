"""How the object is turned, as its outline and all of its pixels say: without integrability, and without any light.

The N = Ĝρ of a shell are normals turned as a whole where a pixel sees every light; elsewhere they are drawn toward
these. Two things are true of them all the same.

*Opposite rims.* Where a smooth surface turns away from the camera its normal is the outline's, n = (u, 0). A lamp
shines on one of two opposite places of the rim, and max(0, x) − max(0, −x) = x: N(u) − N(−u) = Rᵀ(u, 0), whichever
lights each of them misses. So the part of N that goes once around with the outline's direction is half of the first
two rows of R: all of the rotation. n3 is not 0 within the outline, but goes with the root of the distance from it: two
rings of pixels are extrapolated to none. An outline that is no rim betrays itself, for these two rows come out of other
lengths than 1, or not at right angles; so does the wrong ellipsoid, and so do lights so near the camera that both
places still see them within the inner ring.

*Means.* All over an object the slopes cancel, those in the middle face the camera, and at every outline normals lean
outward. What missing lights draw the mean of N toward shows in how it differs from that of the unit N, for the N that
are drawn are shorter. Weights and errors are those of random scenes (`benchmarks/recover_outline.py`).

Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from huesphere.recover.geometry.rotations import TWIN

REACH = 0.05  # of the square root of the object's area: deviation of the blur of the mask
LEAST_OUTLINE = 0.5  # share of the object's border that is not the picture's
STEEPEST, ROUNDS = 0.15, 4  # least n3 that a slope is taken at; rounds to where slopes cancel
LEAST_LENGTH = 1e-3  # of a lean, where there is none
LONGEST = 1.15  # N, which only noise makes longer than 1
WEIGHTS = {"mean of unit N": 1.85, "mean of N": -4.2, "mean of unit N in the middle": 0.52}
TILT_DEG, TWIST_DEG = 1.8, 1.6  # standard errors across and about the view, times the root of the all-lit share
RINGS = ((0.0, 2.5), (2.5, 5.5))  # pixels from the outline
SECTORS, FEWEST_SECTORS = 36, 24  # of directions outward; and those with pixels in either ring
DIRECTION = 2.5  # pixels, deviation of the blur of the mask whose slope is the outline's direction
RIM_DEG, MISFIT_DEG = np.array([0.8, 0.5]), np.array([18.0, 10.0])  # those of tilt and twist; what a misfit of 1 adds
LEAST_EVENNESS = 0.1  # of means or rim, to tell the hand
AT_ODDS = 9.0  # squared standard errors between means and rim, beyond which neither is believed as much
FAR = 2.0  # standard errors, beyond which it counts ever less
OTHER_HAND = 1e4  # squared standard errors that a rotation of the other handedness is away


@dataclass(frozen=True)
class Outlined:
    """The rotation, or rotation and reflection, R to which the outline points, n = R N; convex of the two twins."""

    rotation: np.ndarray  # (3, 3)
    precision: np.ndarray  # (3, 3) inverse covariance, radians⁻², of a small rotation of the camera frame
    rim: "Rim | None" = None  # what of it the rim told

    def pull(self, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(the small rotation (3,) from ``rotation`` to this one or its twin, radians; how much it counts (3, 3))."""
        away = self._away(rotation)
        if away is None:
            return np.zeros(3), np.zeros((3, 3))
        return away, self.precision / (1 + away @ self.precision @ away / FAR**2)

    def loss(self, rotation: np.ndarray) -> float:
        """How badly it agrees with ``rotation`` (3, 3): squared standard errors, fewer where these are many."""
        away = self._away(rotation)
        squared = OTHER_HAND if away is None else float(away @ self.precision @ away)
        return FAR**2 * float(np.log1p(squared / FAR**2))

    def _away(self, rotation: np.ndarray) -> np.ndarray | None:
        """As ``pull`` has it; None across a reflection."""
        turns = [twin @ self.rotation @ rotation.T for twin in (np.eye(3), TWIN)]
        if np.linalg.det(turns[0]) < 0:
            return None
        return Rotation.from_matrix(max(turns, key=np.trace)).as_rotvec()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Rim:
    """What opposite places of the outline tell."""

    rotation: np.ndarray  # (3, 3)
    precision: np.ndarray  # (3, 3) inverse covariance, radians⁻², of a small rotation of the camera frame
    evenness: float  # 0 … 1: length of the shorter of its first two rows, before they are made unit, over the longer
    misfit: float  # how far its first two rows are from length 1 and right angles: 0 of a rim, seen by the right C


class Outline:
    """The outline of an object and which of its pixels lie how near to it; what its N tell is asked of it."""

    def __init__(self, usable: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None) -> None:
        """Of the ``usable`` (H, W) pixels of ``mask`` (H, W); ``ray`` (H, W, 2): of a picture in perspective."""
        self._frame = _frame(None if ray is None else ray[usable].mean(axis=0))
        self._depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1][usable]  # pixels
        self._middle = self._depth >= np.median(self._depth)
        self._design = np.column_stack([np.ones(len(self._depth)), _outward(mask, REACH * np.sqrt(mask.sum()))[usable]])
        along = _outward(mask, DIRECTION)[usable]
        sector = ((np.arctan2(along[:, 1], along[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
        self._rings = []
        for nearest, farthest in RINGS:
            ring = np.flatnonzero((self._depth > nearest) & (self._depth <= farthest))
            self._rings.append((ring, sector[ring], np.bincount(sector[ring], minlength=SECTORS)))
        self.goes_round = all((count > 0).sum() >= FEWEST_SECTORS for *_, count in self._rings)

    def rotation(self, N: np.ndarray, share: float, noise: np.ndarray) -> Outlined | None:
        """What N (P, 3) of the usable pixels tell, ``share`` of which see every light; a pixel's N has covariance
        ``noise`` (3, 3). In perspective the object faces its own mean ray. None where the hand cannot be told."""
        rotation, evenness = self._of_means(N)
        precision = np.diag(share / np.radians([TILT_DEG, TILT_DEG, TWIST_DEG]) ** 2)
        rim = self.rim(N, noise)
        if rim is not None and np.linalg.det(rim.rotation) * np.linalg.det(rotation) < 0:
            if rim.evenness > evenness:
                rotation = self._of_means(N, other_hand=True)[0]
            else:
                rim = None
        if max(evenness, 0.0 if rim is None else rim.evenness) < LEAST_EVENNESS:
            return None
        if rim is not None:
            away = Rotation.from_matrix(rim.rotation @ rotation.T).as_rotvec()
            either = np.linalg.inv(np.linalg.inv(precision) + np.linalg.inv(rim.precision))
            at_odds = max(1.0, float(away @ either @ away) / AT_ODDS)
            turn = np.linalg.solve(precision + rim.precision, rim.precision @ away)
            rotation = Rotation.from_rotvec(turn).as_matrix() @ rotation
            precision = (precision + rim.precision) / at_odds
        return Outlined(self._frame @ rotation, self._frame @ precision @ self._frame.T, rim)

    def rim(self, N: np.ndarray, noise: np.ndarray) -> Rim | None:
        """What N (P, 3) near the outline tell, of covariance ``noise`` (3, 3); None if it does not go all round."""
        if not self.goes_round:
            return None
        rows, root, error = [], [], []
        for ring, sector, count in self._rings:
            some = count > 0
            mean = np.stack([np.bincount(sector, channel, SECTORS) for channel in N[ring].T], axis=-1)[some]
            angle = (np.flatnonzero(some) + 0.5) * (2 * np.pi / SECTORS) - np.pi
            around = [np.cos(angle), np.sin(angle), angle**0, np.cos(2 * angle), np.sin(2 * angle)]
            rows.append(np.linalg.lstsq(np.stack(around, axis=-1), mean / count[some][:, None], rcond=None)[0][:2])
            root.append(np.sqrt((self._depth[ring] - 0.5).mean()))
            error.append(2 * np.trace(noise) / 3 / len(ring))
        beyond = root[0] / (root[1] - root[0])
        U, length, Vt = np.linalg.svd(2 * (rows[0] + beyond * (rows[0] - rows[1])), full_matrices=False)
        misfit = float(np.hypot(*np.log(np.maximum(length, LEAST_LENGTH))))
        chance = 4 * ((1 + beyond) ** 2 * error[0] + beyond**2 * error[1])
        tilt, twist = np.radians(RIM_DEG) ** 2 + misfit**2 * np.radians(MISFIT_DEG) ** 2 + chance
        first = U @ Vt
        facing = _unit(np.cross(*first))
        facing *= np.sign(facing @ N.mean(axis=0))
        precision = np.diag([1 / tilt, 1 / tilt, 1 / twist])
        return Rim(np.vstack([first, facing]), precision, float(length[1] / max(length[0], LEAST_LENGTH)), misfit)

    def means(self, N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(where the slopes of N (P, 3) cancel (3,), how far off it the means are that WEIGHTS names (3, 3))."""
        unit, length = _units(N)
        level = _unit(unit.mean(axis=0))
        for _ in range(ROUNDS):
            level = _unit(level + _unit((unit / np.maximum(unit @ level, STEEPEST)[:, None]).mean(axis=0)))
        found = [unit.mean(axis=0), length @ unit / length.sum(), unit[self._middle].mean(axis=0)]
        return level, _across(np.stack(found), level)

    def _of_means(self, N: np.ndarray, *, other_hand: bool = False) -> tuple[np.ndarray, float]:
        """(rotation (3, 3), 0 … 1: how much the lean outward is of two dimensions, by which its hand is known)."""
        level, off = self.means(N)
        facing = _unit(level + np.array(list(WEIGHTS.values())) @ off)
        lean = np.linalg.lstsq(self._design, _units(N)[0], rcond=None)[0][1:]
        U, length, Vt = np.linalg.svd(_across(lean, facing), full_matrices=False)
        hand = np.diag([1.0, -1.0 if other_hand else 1.0])
        return np.vstack([U @ hand @ Vt, facing]), float(length[1] / max(length[0], LEAST_LENGTH))


def outline_of(usable: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None) -> Outline | None:
    """That of the object ``mask`` (H, W), as for ``Outline``; None where what ends it is mostly the picture's edge."""
    border = mask & ~ndimage.binary_erosion(mask)
    if not usable.any() or border[1:-1, 1:-1].sum() < LEAST_OUTLINE * border.sum():
        return None
    return Outline(usable, mask, ray)


def _outward(mask: np.ndarray, blur: float) -> np.ndarray:
    """Down the slope of the ``mask`` blurred by so many pixels, right and up (H, W, 2)."""
    down, right = np.gradient(ndimage.gaussian_filter(mask.astype(float), blur, mode="nearest"))
    return np.stack([-right, down], axis=-1)


def _frame(ray: np.ndarray | None) -> np.ndarray:
    """Columns right, up and toward the camera (3, 3) as seen along ``ray`` (2,)."""
    if ray is None:
        return np.eye(3)
    toward = _unit(np.array([-ray[0], -ray[1], 1.0]))
    return Rotation.align_vectors([toward], [[0.0, 0.0, 1.0]])[0].as_matrix()  # type: ignore[no-any-return]


def _units(N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(unit N (P, 3), their lengths (P,) as far as these are no noise)."""
    length = np.linalg.norm(N, axis=1)
    return N / np.maximum(length, 1e-9)[:, None], np.minimum(length, LONGEST)


def _across(v: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The vectors v (K, 3) less their part along the unit ``axis`` (3,)."""
    return v - (v @ axis)[:, None] * axis


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)  # type: ignore[no-any-return]
