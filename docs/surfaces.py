"""Make the pictures of docs/surfaces.md: python docs/surfaces.py [SIZE] → docs/images/surfaces_*.png."""

import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from huesphere.render.scene import render_scene

IMAGES = Path(__file__).parent / "images"
LIGHT = "[{direction: [0.6, 0.4, 1], spectrum: D65}, {direction: [-0.7, 0.3, 0.8], spectrum: D65, intensity: 0.4}]"
ALBEDO = {
    "texture: noise": "{reflectance: 0.8, texture: {kind: noise, range: [0.2, 1]}}",
    "texture: stripes": "{reflectance: 0.8, texture: {kind: stripes, period: 0.15, sharpness: 4, range: [0.2, 1]}}",
    "texture: cracks": "{reflectance: 0.8, texture: {kind: cracks, size: 0.25, range: [0.1, 1]}}",
    "texture: dirt": "{reflectance: 0.8, texture: {kind: dirt, range: [0.2, 1]}}",
    "mixture of blue sky and orange": "{mixture: [{reflectance: blue sky, weight: {kind: noise, size: 0.12, octaves: 2,"
    " contrast: 4}}, {reflectance: orange}]}",
}
GLOSS = {
    "lambertian": "{reflectance: orange}",
    "coated, roughness 0.1": "{kind: coated, reflectance: orange, roughness: 0.1}",
    "coated, roughness 0.4": "{kind: coated, reflectance: orange, roughness: 0.4}",
    "coated over stripes": "{kind: coated, reflectance: orange, roughness: 0.1, texture: {kind: stripes, period: 0.15,"
    " sharpness: 4, range: [0.3, 1]}}",
    "oren_nayar, sigma 40": "{kind: oren_nayar, reflectance: orange, sigma: 40}",
}


def strip(surfaces: dict[str, str], name: str, transport: str, size: int) -> None:
    """One bust for each surface, side by side, with the title that its key has in the config."""
    figure, axes = plt.subplots(1, len(surfaces), figsize=(2.6 * len(surfaces), 2.9), layout="constrained")
    for axis, (title, surface) in zip(axes, surfaces.items(), strict=True):
        with tempfile.TemporaryDirectory() as folder:
            settings = [f"camera.resolution=[{size},{size}]", f"lights={LIGHT}", f"surface={surface}"]
            settings += ["render.target_rms=0.01", f"render.transport=[{transport}]"]
            (item,) = render_scene("mozart_5gels", settings, folder)
            axis.imshow(plt.imread(item.folder / "preview.png"))
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    figure.savefig(IMAGES / f"{name}.png", dpi=100)


if __name__ == "__main__":
    size = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    strip(ALBEDO, "surfaces_albedo", "full", size)
    strip(GLOSS, "surfaces_gloss", "direct", size)
