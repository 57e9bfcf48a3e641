"""Make the figures of the pages on recovery: python docs/figures.py [NAME]… → docs/recover/figures/NAME.png.

Small scenes made with NumPy alone, seeds fixed, a minute in all. Each function draws one figure and says what is in it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.ellipsoid.fit import dispersion, least_median_of_squares
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.methods.table import METHODS
from huesphere.recover.pixels.noise import picture_noise
from huesphere.recover.rotation.closed_form import closed_form
from huesphere.recover.rotation.weak_form import curl_image
from huesphere.render.dataset import CameraInfo, KnownLights, Observation
from huesphere.render.relief import apply_kernel, build_kernel

FOLDER = Path(__file__).parent / "recover" / "figures"
COLOURS = np.array([[1.0, 0.1, 0.1], [0.1, 0.9, 0.1], [0.2, 0.1, 0.8], [0.7, 0.6, 0.1], [0.1, 0.5, 0.6]])
SIZE = 112  # pixels, side of a picture
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#999999"  # of Okabe and Ito


@dataclass(frozen=True)
class Scene:
    """A picture with its truth. Camera frame, image row 0 at the top."""

    observation: Observation
    normals: np.ndarray  # (H, W, 3) unit
    F: np.ndarray  # (3, 3) ρ = F n where every light is seen
    directions: np.ndarray  # (L, 3) unit, toward the lights
    depth: np.ndarray  # (H, W) pixels, toward the camera

    @property
    def mask(self) -> np.ndarray:
        return self.observation.mask

    @property
    def seen(self) -> np.ndarray:
        """(H, W) number of lights that each pixel faces."""
        return (self.normals @ self.directions.T > 0).sum(axis=-1)

    def errors_deg(self, normals: np.ndarray) -> np.ndarray:
        """(H, W) angles between ``normals`` and the truth, NaN where there are none."""
        cross = np.linalg.norm(np.cross(normals, self.normals), axis=-1)
        return np.degrees(np.arctan2(cross, np.sum(normals * self.normals, axis=-1)))


def lights_at(tilts_deg: float | list[float], count: int = 5) -> np.ndarray:
    """Unit directions (L, 3), evenly around the camera's axis and so many degrees off it."""
    around = np.arange(count) * 2 * np.pi / count + 0.4
    tilt = np.radians(np.broadcast_to(tilts_deg, count))
    return np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)], axis=-1)


def dome(size: int = SIZE, *, bumps: float = 0.3, cap: float = 0.8, width: float = 1.15, tilt: float = 0.0):
    """(depth (H, W), mask, normals by differences) of a dome with waves; ``tilt``: slope added along x."""
    row, column = np.mgrid[:size, :size]
    radius = 0.46 * size / cap / max(width, 1.0)
    x, y = (column - (size - 1) / 2) / radius / width, ((size - 1) / 2 - row) / radius
    mask = x**2 + y**2 < cap**2
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 1e-3)) + bumps / 5 * np.sin(5 * x) * np.cos(4 * y) + tilt * x
    p = (-x / np.sqrt(np.maximum(1 - x**2 - y**2, 1e-3)) + bumps * np.cos(5 * x) * np.cos(4 * y) + tilt) / width
    q = -y / np.sqrt(np.maximum(1 - x**2 - y**2, 1e-3)) - 0.8 * bumps * np.sin(5 * x) * np.sin(4 * y)
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return radius * z, mask, n / np.linalg.norm(n, axis=-1, keepdims=True)


def scene(
    *,
    directions: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    ambient: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
    exposure: float = 0.9,
    **shape,
) -> Scene:
    """The dome under lights of full visibility, exposed so that its brightest pixel is at ``exposure``."""
    depth, mask, normals = dome(**shape)
    directions = lights_at(30.0) if directions is None else directions
    colours = COLOURS[: len(directions)] if colours is None else colours
    rgb = np.maximum(normals @ directions.T, 0) @ colours
    scale = exposure / rgb[mask].max()
    rgb = scale * rgb + ambient + noise * np.random.default_rng(seed).standard_normal(rgb.shape)
    rgb[~mask] = 0.0
    observation = Observation(rgb.astype(np.float32), mask, CameraInfo(read_noise=noise))
    return Scene(observation, normals, scale * colours.T @ directions, directions, depth)


# ---- panels ----------------------------------------------------------------------------------------------------------


def as_picture(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Linear colours as they are to be looked at; grey off the object."""
    return np.where(mask[..., None], np.clip(rgb / rgb[mask].max(), 0, 1) ** (1 / 2.2), 0.8)


def as_colour(normals: np.ndarray) -> np.ndarray:
    """Normals as RGB: x, y, z from −1…1 to 0…1; white where there is none."""
    return np.where(np.isfinite(normals), normals / 2 + 0.5, 1.0)


def panels(count: int, *, width: float = 2.3, height: float = 2.5) -> tuple[Figure, list]:
    """A figure with ``count`` panels in a row."""
    figure, axes = plt.subplots(1, count, figsize=(width * count, height), layout="constrained")
    return figure, list(np.atleast_1d(axes))


def show(axis, image: np.ndarray, title: str, **options):
    """An image with a title and no axes."""
    axis.set_title(title, fontsize=9)
    axis.set_axis_off()
    return axis.imshow(image, interpolation="nearest", **options)


def show_errors(figure: Figure, axis, errors: np.ndarray, title: str, *, most: float = 30.0) -> None:
    """A map of angular errors on a logarithmic scale from 0.01°, with the median in the title."""
    known = np.isfinite(errors)
    shown = show(
        axis,
        np.clip(errors, 0.0101, most),
        f"{title}\nmedian {np.median(errors[known]):.2g}°" if known.any() else f"{title}\nno normals",
        norm=LogNorm(0.01, most),
        cmap="viridis",
    )
    figure.colorbar(shown, ax=axis, shrink=0.7, label="degrees")


def two_groups(mask: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Blue where ``group``, orange on the rest of the object, white off it."""
    image = np.ones((*mask.shape, 3))
    image[mask] = matplotlib.colors.to_rgb(ORANGE)
    image[mask & group] = matplotlib.colors.to_rgb(BLUE)
    return image


def off_object(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask, image, np.nan)


# ---- the figures -----------------------------------------------------------------------------------------------------


def walk() -> Figure:
    """The stages of ``auto`` on one picture."""
    made = scene(directions=lights_at(46.0, 4), noise=1e-3)
    picture, mask = made.observation.rgb, made.mask
    inliers, whole = METHODS["weak-integrability"](made.observation), METHODS["auto"](made.observation)
    rotated = picture @ symmetric_root(np.linalg.inv(made.F @ made.F.T)).T
    length = np.maximum(np.linalg.norm(rotated, axis=-1, keepdims=True), 1e-12)
    rotated = np.where(inliers.inlier[..., None], rotated / length, np.nan)
    figure, axes = panels(6, width=1.75, height=2.1)
    show(axes[0], as_picture(picture, mask), "picture")
    show(axes[1], two_groups(mask, inliers.inlier), "ellipsoid:\ninliers (blue)")
    show(axes[2], as_colour(rotated), "root: rotated\nnormals N")
    show(axes[3], as_colour(inliers.normals), "rotation:\nnormals of inliers")
    show(axes[4], as_colour(whole.normals), "normals of\nevery pixel")
    depth = depth_from_normals(whole.normals.astype(float), whole.valid, mask)
    show(axes[5], depth, "depth", cmap="gray")
    return figure


def pixels_and_noise() -> Figure:
    """Which pixels can be used, and noise as measured against noise that was added."""
    toward = np.array([[0.9, 0.5, 0.25], [0.9, -0.5, 0.25], [0.9, 0.0, 0.6]])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    made = scene(directions=toward, exposure=1.4, bumps=0.1, cap=0.99, width=1.0)
    observation = replace(made.observation, rgb=np.minimum(made.observation.rgb, 1.0))
    brightness = observation.rgb.max(axis=-1)
    image = np.ones((*made.mask.shape, 3))
    image[made.mask] = matplotlib.colors.to_rgb(BLUE)
    image[made.mask & (brightness >= 1.0)] = matplotlib.colors.to_rgb(ORANGE)
    image[made.mask & (brightness < 1e-3 * np.quantile(brightness[made.mask], 0.99))] = 0.0
    figure, axes = panels(3, width=2.6)
    show(axes[0], as_picture(observation.rgb, made.mask), "picture")
    show(axes[1], image, "usable (blue), clipped (orange),\ndark (black)")
    added = np.geomspace(1e-4, 3e-2, 9)
    row, column = np.mgrid[:SIZE, :SIZE]
    texture = (1 + 0.02 * np.sin(1.3 * row) * np.sin(1.7 * column))[..., None]
    for factor, colour, text in ((1.0, BLUE, "smooth surface"), (texture, ORANGE, "texture of 2 %, 4 pixels")):
        measured = []
        for noise in added:
            clean, noisy = scene().observation.rgb, scene(noise=noise, seed=1).observation.rgb
            picture = (noisy - clean + factor * clean).astype(float)
            measured.append(picture_noise(picture, dome()[1]))
        axes[2].loglog(added, measured, "o-", color=colour, ms=3, label=text)
    axes[2].loglog(added, added, color=GREY, lw=0.8, zorder=0)
    axes[2].set_xlabel("noise added")
    axes[2].set_title("noise measured", fontsize=9)
    axes[2].legend(fontsize=7)
    return figure


def ellipsoid() -> Figure:
    """A slice of the colours, in the frame in which the ellipsoid is a sphere, and the residuals with the cut."""
    made = scene(directions=lights_at(48.0, 4), noise=3e-3, bumps=0.1, cap=0.95, width=1.0)
    rho = made.observation.rgb[made.mask].astype(float)
    C = least_median_of_squares(rho)
    r = np.einsum("ni,ij,nj->n", rho, C, rho) - 1
    cut = 2.5 * dispersion(r)
    N = rho @ symmetric_root(C).T
    all_lit = (made.seen == len(made.directions))[made.mask]
    # The slice through the camera's direction and that of the first light, in the frame of N = C^½ ρ.
    ahead, light = symmetric_root(C) @ made.F @ [0, 0, 1], symmetric_root(C) @ made.F @ made.directions[0]
    across = np.cross(ahead, light) / np.linalg.norm(np.cross(ahead, light))
    ahead /= np.linalg.norm(ahead)
    flat, up = N @ np.cross(across, ahead), N @ ahead
    thin = np.abs(N @ across) < 0.04
    figure, axes = panels(2, width=3.4, height=2.9)
    for group, colour, text in ((all_lit, BLUE, "sees every light"), (~all_lit, ORANGE, "misses a light")):
        axes[0].plot(flat[thin & group], up[thin & group], ".", ms=3, color=colour, label=text)
    turn = np.linspace(0, np.pi, 300)
    axes[0].plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, label="fitted ellipsoid")
    axes[0].set_aspect("equal")
    axes[0].set_title("slice of the colours", fontsize=9)
    axes[0].legend(fontsize=7, loc="lower center")
    bins = np.linspace(-0.3, 0.1, 80)
    axes[1].hist([r[all_lit], r[~all_lit]], bins, stacked=True, color=[BLUE, ORANGE])
    for side in (-cut, cut):
        axes[1].axvline(side, color="black", lw=0.8, ls="--")
    axes[1].set_yscale("log")
    axes[1].set_xlabel("residual r")
    axes[1].set_title("pixels; dashed: ±2.5 s0", fontsize=9)
    return figure


def few_lit_pixels() -> Figure:
    """Where few pixels see every light: inliers of Least Median of Squares and of ``robust``."""
    directions = lights_at([70, 62, 68, 60, 72, 65], 6)
    colours = np.concatenate([COLOURS, [[0.6, 0.15, 0.55]]])
    made = scene(directions=directions, colours=colours, noise=2e-3, bumps=0.1, cap=0.97, width=1.0, size=128)
    all_lit = made.mask & (made.seen == len(directions))
    figure, axes = panels(3, width=2.6)
    shown = show(
        axes[0], off_object(made.seen, made.mask), f"lights seen\n{all_lit.sum() / made.mask.sum():.0%} see all"
    )
    figure.colorbar(shown, ax=axes[0], shrink=0.7, ticks=range(7))
    for axis, name in zip(axes[1:], ("weak-integrability", "robust"), strict=True):
        estimate = METHODS[name](made.observation)
        pure = (estimate.inlier & all_lit).sum() / max(1, estimate.inlier.sum())
        error = np.median(made.errors_deg(estimate.normals)[estimate.valid]) if estimate.valid.any() else np.nan
        title = f"{name}: {pure:.0%} of inliers\nsee all; {error:.2g}° off, {estimate.status}"
        show(axis, two_groups(made.mask, estimate.inlier), title)
    return figure


def rotation() -> Figure:
    """Curl before and after the rotation, the integral (18), and errors of the closed form and the weak form."""
    whole = scene(bumps=0.15, cap=0.7, width=1.0)
    right = whole.mask & (np.arange(SIZE) > 0.42 * SIZE)
    made = replace(whole, observation=replace(whole.observation, mask=right))
    mask = right & (made.seen == len(made.directions))
    N = made.observation.rgb.astype(float) @ symmetric_root(np.linalg.inv(made.F @ made.F.T)).T
    attitude = min((closed_form(hand * N, mask) for hand in (1.0, -1.0)), key=lambda found: found.integral)
    figure, axes = panels(5, width=2.25, height=2.2)
    weak = METHODS["weak-integrability"](made.observation)
    for axis, normals, text in ((axes[0], N, "before"), (axes[1], weak.normals.astype(float), "after")):
        curl = curl_image(normals, mask & np.isfinite(normals).all(axis=-1))
        shown = show(axis, np.clip(curl, 1e-5, 1), f"|p_y − q_x| {text}", norm=LogNorm(1e-5, 1), cmap="magma")
    figure.colorbar(shown, ax=axes[1], shrink=0.7)
    alpha = np.linspace(0, np.pi / 2, 200)
    for number, (angle, colour) in enumerate(zip(attitude.angles, (BLUE, ORANGE), strict=True)):
        axes[2].semilogy(np.degrees(alpha), angle.integral_at(alpha), color=colour, label=f"u1: choice {number + 1}")
    chosen = attitude.angles[attitude.chosen]
    axes[2].plot(np.degrees(chosen.alpha), chosen.integral, "ko", ms=4)
    axes[2].set_title("integral (18)", fontsize=9)
    axes[2].set_xlabel("α, degrees")
    axes[2].legend(fontsize=7)
    show_errors(figure, axes[3], made.errors_deg(METHODS["drew-kontsevich"](made.observation).normals), "closed form")
    show_errors(figure, axes[4], made.errors_deg(weak.normals), "weak form")
    return figure


def convex_or_concave() -> Figure:
    """A surface and the same turned inside out; how the outline votes."""
    made = scene(bumps=0.25)
    twin = made.normals * [-1, -1, 1]
    outward = np.sum(made.normals[..., :2] * _outward(made.mask), axis=-1)
    figure, axes = panels(4, width=2.3)
    show(axes[0], as_colour(np.where(made.mask[..., None], made.normals, np.nan)), "normals n")
    show(axes[1], as_colour(np.where(made.mask[..., None], twin, np.nan)), "diag(−1, −1, 1) n")
    row = SIZE // 2
    known = made.mask[row]
    profile = np.where(known, made.depth[row] - made.depth[row][known].mean(), np.nan)
    axes[2].plot(profile, color=BLUE, label="surface")
    axes[2].plot(-profile, color=ORANGE, label="other solution")
    axes[2].set_title("depth along the middle row", fontsize=9)
    axes[2].legend(fontsize=7)
    shown = show(
        axes[3], off_object(outward, made.mask), "votes: n out of the outline", cmap="RdBu", vmin=-0.6, vmax=0.6
    )
    figure.colorbar(shown, ax=axes[3], shrink=0.7)
    return figure


def _outward(mask: np.ndarray) -> np.ndarray:
    """Unit directions (H, W, 2), right and up, from the middle of the mask."""
    row, column = np.mgrid[: mask.shape[0], : mask.shape[1]]
    v = np.stack([column - column[mask].mean(), row[mask].mean() - row], axis=-1)
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1.0)


def _wide() -> Scene:
    """The dome of the pages on lights and on every pixel."""
    return scene(directions=lights_at(48.0), bumps=0.12, cap=0.92, width=1.0)


def _found_directions(estimate) -> np.ndarray:
    return np.array([light.direction for light in estimate.lights.found]).reshape(-1, 3)


def lights() -> Figure:
    """Which lights each pixel sees, and directions of the lights, true and found."""
    made = _wide()
    found = _found_directions(METHODS["knit"](made.observation))
    figure, axes = panels(2, width=3.0, height=2.9)
    missed = (made.normals @ made.directions.T <= 0) @ (1 << np.arange(len(made.directions)))
    sets = np.unique(missed[made.mask])
    number = np.searchsorted(sets, missed).astype(float)
    show(axes[0], off_object(number, made.mask), f"sets of lights seen: {len(sets)}", cmap="tab20")
    axes[1].add_patch(plt.Circle((0, 0), 1, fill=False, color=GREY))
    for direction, colour in zip(made.directions, COLOURS, strict=True):
        axes[1].plot(*direction[:2], "o", ms=11, mfc="none", mec=colour, mew=2)
    axes[1].plot(found[:, 0], found[:, 1], "kx", ms=6)
    off = [np.degrees(np.arccos(np.clip((made.directions @ d).max(), -1, 1))) for d in found]
    axes[1].set_title(f"{len(found)} lights found, at most {max(off):.2g}° off", fontsize=9)
    axes[1].set_xlim(-1.1, 1.1)
    axes[1].set_ylim(-1.1, 1.1)
    axes[1].set_aspect("equal")
    axes[1].set_axis_off()
    return figure


def every_pixel() -> Figure:
    """Normals of the inliers, how each pixel came by its normal, and normals of every pixel."""
    made = _wide()
    inliers, whole = METHODS["weak-integrability"](made.observation), METHODS["knit"](made.observation)
    figure, axes = panels(4, width=2.3)
    show(axes[0], as_colour(inliers.normals), f"inliers: {inliers.valid.sum() / made.mask.sum():.0%}")
    show(axes[1], as_colour(whole.normals), "every pixel")
    missing = (made.seen < len(made.directions)) & made.mask
    show(axes[2], two_groups(made.mask, ~missing), "all-lit (blue),\nmiss lights (orange)")
    show_errors(figure, axes[3], made.errors_deg(whole.normals), "errors")
    return figure


def depth() -> Figure:
    """Depth over gaps by two models."""
    made = scene(bumps=0.25, size=128)
    rng = np.random.default_rng(0)
    valid = made.mask.copy()
    for row, column, radius in zip(rng.integers(25, 105, 7), rng.integers(25, 105, 7), rng.integers(8, 16, 7)):
        y, x = np.mgrid[:128, :128]
        valid &= (x - column) ** 2 + (y - row) ** 2 > radius**2
    found = {m: depth_from_normals(made.normals, valid, made.mask, model=m) for m in ("coupled", "poisson")}
    truth = off_object(made.depth - made.depth[made.mask].mean(), made.mask)
    row = int(np.argmax((made.mask & ~valid).sum(axis=1)))
    figure, axes = panels(3, width=2.9)
    given = np.where(valid[..., None], made.normals, np.nan)
    share = 1 - valid.sum() / made.mask.sum()
    show(axes[0], as_colour(given), f"normals, {share:.0%} of them missing")
    axes[0].axhline(row, color="black", lw=0.6)
    show(axes[1], found["coupled"], "depth, coupled", cmap="gray")
    axes[2].plot(truth[row], color="black", lw=1, label="truth")
    for model, colour in (("coupled", BLUE), ("poisson", ORANGE)):
        z = found[model][row]
        axes[2].plot(z - np.nanmean(z - truth[row]), color=colour, lw=1, label=model)
    gap = made.mask[row] & ~valid[row]
    axes[2].fill_between(np.arange(128), -25, 25, where=gap, color=GREY, alpha=0.2)
    axes[2].set_ylim(-24, 22)
    axes[2].set_title("profile along the line; grey: gaps", fontsize=9)
    axes[2].legend(fontsize=7, loc="lower center")
    return figure


def interreflection() -> Figure:
    """Hills that light themselves, and what the indirect light does to the normals."""
    side, albedo = 72, np.array([0.9, 0.7, 0.5])
    y, x = np.mgrid[:side, :side] / side * 2 - 1
    mask = x**2 + y**2 < 0.85
    z = side * (0.11 * np.sin(5 * x + 1) * np.cos(4 * y) + 0.05 * np.sin(8 * y - 3 * x) - 0.25 * (x**2 + y**2))
    down, right = np.gradient(z)
    n = np.stack([-right, down, np.ones_like(z)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    directions = lights_at(24.0, 3)
    F = np.array([[0.9, 0.2, 0.1], [0.3, 0.8, 0.2], [0.1, 0.3, 0.9]]) @ directions
    direct = np.maximum(n[mask] @ F.T, 0.0)
    kernel = build_kernel(z, mask, n, azimuths=96, seed=5)
    total = direct.copy()
    for _ in range(60):  # L = D + α K L
        total = direct + albedo * apply_kernel(kernel, total)
    rgb, share = np.zeros((side, side, 3)), np.full((side, side), np.nan)
    rgb[mask] = 0.9 / total.max() * total
    share[mask] = 100 * (1 - direct.sum(axis=1) / total.sum(axis=1))
    made = Scene(Observation(rgb.astype(np.float32), mask, CameraInfo()), n, F, directions, z)
    figure, axes = panels(4, width=2.4)
    show(axes[0], as_picture(rgb, mask), "picture")
    shown = show(axes[1], share, "indirect light", cmap="magma")
    figure.colorbar(shown, ax=axes[1], shrink=0.7, label="per cent")
    for axis, name in zip(axes[2:], ("weak-integrability", "unbounce"), strict=True):
        show_errors(figure, axis, made.errors_deg(METHODS[name](made.observation).normals), name)
    return figure


def uncertainty() -> Figure:
    """Actual and stated errors, as maps and against each other."""
    made = scene(noise=1e-3, directions=lights_at(36.0))
    estimate = METHODS["weak-integrability"](made.observation)
    errors, stated = made.errors_deg(estimate.normals), estimate.uncertainty_deg.astype(float)
    figure, axes = panels(3, width=2.6)
    options = {"vmin": 0, "vmax": np.nanquantile(stated, 0.99), "cmap": "viridis"}
    show(axes[0], errors, "actual error", **options)
    shown = show(axes[1], stated, "stated error", **options)
    figure.colorbar(shown, ax=axes[1], shrink=0.7, label="degrees")
    x, e = stated[estimate.valid], errors[estimate.valid]
    tenths = np.array_split(np.argsort(x), 10)
    axes[2].plot([x[t].mean() for t in tenths], [e[t].mean() for t in tenths], "o-", color=BLUE, ms=4)
    top = 1.1 * x[tenths[-1]].mean()
    axes[2].plot([0, top], [0, top], color=GREY, lw=0.8, zorder=0)
    axes[2].set_xlabel("stated, degrees")
    axes[2].set_title("mean actual error in ten bins", fontsize=9)
    return figure


def perspective() -> Figure:
    """An ellipsoid in perspective, its focal length unknown and known."""
    size, field = 128, 50.0
    f = size / 2 / np.tan(np.radians(field / 2))
    row, column = np.indices((size, size)) + 0.5
    v = np.stack([(column - size / 2) / f, (size / 2 - row) / f, -np.ones((size, size))], axis=-1)
    middle, axes_of = np.array([0.3, -0.15, -3.1]), np.array([0.95, 0.8, 0.9])  # camera at 0, looking along −z
    a = ((v / axes_of) ** 2).sum(axis=-1)
    b = (v * middle / axes_of**2).sum(axis=-1)
    c = ((middle / axes_of) ** 2).sum() - 1
    hit = b**2 - a * c > 0
    t = (b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a
    n = (t[..., None] * v - middle) / axes_of**2
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    directions = lights_at(25.0)
    rgb = np.maximum(n @ directions.T, 0) @ COLOURS
    scale = 0.9 / rgb[hit].max()
    rgb = np.where(hit[..., None], scale * rgb, 0.0).astype(np.float32)
    figure, axes = panels(3, width=2.6)
    show(axes[0], as_picture(rgb, hit), "picture")
    for axis, focal, title in ((axes[1], None, "rays taken for parallel"), (axes[2], f, "focal length known")):
        camera = CameraInfo(projection="perspective", focal_px=focal)
        made = Scene(Observation(rgb, hit, camera), n, scale * COLOURS.T @ directions, directions, t)
        estimate = METHODS["weak-integrability"](made.observation)
        show_errors(figure, axis, made.errors_deg(estimate.normals), title)
    return figure


def near_lights() -> Figure:
    """A dome under five near lights, their positions unknown and known."""
    depth_map, mask, n = dome(96, bumps=0.3, cap=0.8, width=1.0)
    size = mask.shape[0]
    row, column = np.mgrid[:size, :size]
    X = np.stack([column - (size - 1) / 2, (size - 1) / 2 - row, depth_map - 0.5 * size], axis=-1)
    P = 3 * 0.46 * size * lights_at(30.0, 5)
    toward = P - X[..., None, :]
    a = toward / np.linalg.norm(toward, axis=-1, keepdims=True) ** 3
    rgb = np.maximum(np.einsum("hwli,hwi->hwl", a, n), 0) @ COLOURS
    rgb *= 0.9 / rgb[mask].max()
    rgb += 1e-3 * np.random.default_rng(0).standard_normal(rgb.shape)
    rgb[~mask] = 0
    far = Observation(rgb.astype(np.float32), mask, CameraInfo(read_noise=1e-3))
    told = replace(far, lights=KnownLights(P, np.zeros((0, 3))))
    figure, axes = panels(3, width=2.6)
    show(axes[0], as_picture(rgb, mask), "picture")
    for axis, name, observation in ((axes[1], "weak-integrability", far), (axes[2], "auto", told)):
        made = Scene(observation, n, np.eye(3), P, depth_map)
        estimate = METHODS[name](observation)
        show_errors(figure, axis, made.errors_deg(estimate.normals), f"{name}, {estimate.status}")
    return figure


def ambient() -> Figure:
    """Normals with and without the ambient term."""
    made = scene(ambient=0.08, bumps=0.1)
    figure, axes = panels(3, width=2.6)
    rgb = made.observation.rgb[made.mask].astype(float)
    where = np.eye(3)[[0, 1]]
    axes[0].plot(*(rgb[::7] @ where.T).T, ".", ms=2, color=BLUE)
    axes[0].plot(0, 0, "k+", ms=8, label="black")
    axes[0].plot(0.08, 0.08, "x", color=ORANGE, ms=7, label="ambient light")
    axes[0].set_xlabel("red")
    axes[0].set_title("green against red", fontsize=9)
    axes[0].legend(fontsize=7)
    for axis, name, title in (
        (axes[1], "drew-kontsevich", "about black"),
        (axes[2], "drew-kontsevich-ambient", "centre fitted"),
    ):
        estimate = METHODS[name](made.observation)
        n, truth = estimate.normals[estimate.valid].astype(float), made.normals[estimate.valid]
        U, _, Vt = np.linalg.svd(n.T @ truth)
        aligned = estimate.normals @ (U @ Vt)
        show_errors(figure, axis, made.errors_deg(aligned), f"{title}, best rotation")
    return figure


def varying_brightness() -> Figure:
    """A dome of patches: its picture, errors of three methods, and the albedo that is found."""
    plain = scene(directions=lights_at(30.0), cap=0.95, bumps=0.15, noise=1e-3)
    values = np.random.default_rng(3).uniform(0.3, 1.0, (5, 5)).repeat(24, 0).repeat(24, 1)[:SIZE, :SIZE]
    rgb = (plain.observation.rgb * values[..., None]).astype(np.float32)
    made = replace(plain, observation=replace(plain.observation, rgb=rgb))
    figure, axes = panels(5)
    show(axes[0], as_picture(rgb, made.mask), "the picture")
    for axis, name in zip(axes[1:4], ("weak-integrability", "silhouette-matrix", "uniform-hue"), strict=True):
        estimate = METHODS[name](made.observation)
        show_errors(figure, axis, made.errors_deg(estimate.normals), name)
    found = axes[4].imshow(off_object(np.nan_to_num(estimate.albedo), made.mask), cmap="gray")
    axes[4].set_title("albedo found", fontsize=9)
    axes[4].set_axis_off()
    figure.colorbar(found, ax=axes[4], shrink=0.7)
    return figure


def baselines() -> Figure:
    """Median errors of the methods that give the inliers only, without and with noise."""
    names = (
        "least-squares",
        "drew-kontsevich",
        "kontsevich-1994",
        "kontsevich-1994-growing",
        "alternation",
        "weak-integrability",
        "robust",
    )
    figure, axes = panels(1, width=6.2, height=2.6)
    for number, (noise, colour) in enumerate(((0.0, BLUE), (1e-3, ORANGE))):
        made = scene(noise=noise, directions=lights_at(38.0), tilt=0.15)
        for place, name in enumerate(names):
            estimate = METHODS[name](made.observation)
            if estimate.status == "ok":
                error = max(np.median(made.errors_deg(estimate.normals)[estimate.valid]), 1e-3)
                axes[0].barh(place + 0.4 * number, error, 0.38, color=colour, label=f"noise {noise:g}")
    axes[0].set_yticks(np.arange(len(names)) + 0.2, names, fontsize=8)
    axes[0].invert_yaxis()
    axes[0].set_xscale("log")
    axes[0].set_xlabel("median error, degrees")
    handles, texts = axes[0].get_legend_handles_labels()
    kept = {text: handle for handle, text in zip(handles, texts, strict=True)}
    axes[0].legend(kept.values(), kept.keys(), fontsize=8)
    return figure


def failures() -> Figure:
    """Pictures that do not meet the assumptions, each with the status of ``weak-integrability``."""
    plain = scene()
    grey = scene(colours=np.ones((5, 3)))
    plane = scene(directions=lights_at(30.0, 2), colours=COLOURS[:2])
    flat = np.full_like(plain.observation.rgb, 0.5) * [1.0, 0.7, 0.4]
    flat += 1e-3 * np.random.default_rng(0).standard_normal(flat.shape)
    row, column = np.mgrid[:SIZE, :SIZE]
    angle = np.arctan2(SIZE / 2 - row - 0.5, column + 0.5 - SIZE / 2)
    cone = np.stack([np.cos(angle), np.sin(angle), np.full(angle.shape, 1.2)], axis=-1) / np.hypot(1, 1.2)
    cone_rgb = 0.4 * np.maximum(cone @ plain.directions.T, 0) @ COLOURS
    clipped = np.minimum(4 * plain.observation.rgb, 1.0)
    wide = scene(directions=lights_at(80.0, 5), cap=0.98, width=1.0)
    cases = (
        ("grey lights", grey.observation),
        ("two lights", plane.observation),
        ("flat surface", replace(plain.observation, rgb=flat.astype(np.float32))),
        ("cone", replace(plain.observation, rgb=np.where(plain.mask[..., None], cone_rgb, 0).astype(np.float32))),
        (
            "over-exposed",
            replace(plain.observation, rgb=clipped, camera=CameraInfo(saturation=1.0)),
        ),
        ("lights at the horizon", wide.observation),
    )
    figure, axes = panels(len(cases), width=1.75, height=2.2)
    for axis, (title, observation) in zip(axes, cases, strict=True):
        status = METHODS["weak-integrability"](observation).status
        show(axis, as_picture(np.maximum(observation.rgb, 0), observation.mask), f"{title}:\n{status}")
        axis.title.set_fontsize(7.5)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "walk": walk,
    "pixels-and-noise": pixels_and_noise,
    "ellipsoid": ellipsoid,
    "few-lit-pixels": few_lit_pixels,
    "rotation": rotation,
    "convex-or-concave": convex_or_concave,
    "lights": lights,
    "every-pixel": every_pixel,
    "depth": depth,
    "interreflection": interreflection,
    "uncertainty": uncertainty,
    "perspective": perspective,
    "near-lights": near_lights,
    "ambient": ambient,
    "varying-brightness": varying_brightness,
    "baselines": baselines,
    "failures": failures,
}


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or FIGURES:
        figure = FIGURES[name]()
        figure.savefig(
            FOLDER / f"{name}.png", dpi=100, bbox_inches="tight", pad_inches=0.06, metadata={"Software": None}
        )
        plt.close(figure)


if __name__ == "__main__":
    main()
