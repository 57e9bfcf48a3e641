"""Lets the camera see both sides of surfaces that are not closed: an open vase, a cut mask, a sheet.

A face reflects light on its front alone. Where the camera meets a mesh from behind, its parts are thus looked at: an
open part gets a second side, closely behind the first; a closed part that mostly shows its back is wound inside out,
and is turned.
"""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np

from huesphere.render.direct import camera_hits
from huesphere.render.raycast import ray_caster
from huesphere.scenes.build import Scene
from huesphere.scenes.mesh import area_normals
from huesphere.scenes.meshes.sides import parts_in_space, turned_over, with_second_side

THICKNESS_PIXELS = 0.05  # between the two sides; more than rays start off the surface


def with_both_sides(scene: Scene, mi: ModuleType, log: Callable[[str], None]) -> Scene:
    """``scene`` with two sides where the camera meets its object from behind; ``log`` gets a line on what was done."""
    view, mesh = scene.view, scene.mesh
    rows, cols = np.indices((view.height, view.width)).reshape(2, -1) + 0.5
    hit, points = camera_hits(scene, ray_caster(mi, mesh, 0.0), rows, cols)
    seen = points.face[scene.is_object[mesh.material[points.face]]]
    direction = view.rays(rows[hit], cols[hit])[1][scene.is_object[mesh.material[points.face]]]
    back = np.einsum("nc,nc->n", area_normals(mesh.vertices, mesh.faces[seen]), direction) > 0
    if not back.any():
        return scene
    parts, place = parts_in_space(mesh)
    part = parts.of_face[seen]
    backs = np.bincount(part[back], minlength=parts.count)
    mostly = backs > np.bincount(part, minlength=parts.count) / 2
    solid = parts.closed & parts.orientable
    over, double = (solid & mostly)[parts.of_face], (~solid & (backs > 0))[parts.of_face]
    if over.any():
        mesh = turned_over(mesh, over)
        log(f"mesh: {int(over.sum()):,} faces of closed parts were turned, whose backs the camera sees")
    if double.any():
        mesh = with_second_side(mesh, double, place, THICKNESS_PIXELS * view.pixel_size)
        share = backs[~solid].sum() / len(seen)
        log(f"mesh: {share:.0%} of the object's pixels show the back of an open surface, which was given a second side")
    return replace(scene, mesh=mesh)
