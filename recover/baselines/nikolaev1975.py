"""Two lights on one material make colours that lie in a plane through black: a material is told by its plane.

P. P. Nikolaev 1975 and 1988, the report's [6, 7]; M. H. Brill, SPIE 1076 (1989), its [8]. As segmentation: pixels whose
patches span the same plane are one material under the same two lights.
"""

import numpy as np

from huesphere.recover.pixels.rank import local_moments, rank_map

CANDIDATES = 200
TOLERANCE_DEG = 3.0
LEAST_SHARE = 0.02  # of the pixels with a plane: smaller segments are left unlabelled


def segment_by_planes(
    rgb: np.ndarray, usable: np.ndarray, *, noise: float | None = None, tolerance_deg: float = TOLERANCE_DEG
) -> tuple[np.ndarray, np.ndarray]:
    """(labels (H, W) int, unit normals of the planes (K, 3)) of the patches of rank 2, the largest segment first.

    −1 where the patch is not of rank 2, or of no segment. A plane is the patch's direction of least colour; the one
    that most others agree with, up to sign and to ``tolerance_deg``, is taken, and so on with the rest.
    """
    moments, _ = local_moments(rgb, usable)
    labels = np.full(usable.shape, -1)
    flat = rank_map(rgb, usable, noise=noise) == 2
    normals = np.linalg.eigh(moments[flat])[1][..., 0]
    left = np.ones(len(normals), bool)
    own = np.full(len(normals), -1)
    planes: list[np.ndarray] = []
    while left.sum() > max(LEAST_SHARE * len(normals), 1):
        pool = normals[left]
        some = pool[np.linspace(0, len(pool) - 1, min(CANDIDATES, len(pool))).round().astype(int)]
        near = np.abs(pool @ some.T) > np.cos(np.radians(tolerance_deg))
        best = int(np.argmax(near.sum(axis=0)))
        group = pool[near[:, best]]
        if len(group) < LEAST_SHARE * len(normals):
            break
        plane = np.linalg.eigh(group.T @ group)[1][:, 2]
        own[left & (np.abs(normals @ plane) > np.cos(np.radians(tolerance_deg)))] = len(planes)
        own[np.flatnonzero(left)[near[:, best]]] = len(planes)
        left = own < 0
        planes.append(plane)
    labels[flat] = own
    return labels, np.array(planes).reshape(-1, 3)
