"""Make the README's pictures: python docs/pictures.py RUN_DIR (of mozart_5lights, evaluated) → docs/images/*.png."""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from huesphere.recover.io.estimate import read_estimate
from huesphere.render.dataset import read_truth

METHOD = "weak-integrability"
IMAGES = Path(__file__).parent / "images"


def strip(run: Path, item: str) -> None:
    """Picture, true normals, recovered normals and their angle, side by side."""
    folder = run / item
    truth = read_truth(folder / "truth.exr")
    estimate, _ = read_estimate(folder / "estimates", METHOD)
    cosine = np.clip(np.sum(truth.normals * estimate.normals, axis=-1), -1, 1)
    error = np.degrees(np.arccos(cosine))
    figure, axes = plt.subplots(1, 4, figsize=(12, 3.3), layout="constrained")
    panels = [
        ("one colour picture", plt.imread(folder / "preview.png")),
        ("true normals", as_colour(truth.normals)),
        (f"recovered ({METHOD})", as_colour(estimate.normals)),
        ("angle between them, degrees", error),
    ]
    for axis, (title, image) in zip(axes, panels, strict=True):
        shown = axis.imshow(
            image, cmap="viridis", vmin=0, vmax=None if image.ndim == 3 else np.nanpercentile(error, 99)
        )
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    figure.colorbar(shown, ax=axes[-1], shrink=0.8)
    IMAGES.mkdir(exist_ok=True)
    figure.savefig(IMAGES / f"{item.replace('/', '_')}.png", dpi=110)


def as_colour(normals: np.ndarray) -> np.ndarray:
    """Normals as RGB: x, y, z from −1…1 to 0…1; white where there is none."""
    return np.where(np.isfinite(normals), normals / 2 + 0.5, 1.0)


if __name__ == "__main__":
    for transport in ("direct", "full"):
        strip(Path(sys.argv[1]), f"mozart_5lights/{transport}")
