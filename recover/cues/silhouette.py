"""How the object is rotated, from its silhouette and from all of its pixels: without integrability, and without lights.

N = Ĝρ of an ellipsoid are normals up to one rotation where a pixel sees every light; elsewhere they are drawn toward
these. Two facts hold for all pixels nevertheless.

*The rim: opposite places of the silhouette.* Where a smooth surface turns away from the camera, at its occluding
contour, its normal is the silhouette's, n = (u, 0). A light shines on one of two opposite places of the rim, and
max(0, x) − max(0, −x) = x, so N(u) − N(−u) = Rᵀ(u, 0) whichever lights each of the two misses. So the part of N that
goes once around with the silhouette's direction is half of the first two rows of R, which is all of the rotation. A
little within the silhouette n3 is not 0 but grows with the root of the distance from it: the means over two rings of
pixels are extrapolated to distance zero. Where the silhouette is no occluding contour (a cut surface) the two rows have
lengths other than 1 or are not orthogonal; this *misfit* lowers the precision. It is also large for the wrong
ellipsoid, and for lights so near the camera that both places see them within the inner ring.

*Means.* Over a whole object the slopes cancel, normals in the middle face the camera, and near the silhouette normals
lean outward. Missing lights draw the mean of N away, which shows in the difference between the mean of N and that of
unit N, because the N that are drawn away are shorter. The weights of these means and their standard errors come from
random scenes: ``silhouette_weights.json``, with the script that fitted them.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top. "Tilt" is a rotation across the view, "twist"
one about it. Source: this project (research log, "What the outline tells").
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from huesphere.recover.cues.parameters import CUES
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.parameters import learned

# How far a rotation of the other chirality is taken to be from the silhouette's (squared standard errors).
OTHER_CHIRALITY_LOSS = 1e4

LEAST_EVENNESS = 0.1  # Less even evidence lies along one line and does not tell the chirality (ratio of two lengths).

# Sectors that must hold pixels in each ring for the silhouette to count as closed (share of the sectors).
LEAST_SECTOR_SHARE = 2 / 3

# Share of the object's border that must not be the edge of the picture (share of the border).
LEAST_SILHOUETTE_SHARE = 0.5

LEVELLING_ROUNDS = 4  # of a fixed-point iteration: as many as the weights were fitted with
LEAST_LENGTH = 1e-3  # guard for the length of a vector that may be zero


@dataclass(frozen=True)
class SilhouetteRotation:
    """R, n = R N, from the silhouette: a rotation, or one with a reflection; the convex of the two solutions."""

    rotation: np.ndarray  # (3, 3)
    precision: np.ndarray  # (3, 3) inverse covariance, radians⁻², of a small rotation of the camera frame
    rim: "Rim | None" = None  # the part from opposite places; None where these are of no use

    def pull(self, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(small rotation (3,) from ``rotation`` to this one or its twin, radians; its weight matrix (3, 3)).

        The weight matrix is the precision, less and less of it beyond ``robust_width`` standard errors (Cauchy's loss);
        zero where the two have opposite chirality.
        """
        difference = self.difference(rotation)
        if difference is None:
            return np.zeros(3), np.zeros((3, 3))
        squared = difference @ self.precision @ difference
        return difference, self.precision / (1 + squared / CUES.robust_width**2)

    def loss(self, rotation: np.ndarray) -> float:
        """Cauchy's robust loss of ``rotation`` (3, 3), in squared standard errors where these are few."""
        difference = self.difference(rotation)
        squared = OTHER_CHIRALITY_LOSS
        if difference is not None:
            squared = float(difference @ self.precision @ difference)
        return CUES.robust_width**2 * float(np.log1p(squared / CUES.robust_width**2))

    def difference(self, rotation: np.ndarray) -> np.ndarray | None:
        """The small rotation (3,) from ``rotation`` to this one or its twin, radians; None: opposite chirality."""
        turns = [twin @ self.rotation @ rotation.T for twin in (np.eye(3), TWIN)]
        if np.linalg.det(turns[0]) < 0:
            return None
        return Rotation.from_matrix(max(turns, key=np.trace)).as_rotvec()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Rim:
    """The rotation from opposite places of the silhouette alone."""

    rotation: np.ndarray  # (3, 3)
    precision: np.ndarray  # (3, 3) inverse covariance, radians⁻², of a small rotation of the camera frame
    evenness: float  # 0 … 1: shorter over longer of its first two rows, before they are normalised
    misfit: float  # root sum square of log length of its first two rows: 0 at an occluding contour with the right C


class Silhouette:
    """The silhouette of an object, and the distance and direction of each pixel from it."""

    def __init__(self, usable: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None) -> None:
        """Of the ``usable`` (H, W) pixels of ``mask`` (H, W); ``ray`` (H, W, 2): of a picture in perspective."""
        self._frame = frame_along(None if ray is None else ray[usable].mean(axis=0))
        self._inside_px = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1][usable]
        self._middle = self._inside_px >= np.median(self._inside_px)
        lean = outward(mask, CUES.lean_blur * np.sqrt(mask.sum()))[usable]
        self._design = np.column_stack([np.ones(len(lean)), lean])
        along = outward(mask, CUES.outward_blur_px)[usable]
        count = CUES.sectors
        sector = ((np.arctan2(along[:, 1], along[:, 0]) / (2 * np.pi) + 0.5) * count).astype(int) % count
        self._rings = []
        for nearest, farthest in zip(CUES.ring_edges_px, CUES.ring_edges_px[1:]):
            ring = np.flatnonzero((self._inside_px > nearest) & (self._inside_px <= farthest))
            self._rings.append((ring, sector[ring], np.bincount(sector[ring], minlength=count)))
        fewest = LEAST_SECTOR_SHARE * count
        self.closed = all((found > 0).sum() >= fewest for *_, found in self._rings)  # it goes around the object

    def rotation(self, N: np.ndarray, share: float, noise: np.ndarray) -> SilhouetteRotation | None:
        """The rotation from N (P, 3) of the usable pixels; None where its chirality is undetermined.

        ``share`` of the pixels see every light; the N of a pixel has covariance ``noise`` (3, 3). In perspective the
        object is taken to face its own mean ray.
        """
        rotation, evenness = self._of_means(N)
        tilt, twist = _errors_deg("standard error of means, degrees at a share of 1 of all-lit pixels")
        precision = np.diag(share / np.radians([tilt, tilt, twist]) ** 2)
        rim = self.rim(N, noise)
        if rim is not None and np.linalg.det(rim.rotation) * np.linalg.det(rotation) < 0:
            if rim.evenness > evenness:
                rotation = self._of_means(N, other_chirality=True)[0]
            else:
                rim = None
        if max(evenness, 0.0 if rim is None else rim.evenness) < LEAST_EVENNESS:
            return None
        if rim is not None:
            rotation, precision = _combined(rotation, precision, rim)
        return SilhouetteRotation(self._frame @ rotation, self._frame @ precision @ self._frame.T, rim)

    def rim(self, N: np.ndarray, noise: np.ndarray) -> Rim | None:
        """The rotation from N (P, 3) at opposite places, of covariance ``noise`` (3, 3); None if not ``closed``."""
        if not self.closed:
            return None
        rows, root, error = [], [], []
        for ring, sector, count in self._rings:
            some = count > 0
            sums = np.stack([np.bincount(sector, channel, len(count)) for channel in N[ring].T], axis=-1)[some]
            angle = (np.flatnonzero(some) + 0.5) * (2 * np.pi / len(count)) - np.pi
            around = [np.cos(angle), np.sin(angle), angle**0, np.cos(2 * angle), np.sin(2 * angle)]
            rows.append(np.linalg.lstsq(np.stack(around, axis=-1), sums / count[some][:, None], rcond=None)[0][:2])
            root.append(np.sqrt((self._inside_px[ring] - 0.5).mean()))
            error.append(2 * np.trace(noise) / 3 / len(ring))
        beyond = root[0] / (root[1] - root[0])  # extrapolation to distance 0, linear in its root
        U, length, Vt = np.linalg.svd(2 * (rows[0] + beyond * (rows[0] - rows[1])), full_matrices=False)
        misfit = float(np.hypot(*np.log(np.maximum(length, LEAST_LENGTH))))
        by_noise = 4 * ((1 + beyond) ** 2 * error[0] + beyond**2 * error[1])
        least, of_misfit = (
            _errors_deg(f"standard error of rim, degrees{which}") for which in ("", " for a misfit of 1")
        )
        tilt, twist = np.radians(least) ** 2 + misfit**2 * np.radians(of_misfit) ** 2 + by_noise
        first_rows = U @ Vt
        facing = _unit(np.cross(*first_rows))
        facing *= np.sign(facing @ N.mean(axis=0))
        precision = np.diag([1 / tilt, 1 / tilt, 1 / twist])
        return Rim(np.vstack([first_rows, facing]), precision, float(length[1] / max(length[0], LEAST_LENGTH)), misfit)

    def means(self, N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(direction (3,) about which the slopes of N (P, 3) cancel, the three means across it (3, 3)).

        The means are those that ``learned`` weighs, in its order.
        """
        unit, length = _units(N)
        level = _unit(unit.mean(axis=0))
        for _ in range(LEVELLING_ROUNDS):
            level = _unit(level + _unit((unit / np.maximum(unit @ level, CUES.steepest)[:, None]).mean(axis=0)))
        found = [unit.mean(axis=0), length @ unit / length.sum(), unit[self._middle].mean(axis=0)]
        return level, _across(np.stack(found), level)

    def _of_means(self, N: np.ndarray, *, other_chirality: bool = False) -> tuple[np.ndarray, float]:
        """(rotation (3, 3), evenness 0 … 1 of the two dimensions in which N leans outward, which tell chirality)."""
        level, means = self.means(N)
        facing = _unit(level + np.array(list(silhouette_weights()["weights"].values())) @ means)
        lean = np.linalg.lstsq(self._design, _units(N)[0], rcond=None)[0][1:]
        U, length, Vt = np.linalg.svd(_across(lean, facing), full_matrices=False)
        chirality = np.diag([1.0, -1.0 if other_chirality else 1.0])
        return np.vstack([U @ chirality @ Vt, facing]), float(length[1] / max(length[0], LEAST_LENGTH))


def has_silhouette(mask: np.ndarray) -> bool:
    """Whether at least LEAST_SILHOUETTE_SHARE of the border of the object ``mask`` (H, W) is not the picture's edge."""
    border = mask & ~ndimage.binary_erosion(mask)
    return bool(border.any() and border[1:-1, 1:-1].sum() >= LEAST_SILHOUETTE_SHARE * border.sum())


def silhouette_of(usable: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None) -> Silhouette | None:
    """The silhouette of the object ``mask`` (H, W), arguments as for ``Silhouette``.

    None where most of the object's border is the edge of the picture.
    """
    if not usable.any() or not has_silhouette(mask):
        return None
    return Silhouette(usable, mask, ray)


def silhouette_weights() -> dict[str, Any]:
    """Weights of the means and standard errors."""
    return learned("cues/silhouette_weights.json")


def _errors_deg(name: str) -> np.ndarray:
    """Standard errors (2,) of tilt and twist, degrees, of that name in ``learned``."""
    return np.array([silhouette_weights()[name][part] for part in ("tilt", "twist")])


def _combined(rotation: np.ndarray, precision: np.ndarray, rim: Rim) -> tuple[np.ndarray, np.ndarray]:
    """(rotation, precision) of means and rim together, less precise where the two disagree."""
    difference = Rotation.from_matrix(rim.rotation @ rotation.T).as_rotvec()
    of_difference = np.linalg.inv(np.linalg.inv(precision) + np.linalg.inv(rim.precision))
    disagreement = max(1.0, float(difference @ of_difference @ difference) / CUES.disagreement)
    turn = np.linalg.solve(precision + rim.precision, rim.precision @ difference)
    return Rotation.from_rotvec(turn).as_matrix() @ rotation, (precision + rim.precision) / disagreement


def outward(mask: np.ndarray, blur: float) -> np.ndarray:
    """Negative gradient of the ``mask`` blurred by so many pixels, right and up (H, W, 2): it points outward."""
    down, right = np.gradient(ndimage.gaussian_filter(mask.astype(float), blur, mode="nearest"))
    return np.stack([-right, down], axis=-1)


def frame_along(ray: np.ndarray | None) -> np.ndarray:
    """Columns right, up and toward the camera (3, 3) as seen along ``ray`` (2,)."""
    if ray is None:
        return np.eye(3)
    toward = _unit(np.array([-ray[0], -ray[1], 1.0]))
    return Rotation.align_vectors([toward], [[0.0, 0.0, 1.0]])[0].as_matrix()  # type: ignore[no-any-return]


def _units(N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(unit N (P, 3), their lengths (P,), limited to ``longest``)."""
    length = np.linalg.norm(N, axis=1)
    return N / np.maximum(length, 1e-9)[:, None], np.minimum(length, CUES.longest)


def _across(v: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The vectors v (K, 3) less their part along the unit ``axis`` (3,)."""
    return v - (v @ axis)[:, None] * axis


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)  # type: ignore[no-any-return]
