"""A closed room around the object: a box with six walls that reflect light."""

from dataclasses import dataclass

import numpy as np

from huesphere.configs import schema
from huesphere.scenes import primitives
from huesphere.scenes.mesh import Mesh

WALLS = ("left", "right", "floor", "ceiling", "back", "front")


@dataclass(frozen=True)
class Enclosure:
    """The inside of an axis-parallel box, each wall a grid of ``detail`` cells a side. Camera frame, scene units."""

    low: np.ndarray  # (3,)
    high: np.ndarray  # (3,)
    detail: int
    first_material: int  # number of the left wall's reflectance; the others follow in the order of WALLS

    def rectangles(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(corner, edge_u, edge_v) of each wall, in the order of WALLS; edge_u × edge_v points inward."""
        x, y, z = np.diag(self.high - self.low)
        low = self.low
        return [(low, y, z), (low + x, z, y), (low, z, x), (low + y, x, z), (low, x, y), (low + z, y, x)]

    def mesh(self) -> Mesh:
        """The six walls as a mesh."""
        cells = (self.detail, self.detail)
        parts = [primitives.rectangle(*wall, cells) for wall in self.rectangles()]
        return primitives.join([primitives.with_material(p, self.first_material + i) for i, p in enumerate(parts)])


def build_enclosure(mesh: Mesh, room: schema.Room, first_material: int) -> Enclosure:
    """The room of a config around the object ``mesh``; its left wall has the material ``first_material``."""
    low = np.array([-room.width / 2, -room.height / 2, mesh.vertices[:, 2].min() - room.behind])
    high = np.array([room.width / 2, room.height / 2, mesh.vertices[:, 2].max() + room.before])
    return Enclosure(low, high, room.detail, first_material)
