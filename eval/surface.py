"""Exports the surface of an estimate as a mesh (PLY, glTF) or a point cloud.

The depth is that of the estimate if the method gives one, and otherwise the integral of its normals. Every 2×2 pixels
that all have a depth become two triangles. Frame: camera, in pixels, x right, y up, z toward the camera, the picture's
centre at 0.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from huesphere.configs.own_folder import inside
from huesphere.eval.maps import display
from huesphere.eval.score import Item, methods_on_disk
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.io.estimate import Estimate, read_estimate
from huesphere.render.dataset import Observation, read_observation

COLOURS = ("red", "green", "blue")
LARGEST_STEP_PX = 8.0  # 2×2 pixels whose depths differ by more get no triangles: one part occludes another there


def export_surfaces(item: Item, folder: Path, kind: str, methods: Sequence[str] = ()) -> list[Path]:
    """Write <folder>/<config>/<transport>/<method>.<ending> for each estimate on disk with normals; returns the paths.

    ``kind``: "ply" or "glb", a mesh with colours and normals at its vertices; "points", a PLY of vertices only.
    """
    observation = read_observation(inside(item.folder, "observation.exr"))
    written = []
    for method in methods or methods_on_disk(item):
        if method not in methods_on_disk(item):
            continue
        estimate, _ = read_estimate(item.estimates_of(method) or item.folder / "estimates", method)
        if not (estimate.valid & observation.mask).any():
            continue
        path = folder / item.config / item.transport / f"{method}.{'glb' if kind == 'glb' else 'ply'}"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_surface(path, observation, estimate, faces=kind != "points")
        written.append(path)
    return written


def write_surface(path: Path, observation: Observation, estimate: Estimate, *, faces: bool) -> None:
    """Write one surface, as a mesh in the format of the path's ending, or without ``faces`` as a PLY point cloud."""
    import trimesh

    vertices, normals, colours, triangles = surface(observation, estimate)
    if faces:
        mesh = trimesh.Trimesh(
            vertices, triangles, vertex_normals=normals, vertex_colors=colours, process=False, validate=False
        )
        mesh.export(path)
    else:
        columns = np.zeros(
            len(vertices), dtype=[(n, "<f4") for n in ("x", "y", "z", "nx", "ny", "nz")] + [(c, "u1") for c in COLOURS]
        )
        for names, values in ((("x", "y", "z"), vertices), (("nx", "ny", "nz"), normals), (COLOURS, colours)):
            for i, name in enumerate(names):
                columns[name] = values[:, i]
        kinds = {"f": "float", "u": "uchar"}
        properties = "".join(f"property {kinds[columns.dtype[n].kind]} {n}\n" for n in columns.dtype.names or ())
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(columns)}\n{properties}end_header\n"
        path.write_bytes(head.encode("ascii") + columns.tobytes())


def surface(observation: Observation, estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices (V, 3) in pixels, normals (V, 3), display colours (V, 3) uint8 and triangles (T, 3).

    There is a vertex for every pixel with a normal. The corners of a triangle are counter-clockwise as the camera sees
    them.
    """
    given = estimate.valid & observation.mask
    depth, ray = estimate.depth, rays(observation.camera, given.shape)
    focal_px = None if ray is None else observation.camera.focal_px
    if depth is None:
        depth = depth_of(depth_from_normals(of_relief(estimate.normals, ray), given, given), focal_px)
    inside = given & np.isfinite(depth)
    height, width = inside.shape
    rows, columns = np.nonzero(inside)
    z = depth[inside].astype(np.float64)
    size = 1.0 if focal_px is None else 1 - z / focal_px  # side of a pixel on the surface at this depth
    vertices = np.stack([(columns - (width - 1) / 2) * size, ((height - 1) / 2 - rows) * size, z - z.mean()], axis=-1)
    rgb = observation.rgb[inside].astype(np.float64)
    brightest = max(float(np.nanpercentile(rgb, 99.9)), 1e-12)
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(len(rows))
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]  # top left … bottom right
    corners = np.stack([depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]])
    whole = (np.minimum(np.minimum(a, b), np.minimum(c, d)) >= 0) & (np.ptp(corners, axis=0) < LARGEST_STEP_PX)
    a, b, c, d = (each[whole] for each in (a, b, c, d))
    triangles = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)])
    return vertices, estimate.normals[inside], display(0.9 * rgb / brightest), triangles
