"""Pictures for the studies: rendered by the ordinary pipeline, or computed directly from normals and light colours."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from huesphere.configs.load import validate
from huesphere.configs.schema import RunConfig
from huesphere.eval.align import best_orthogonal
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.geometry.root import symmetric_root
from huesphere.render.dataset import CameraInfo, Observation, Truth, read_observation, read_truth
from huesphere.render.layers import Layers, read_layers

Log = Callable[[str], None]
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Rendered:
    """The files of one item of a run folder, read into memory."""

    observation: Observation
    truth: Truth
    layers: Layers
    folder: Path  # of the item

    @property
    def mask(self) -> np.ndarray:
        """Object pixels with a true normal, (H, W) bool."""
        return self.truth.mask & np.isfinite(self.truth.normals).all(axis=-1)

    @property
    def F(self) -> np.ndarray:
        """The true matrix (3, 3) in ρ = F n for pixels that see every light, in picture units."""
        return np.asarray(self.truth.facts["F"], dtype=np.float64)

    @property
    def sees_all(self) -> np.ndarray:
        """Object pixels from which every light is seen, (H, W) bool."""
        return self.mask & (self.truth.attached_shadow.max(axis=-1) <= 0) & (self.truth.cast_shadow.max(axis=-1) <= 0)


def config_of(data: dict[str, Any], where: str) -> RunConfig:
    """The validated config of a scene from a mapping. ``where`` names its place in messages. Raises InputError."""
    return validate(data, where=where)


def render(configs: Sequence[RunConfig], run: Path, log: Log, *, overwrite: bool = False) -> list[str]:
    """Render configs into the run folder ``run`` and return the items' ids. Items that exist are kept."""
    from huesphere.render.progress import shown_progress
    from huesphere.render.run import render_configs

    with shown_progress("rendering") as progress:
        return render_configs(configs, run, engine="auto", overwrite=overwrite, progress=progress, log=log)


def read(run: Path, item: str) -> Rendered:
    """Read the item with this id, <config>/<transport>, from the run folder ``run``."""
    folder = run / item
    return Rendered(
        read_observation(folder / "observation.exr"),
        read_truth(folder / "truth.exr"),
        read_layers(folder / "layers.exr"),
        folder,
    )


def read_image(path: Path) -> np.ndarray:
    """The picture file as display-encoded bytes (H, W, 3)."""
    from PIL import Image

    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def ball(size: int, *, centre_deg: float = 0.0, radius_deg: float = 75.0) -> tuple[np.ndarray, np.ndarray]:
    """(normals (H, W, 3), mask (H, W)) of a unit sphere that fills a picture of ``size`` × ``size`` pixels.

    The mask holds the normals within ``radius_deg`` of a direction in the xz plane, ``centre_deg`` off the camera's
    axis. Exact, in the camera frame.
    """
    row, column = np.mgrid[:size, :size]
    half = (size - 1) / 2
    x, y = (column - half) / (0.98 * half), (half - row) / (0.98 * half)
    square = 1 - x * x - y * y
    normals = np.stack([x, y, np.sqrt(np.maximum(square, 0))], axis=-1)
    turn = np.radians(centre_deg)
    toward = normals @ np.array([np.sin(turn), 0.0, np.cos(turn)])
    return normals, (square > 1e-3) & (toward > np.cos(np.radians(radius_deg)))


def lights_around(tilt_deg: float, azimuths_deg: ArrayLike) -> np.ndarray:
    """Unit directions (L, 3), camera frame, toward lights at the off-axis angle ``tilt_deg`` and azimuths (L,)."""
    tilt, azimuth = np.radians(tilt_deg), np.radians(np.asarray(azimuths_deg, float))
    return np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt) + 0 * azimuth], -1)


def shaded(
    normals: np.ndarray,
    mask: np.ndarray,
    directions: np.ndarray,
    colours: np.ndarray,
    *,
    ambient: np.ndarray | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> tuple[Observation, np.ndarray]:
    """(picture, F (3, 3)) of ρ = Σ max(0, a·n) b + s, Eq. (2), without cast shadows.

    ``normals`` (H, W, 3) and ``mask`` (H, W) of the object; ``directions`` a (L, 3) and ``colours`` b (L, 3) of the
    lights. The exposure makes the brightest pixels 0.9 of full scale. ``ambient`` s (3,) and ``noise``, the standard
    deviation of a channel, are in units of the exposed picture. F is that of pixels that see every light.
    """
    rgb = np.maximum(np.nan_to_num(normals) @ directions.T, 0.0) @ colours
    gain = 0.9 / np.percentile(rgb[mask].max(axis=-1), 99.9)
    rgb = gain * rgb + (0.0 if ambient is None else ambient)
    rgb = rgb + noise * np.random.default_rng(seed).standard_normal(rgb.shape)
    camera = CameraInfo(read_noise=noise)
    picture = np.where(mask[..., None], rgb, 0.0).astype(np.float32)
    return Observation(picture, mask, camera), gain * colours.T @ directions


def ellipsoid_error_deg(C: np.ndarray, F: np.ndarray, normals: np.ndarray) -> float:
    """Median angle in degrees of N = C^½ F n to the true normals n (N, 3), after the best orthogonal alignment.

    This is the error that the ellipsoid C (3, 3) causes by itself, when the rotation is the best possible one.
    """
    N = normals @ F.T @ symmetric_root(C)
    N = N / np.linalg.norm(N, axis=1, keepdims=True)
    return float(np.median(angular_error_deg(N @ best_orthogonal(N, normals).T, normals)))


def median_error_deg(normals: np.ndarray, valid: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Median angle in degrees between two normal maps (H, W, 3) over the ``valid`` pixels of the ``mask`` (H, W).

    NaN where there are no such pixels.
    """
    given = valid & mask
    return float(np.median(angular_error_deg(normals[given], truth[given]))) if given.any() else float("nan")


def median(values: np.ndarray) -> float:
    """Median of the finite ones of ``values``; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def text(value: float, digits: int = 2) -> str:
    """``value`` with ``digits`` significant digits, as a power of ten only below 0.0001 and from 100 000 on.

    "–" if it is not finite.
    """
    if not np.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value))))) if value else 0
        return f"{value:.{decimals}f}".replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10{str(int(exponent)).translate(RAISED)}".replace("-", "−")


def percent(share: float, digits: int = 0) -> str:
    """A share, 0 to 1, as "12 %", with ``digits`` decimals; "–" if it is not finite."""
    return f"{100 * share:.{digits}f} %" if np.isfinite(share) else "–"
