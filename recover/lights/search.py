"""A shell whose rotation is in doubt, asked of the whole picture: which few lights and which surface make it.

The normals of few pixels are those of a surface under many rotations, to within noise. The pixels that miss a light
decide between them, ten times as many and with all the steep ones among them, once the lights are known; and lights
and surface are found together (``recover.lights.lit_surface``). They are believed where little is left over; half of
them are within 2° of the truth then, on random scenes. What sees every light by them takes the place of the shell's
pixels, and their F that of the shell's, which may have been another shell. What is left over where all is right is each
block's noise, and more where blocks cannot follow detail; more than that puts the turn from what was known before in
doubt.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.geometry.threads import small_algebra
from huesphere.recover.lights.lit_surface import LitSurface, lit_surface

LEFT_OVER = 1.5  # loss beyond which lights and surface are not believed
LEAST_LIT = 0.03  # share of the object that must see every light
LOST, ON_SHELL = 1.0, 3.0  # times the noise: what a pixel may lack of the light of all, and its distance to the shell
QUIET, DETAIL = 0.3, 2.5  # loss of what is explained, and of each block that is not, beyond which it may be amiss
SMOOTH, SMOOTH_QUIET = 0.9, 0.85  # share explained of surfaces without detail, and that loss of them
ASTRAY = 3.0  # how much farther than by noise F is off, where nothing but noise is left over; more with what is


@dataclass(frozen=True)
class WholePicture:
    """The pixels that see every light, and their matrix, by what explains the whole picture."""

    F: np.ndarray  # (3, 3)
    all_lit: np.ndarray  # (H, W) bool
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of their normals
    surface: LitSurface


def whole_picture(
    rgb: np.ndarray,
    mask: np.ndarray,
    seen: np.ndarray,
    core: np.ndarray,
    F: np.ndarray,
    turn: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
) -> tuple[WholePicture | None, dict[str, Any]]:
    """(what the whole picture says of the shell, if it is believed; what is told of it).

    All as for ``lit_surface``; ``core`` (H, W), ``F``, ``turn`` (3, 3) and ``noise`` are the shell's.
    """
    try:
        with small_algebra():
            found = lit_surface(rgb, mask, core, F, turn, noise, ray, seen)
        away = np.linalg.solve(found.F, F)
    except (np.linalg.LinAlgError, RuntimeError):  # of non-negative least squares, the latter
        return None, {"used": False}
    U, _, Vt = np.linalg.svd(away)
    turned = float(np.degrees(np.arccos(np.clip((np.trace(U @ Vt) - 1) / 2, -1, 1))))
    told: dict[str, Any] = {"loss": found.loss, "explained": found.explained, "turned_deg": turned}
    told["lights"] = [{"direction": a.tolist(), "colour": b.tolist()} for a, b in zip(found.toward, found.colour)]
    lost = np.maximum(-np.nan_to_num(found.normals) @ found.toward.T, 0.0) @ found.colour
    all_lit = seen & (np.linalg.norm(lost, axis=-1) < LOST * noise)
    all_lit[all_lit] = np.abs(signed_distance(rgb[all_lit], np.linalg.inv(found.F @ found.F.T))) < ON_SHELL * noise
    same_hand = np.linalg.det(away) > 0
    used = bool(found.loss < LEFT_OVER and same_hand and all_lit.sum() > LEAST_LIT * mask.sum())
    told["used"] = used
    if not used:
        return None, told
    covariance = _rotation(found, found.normals[all_lit])
    quiet = SMOOTH_QUIET if found.explained > SMOOTH else QUIET + DETAIL * (1 - found.explained)
    if found.loss > quiet:
        covariance = covariance + np.radians(turned) ** 2 / 3 * np.eye(3)
    return WholePicture(found.F, all_lit, covariance, found), told


def _rotation(found: LitSurface, n: np.ndarray) -> np.ndarray:
    """Covariance (3, 3), radians², of the small rotation ω that F's error makes of normals (P, 3): F⁻¹δF n ≈ n × ω."""
    gram = len(n) * np.eye(3) - n.T @ n  # of n × ω, squared
    # Σ n × (F⁻¹ δF n): linear in δF, row by row.
    M, moments = np.linalg.inv(found.F), n.T @ n
    by_F = np.einsum("ijk,km,lj->iml", _LEVI_CIVITA, M, moments).reshape(3, 9)
    T = np.linalg.solve(gram, by_F)
    doubt = ASTRAY * max(1.0, found.loss) ** 2
    return doubt**2 * T @ found.covariance @ T.T  # type: ignore[no-any-return]


_LEVI_CIVITA = np.array([[[(i - j) * (j - k) * (k - i) / 2 for k in range(3)] for j in range(3)] for i in range(3)])
