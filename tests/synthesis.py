"""Scenes for the tests of recovery, made with NumPy alone: analytic surfaces, the Mozart scan, lights, shadows, colour.

Test modules import from here; ``test_synthesis`` holds these helpers to what they claim.
"""

import functools
from pathlib import Path

import numpy as np
import pytest

from huesphere.recover.depth.joint_fit import fit_jointly
from huesphere.recover.lights.model import Lights
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution
from huesphere.render.dataset import CameraInfo, Observation

MOZART = Path(__file__).parents[2] / "shared" / "data" / "mozart" / "mozart_depth.npz"
needs_mozart = pytest.mark.skipif(not MOZART.is_file(), reason="the Mozart scan is not here: it cannot be distributed")

# mozart_5lights.yaml
DIRECTIONS = np.array([(0.5, 0.2, 1), (-0.5, 0.2, 1), (0, -0.5, 1), (0.3, 0.5, 1), (-0.2, 0.4, 1)], float)
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TWIN = np.diag([-1.0, -1.0, 1.0])


@functools.cache
def light_colours(kind: str) -> np.ndarray:
    """Colours (5, 3) of five lights on light skin, as a Nikon 5100 sees them: "natural" A B C D65 FL2, or "gels"."""
    import colour

    shape = colour.SpectralShape(380, 780, 5)
    wavelengths = shape.wavelengths
    if kind == "natural":
        names = ("A", "B", "C", "D65", "FL2")
        emitters = [colour.SDS_ILLUMINANTS[name].copy().align(shape).values for name in names]
    else:
        bands = zip((610, 540, 460, 580, 500), (25, 25, 20, 40, 40))
        emitters = [np.exp(-0.5 * ((wavelengths - centre) / sigma) ** 2) for centre, sigma in bands]
    visible = (wavelengths >= 400) & (wavelengths <= 700)
    emitters = [e / e[visible].mean() for e in emitters]
    skin = colour.SDS_COLOURCHECKERS["ISO 17321-1"]["light skin"].copy().align(shape).values
    camera = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"].copy().align(shape).values
    return (np.array(emitters) * skin) @ camera


def normals_of_depth(depth: np.ndarray) -> np.ndarray:
    """Unit normals (H, W, 3) of a depth map by centred differences; y up, row 0 at the top."""
    p, q = np.zeros_like(depth), np.zeros_like(depth)
    p[:, 1:-1] = (depth[:, 2:] - depth[:, :-2]) / 2
    q[1:-1] = (depth[:-2] - depth[2:]) / 2
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


@functools.cache
def mozart() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(normals, mask, depth) of the scan; normals by centred differences, so one pixel less than its mask."""
    from scipy.ndimage import binary_erosion

    with np.load(MOZART) as file:
        depth, mask = file["depth"].astype(float), file["mask"]
    return normals_of_depth(depth), binary_erosion(mask), depth


def dome(size: int, *, elongation: float = 1.0, bumps: float = 0.0, cap: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Analytic (normals, mask) of a spheroidal cap with waves on it: the gradient of z, not a difference of it.

    ``cap`` is the image radius at the mask's border over the sphere's; ``elongation`` stretches x.
    """
    row, column = np.mgrid[:size, :size]
    radius = 0.46 * size / cap
    x = (column - (size - 1) / 2) / radius / elongation
    y = ((size - 1) / 2 - row) / radius
    mask = x * x + y * y < cap**2
    z = np.sqrt(np.maximum(1 - x * x - y * y, 1e-3))
    p = (-x / z + bumps * np.cos(5 * x) * np.cos(4 * y)) / elongation
    q = -y / z - bumps * 0.8 * np.sin(5 * x) * np.sin(4 * y)  # of bumps/5 · sin 5x · cos 4y
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True), mask


def shade(
    normals: np.ndarray,
    mask: np.ndarray,
    colours: np.ndarray,
    *,
    directions: np.ndarray = DIRECTIONS,
    hidden: np.ndarray | None = None,
    noise: float = 0.0,
    seed: int = 0,
    camera: CameraInfo | None = None,
) -> tuple[Observation, np.ndarray]:
    """(observation, F): max(0, a·n) of each light, less where ``hidden`` (H, W, L), exposed as the renderer does."""
    shading = np.maximum(normals @ directions.T, 0.0)
    if hidden is not None:
        shading = np.where(hidden, 0.0, shading)
    rgb = shading @ colours
    exposure = 0.9 / np.percentile(rgb[mask].max(axis=-1), 99.9)
    rgb = rgb * exposure + noise * np.random.default_rng(seed).standard_normal(rgb.shape)
    rgb[~mask] = 0.0
    return Observation(rgb.astype(np.float32), mask, camera or CameraInfo()), colours.T @ directions * exposure


def cast_shadows(depth: np.ndarray, mask: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Which pixels of a height field something hides from each light, (H, W, L), by marching half a pixel at a time."""
    from scipy.ndimage import map_coordinates

    rows, columns = np.nonzero(mask)
    ground = np.where(mask, depth, depth[mask].min() - 10.0)
    top = depth[mask].max()
    hidden = np.zeros((*mask.shape, len(directions)), bool)
    for light, (x, y, z) in enumerate(directions):
        height = depth[mask].copy()
        dark = np.zeros(len(rows), bool)
        rise = z / np.hypot(x, y)
        for step in np.arange(0.5, (top - height.min()) / rise + 1, 0.5):
            at = step / np.hypot(x, y)
            alive = np.flatnonzero(~dark & (height + step * rise < top))
            if not len(alive):
                break
            where = [rows[alive] - at * y, columns[alive] + at * x]
            above = map_coordinates(ground, where, order=1, mode="constant", cval=-1e9)
            dark[alive[above > height[alive] + step * rise + 0.02]] = True
        hidden[rows, columns, light] = dark
    return hidden


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles in degrees between unit vectors (..., 3), exact for small ones too."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def median_error(estimate, normals: np.ndarray) -> float:
    """Median angle in degrees over the pixels that the estimate gives."""
    return float(np.median(angles_deg(estimate.normals[estimate.valid].astype(float), normals[estimate.valid])))


def aligned_error(estimate, normals: np.ndarray) -> float:
    """The same after the best orthogonal alignment to the truth: what no rotation could better."""
    n, truth = estimate.normals[estimate.valid].astype(float), normals[estimate.valid]
    U, _, Vt = np.linalg.svd(n.T @ truth)
    return float(np.median(angles_deg(n @ (U @ Vt), truth)))


def problem_of_colours(rgb: np.ndarray, mask: np.ndarray, noise: float = 0.0) -> Problem:
    """The problem of a picture in parallel rays whose every pixel of the object is usable."""
    nothing = np.zeros(mask.shape, bool)
    return Problem(rgb.astype(np.float64), mask, mask, nothing, None, noise, np.zeros(rgb.shape))


def solution_of(F: np.ndarray, inlier: np.ndarray, turn_deg: float = 1.0) -> Solution:
    """A solution whose rotation has this standard deviation about each axis."""
    return Solution(F, inlier, 0.0, np.radians(turn_deg) ** 2 * np.eye(3))


def joint_fit(rgb, mask, start, first, noise, removed=None):
    """The joint fit of a picture of pixels that see every light, from normals ``start`` and a matrix ``first``."""
    nothing = np.zeros_like(mask)
    problem = Problem(rgb, mask, mask, nothing, None, noise, np.zeros_like(rgb) if removed is None else removed)
    solution = Solution(first, mask, noise, np.zeros((3, 3)))
    return fit_jointly(problem, solution, start, np.where(mask, 0, -1), Lights((), 1.0))
