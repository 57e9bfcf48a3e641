"""Random objects of one hue whose brightness varies from place to place, for calibrating ``recover.uniform_hue``.

An outline of random shape is inflated to a random depth and waved; its albedo has patches between .3 and 1, varies
smoothly, or is that of fine texture; three to six lights have primary colours or saturated hues. Attached shadows only.
"""

import colorsys
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.inflated_outline import membrane
from huesphere.render.dataset import CameraInfo, Observation

ALBEDOS = ("patches", "smooth", "texture", "uniform")


@dataclass(frozen=True)
class Scene:
    """A picture with its true normals (H, W, 3)."""

    observation: Observation
    normals: np.ndarray
    name: str


def scene(seed: int, size: int = 128, noise: float = 1e-3) -> Scene:
    """The random scene of that number, ``size`` pixels wide."""
    rng = np.random.default_rng(seed)
    normals, mask = _body(rng, size)
    albedo_kind, light_kind = rng.choice(ALBEDOS[:3]), rng.choice(["lamps", "hues"])
    directions, colours = lights(rng, str(light_kind))
    rgb = np.maximum(normals @ directions.T, 0) @ colours * albedo(rng, str(albedo_kind), size)[..., None]
    return Scene(exposed(rgb, mask, noise, rng), normals, f"{seed}: {albedo_kind}, {light_kind}")


def exposed(rgb: np.ndarray, mask: np.ndarray, noise: float, rng: np.random.Generator) -> Observation:
    """The observation of ``rgb`` (H, W, 3), its brightest at .9, with ``noise`` of that standard deviation."""
    rgb = 0.9 * rgb / np.quantile(rgb[mask].max(axis=1), 0.999) + noise * rng.standard_normal(rgb.shape)
    return Observation(np.where(mask[..., None], rgb, 0.0).astype(np.float32), mask, CameraInfo(read_noise=noise))


def lights(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """(directions (L, 3), colours (L, 3)): three lamps of one primary colour each, or four to six saturated hues."""
    count = 3 if kind == "lamps" else int(rng.integers(4, 7))
    azimuth = rng.uniform(0, 2 * np.pi) + 2 * np.pi * (np.arange(count) + rng.uniform(-0.15, 0.15, count)) / count
    off = np.radians(rng.uniform(25, 45, count))
    directions = np.stack([np.sin(off) * np.cos(azimuth), np.sin(off) * np.sin(azimuth), np.cos(off)], axis=1)
    if kind == "lamps":
        colours = np.eye(3) * 0.9 + 0.1 / 3
    else:
        hues = np.arange(count) / count + rng.uniform()
        colours = np.array([colorsys.hsv_to_rgb(h % 1, 0.9, 1) for h in hues]) ** 1.5
    return directions, colours * rng.uniform(0.7, 1.3, (count, 1))


def albedo(rng: np.random.Generator, kind: str, size: int) -> np.ndarray:
    """(size, size) albedo."""
    if kind == "uniform":
        return np.ones((size, size))
    if kind == "patches":
        count = int(rng.integers(6, 40))
        centres = rng.uniform(0, size, (count, 2))
        place = np.indices((size, size)).reshape(2, -1).T
        nearest = ((place[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
        return rng.uniform(0.3, 1.0, count)[nearest].reshape(size, size)  # type: ignore[no-any-return]
    sigma = size / 8 if kind == "smooth" else 1.5
    field = ndimage.gaussian_filter(rng.standard_normal((size, size)), sigma)
    return np.exp(0.35 * np.clip(field / field.std(), -2, 2)) / 2  # type: ignore[no-any-return]


def _body(rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(normals (H, W, 3), mask) of a random body: an inflated outline times a depth, with waves on it."""
    y, x = (0.5 - (np.indices((size, size)) + 0.5) / size) * 2 * np.array([1, -1])[:, None, None]
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    outline = np.full(angle.shape, 0.78)
    for k in range(2, 6):
        outline += rng.normal(0, 0.12 / k) * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    mask = radius < np.minimum(outline, 0.96)
    mask = ndimage.binary_opening(mask, np.ones((3, 3)))
    h = np.pad(membrane(np.kron(mask, np.ones((2, 2), bool))), 1)
    waves = sum(
        rng.normal(0, 0.02) * size * np.cos(rng.normal(0, 7, 2) @ np.stack([x.ravel(), y.ravel()]) + rng.uniform(0, 7))
        for _ in range(5)
    )
    depth = np.exp(rng.normal(0, 0.3))
    down, right = np.gradient(h)
    root = 2 * np.maximum(np.sqrt(h), 1e-3)
    p, q = (_halved(image[1:-1, 1:-1]) for image in (depth * right / root, -depth * down / root))
    wave_down, wave_right = np.gradient(np.reshape(waves, (size, size)))
    n = np.stack([-(p + wave_right), -(q - wave_down), np.ones_like(p)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True), mask


def _halved(image: np.ndarray) -> np.ndarray:
    """Means over 2×2 pixels."""
    height, width = image.shape
    return image.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))  # type: ignore[no-any-return]
