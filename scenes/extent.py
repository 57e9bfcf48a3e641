"""How large the object is in the picture, by which parts far away from the rest are noticed."""

from collections.abc import Callable

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.mesh import Mesh, area_normals
from huesphere.scenes.view import View

MOST = 0.99  # share of the surface that counts as the object, without parts far away
LEAST_PIXELS = 2.0  # size of MOST of the surface in the picture, below which the mesh is refused
SMALL = 0.125  # of the size of the whole mesh: if MOST of the surface is smaller, the log says so


def projected(view: View, points: np.ndarray) -> np.ndarray:
    """Columns and rows (n, 2), in pixels from the top left, where the camera sees ``points`` (n, 3)."""
    scale = np.full(len(points), 1.0 / view.pixel_size)
    if view.eye is not None:
        scale *= (view.eye - view.reference) / np.maximum(view.eye - points[:, 2], 1e-12)
    return np.stack([view.width / 2 + points[:, 0] * scale, view.height / 2 - points[:, 1] * scale], axis=1)


def extent_px(mesh: Mesh, view: View) -> tuple[np.ndarray, np.ndarray]:
    """(width and height (2,) of the whole mesh in the picture, and of the share MOST of its surface), in pixels."""
    area = np.linalg.norm(area_normals(mesh.vertices, mesh.faces), axis=1)
    places = projected(view, mesh.vertices)
    most = np.zeros(2)
    for axis in range(2):
        corners = places[mesh.faces, axis]
        low, high = corners.min(axis=1), corners.max(axis=1)
        most[axis] = _quantile(high, area, (1 + MOST) / 2) - _quantile(low, area, (1 - MOST) / 2)
    return np.ptp(places, axis=0), most


def require_size(mesh: Mesh, view: View, where: object, log: Callable[[str], None]) -> None:
    """Log that MOST of the surface is smaller than SMALL times the mesh, as if a few parts lay far away.

    Sizes are the larger of width and height in the picture. Raises InputError if MOST of the surface, besides, is
    smaller than LEAST_PIXELS.
    """
    whole, most = extent_px(mesh, view)
    if not most.max() < SMALL * whole.max():
        return
    size = f"{most.max():.2g} pixels large in a scene of {whole.max():.4g}"
    if most.max() < LEAST_PIXELS:
        raise InputError(f"{MOST:.0%} of the surface is {size}: a part far away?", where=where)
    log(f"mesh: {MOST:.0%} of the surface is {size}: are there parts far away?")


def why_nothing_is_seen(mesh: Mesh, view: View) -> str:
    """Where the object lies, for the message that the camera sees nothing of it."""
    places = projected(view, mesh.vertices)
    low, high = places.min(axis=0), places.max(axis=0)
    return (
        f"an object from column {low[0]:.4g} to {high[0]:.4g} and row {low[1]:.4g} to {high[1]:.4g} of a picture of "
        f"{view.width} x {view.height} pixels"
    )


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The value below which this ``share`` of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    at = int(np.searchsorted(total, share * total[-1]))
    return float(values[order[min(at, len(order) - 1)]])
