"""Two lights on one material make colours that lie in a plane through black: the plane identifies the material.

P. P. Nikolaev 1975 and 1988, the report's [6, 7]; M. H. Brill, SPIE 1076 (1989), its [8]. As segmentation: pixels whose
patches span the same plane are one material under the same two lights.
"""

import numpy as np

from huesphere.recover.pixels.rank import local_moments, rank_map

LEAST_SEGMENT_SHARE = 0.02  # Smaller segments are left without a label (share of the pixels with a plane).

PLANE_TOLERANCE_DEG = 3.0  # Planes of colours with a smaller angle are one (degrees).

CANDIDATES = 200  # planes among which the most frequent one is looked for, each time: bounds the work


def segment_by_planes(
    rgb: np.ndarray, usable: np.ndarray, *, noise: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(labels (H, W) int, unit normals of the planes (K, 3) in colour space), segments found first come first.

    ``rgb`` (H, W, 3): picture units; ``usable`` (H, W). ``noise``: standard deviation of a channel, None: estimated.
    A patch is a square of ``rank_window_px`` pixels a side. The label is −1 where the colours of the patch about a
    pixel are not of rank 2, or belong to no segment. The normal of a patch's plane is the direction along which its
    colours have the least second moment about black. The plane that most others agree with, up to sign and to the
    tolerance, makes the first segment, and so on with the rest.
    """
    least_cosine = np.cos(np.radians(PLANE_TOLERANCE_DEG))
    moments, _ = local_moments(rgb, usable)
    labels = np.full(usable.shape, -1)
    flat = rank_map(rgb, usable, noise=noise) == 2
    normals = np.linalg.eigh(moments[flat])[1][..., 0]
    left = np.ones(len(normals), bool)
    own = np.full(len(normals), -1)
    planes: list[np.ndarray] = []
    while left.sum() > max(LEAST_SEGMENT_SHARE * len(normals), 1):
        pool = normals[left]
        some = pool[np.linspace(0, len(pool) - 1, min(CANDIDATES, len(pool))).round().astype(int)]
        near = np.abs(pool @ some.T) > least_cosine
        best = int(np.argmax(near.sum(axis=0)))
        group = pool[near[:, best]]
        if len(group) < LEAST_SEGMENT_SHARE * len(normals):
            break
        plane = np.linalg.eigh(group.T @ group)[1][:, 2]
        own[left & (np.abs(normals @ plane) > least_cosine)] = len(planes)
        own[np.flatnonzero(left)[near[:, best]]] = len(planes)
        left = own < 0
        planes.append(plane)
    labels[flat] = own
    return labels, np.array(planes).reshape(-1, 3)
