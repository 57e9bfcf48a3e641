"""Make the picture of docs/recover/rig.md: python docs/rig.py TOUCH RESULT → docs/images/rig.png; prints the errors.

TOUCH is the run folder and RESULT the folder of results that the page's example makes: a key pressed into a rendered
tactile sensor, and its normals by the rig. Shown are the picture, the normals by the rig, the true ones, the angle
between them, and the depth by the rig.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from huesphere.recover.io.estimate import read_estimate
from huesphere.recover.rig.fit import angles_deg
from huesphere.render.dataset import open_run
from huesphere.scenes.encoding import encode_srgb

IMAGE = Path(__file__).parent / "images" / "rig.png"
ITEM = "tactile_gel-indenter_key/full"
SLOPED = 5.0  # degrees: true tilt from which a pixel counts as touched
MOST_SHOWN = 20.0  # degrees of error


def main(touch: Path, result: Path) -> None:
    [item] = [item for item in open_run(touch) if item.id == ITEM]
    truth, rgb = item.truth(), item.observation().rgb
    estimate, _ = read_estimate(result / "estimates", "rig")
    assert estimate.depth is not None
    error = angles_deg(estimate.normals.astype(float), truth.normals.astype(float))
    sloped = np.degrees(np.arccos(np.clip(truth.normals[..., 2], -1, 1))) > SLOPED
    stated = np.nanmean(estimate.uncertainty_deg[sloped])
    print(
        f"tilted over {SLOPED:g}°: {sloped.mean():.0%} of the picture, error {np.nanmedian(error[sloped]):.1f}° median,"
    )
    print(f"{np.nanmean(error[sloped]):.1f}° mean, stated {stated:.1f}°; whole picture {np.nanmean(error):.1f}° mean")
    figure, axes = plt.subplots(1, 5, figsize=(15, 2.9), layout="constrained")
    shown = {
        "picture": encode_srgb(np.clip(rgb, 0, 1)),
        "normals by the rig": (estimate.normals + 1) / 2,
        "true normals": (truth.normals + 1) / 2,
    }
    for axis, (title, image) in zip(axes, shown.items()):
        axis.imshow(np.clip(image, 0, 1))
        axis.set_title(title)
    for axis, title, values, limits in (
        (axes[3], "angle between them, degrees", error, (0, MOST_SHOWN)),
        (axes[4], "depth by the rig, pixels", estimate.depth, (None, None)),
    ):
        drawn = axis.imshow(values, vmin=limits[0], vmax=limits[1], cmap="viridis")
        axis.set_title(title)
        figure.colorbar(drawn, ax=axis, shrink=0.75)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.savefig(IMAGE, dpi=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
