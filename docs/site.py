"""Build the documentation: python docs/site.py [OUT]. Gallery and notebook are run, not written; no network.

Renders a few small scenes (minutes, the first time), runs the notebook, then Sphinx. Pages of studies are those that
`make studies` left in docs/studies.
"""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.load import load_config
from huesphere.configs.schema import RunConfig
from huesphere.eval import maps
from huesphere.eval.align import TWIN
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.run import recover_one
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.progress import shown_progress
from huesphere.render.run import render_configs

DOCS = Path(__file__).parent
SIZE = 144  # pixels of a picture in the gallery


@dataclass(frozen=True)
class Exhibit:
    """One row of the gallery: a packaged config, what is set in it, and what the pictures show."""

    title: str
    config: str
    settings: tuple[str, ...]
    transport: str
    method: str
    says: str


GELS = "mozart_5gels.yaml"
EXHIBITS = (
    Exhibit(
        "Five gels, cast shadows",
        GELS,
        (),
        "direct",
        "weak-integrability",
        "The usual case: a bust under lights 24 to 30° off the camera's axis.",
    ),
    Exhibit(
        "Five gels, all interreflection",
        GELS,
        (),
        "full",
        "weak-integrability",
        "The light that parts of the surface send to each other is two per cent of the picture.",
    ),
    Exhibit(
        "Interreflection removed",
        GELS,
        (),
        "full",
        "unbounce",
        "The same picture; the method computes its interreflection and subtracts it.",
    ),
    Exhibit(
        "Natural lights on skin",
        "mozart_5lights.yaml",
        (),
        "direct",
        "weak-integrability",
        "The lights have nearly the same colour: the condition number of F is 143. No noise.",
    ),
    Exhibit(
        "Natural lights, noise of 0.1 %",
        "mozart_5lights.yaml",
        ("camera.read_noise=1e-3",),
        "direct",
        "weak-integrability",
        "The previous picture with the noise of a good camera, which cond F multiplies.",
    ),
    Exhibit(
        "Lights far off the camera's axis",
        "mozart_wide_gels.yaml",
        (),
        "direct",
        "robust",
        "The lights are 55° off the camera's axis, and less than 60 % of the object sees every light.",
    ),
    Exhibit(
        "A bowl",
        GELS,
        ("shape={kind: bowl, opening: 35, detail: 64}",),
        "full",
        "unbounce",
        "The parts of a concave object light each other.",
    ),
    Exhibit(
        "A glossy coat",
        GELS,
        ("surface={kind: coated, reflectance: 0.6, roughness: 0.2}",),
        "direct",
        "weak-integrability",
        "The highlights of this rough coat are broad and add light to nearly every pixel. Pixels with most of "
        "it lie off the ellipsoid and get no normal; the others move the fit. With the true "
        "highlights (layer `light<i>.highlight`) subtracted from the picture, the median is 1.0°.",
    ),
    Exhibit(
        "Two reflectances",
        GELS,
        ("surface.checker={reflectance: 0.3, size: 0.4}",),
        "direct",
        "robust",
        "A surface with a chess board of two reflectances has two ellipsoids of one shape and two sizes.",
    ),
    Exhibit(
        "A random solid",
        GELS,
        ("shape={kind: sculpture, seed: 4}",),
        "full",
        "robust",
        "Overhangs, a tunnel, parts that hide each other and cast shadows. Every seed is another solid.",
    ),
    Exhibit(
        "The camera of a phone",
        GELS,
        ("camera.preset=phone",),
        "direct",
        "weak-integrability",
        "Lens blur, vignetting, a filter array and demosaicing, the noise of small pixels.",
    ),
    Exhibit(
        "A room with coloured walls",
        "room_coloured_walls.yaml",
        ("render.target_rms=5e-3",),
        "full",
        "weak-integrability",
        "No lamp shines directly on the bust: all light comes from the coloured walls.",
    ),
)


def gallery(exhibits: tuple[Exhibit, ...], out: Path, run: Path, *, size: int = SIZE) -> str:
    """Render and recover ``exhibits`` in ``run``, write a strip of each to ``out``; returns the page's Markdown."""
    from PIL import Image

    out.mkdir(parents=True, exist_ok=True)
    lines = [
        "# Gallery",
        "",
        "Each row shows a picture, its true normals, the normals recovered from the picture, as colours (n + 1) / 2,",
        "and the angle between true and recovered normals (0.01° to 90°, logarithmic; grey: no normal). Below it: the",
        "method, its median error over the pixels to which it gives a normal, their share of the object, and the",
        "commands that make the row.",
        "",
    ]
    for number, exhibit in enumerate(exhibits):
        folder = run / f"exhibit{number}" / _rendered(exhibit, run / f"exhibit{number}", size)
        observation, truth = read_observation(folder / "observation.exr"), read_truth(folder / "truth.exr")
        estimate = recover_one(observation, exhibit.method)
        error = np.full(truth.mask.shape, np.nan)
        given = estimate.valid & truth.mask
        error[given] = angular_error_deg(estimate.normals[given], truth.normals[given])
        with Image.open(folder / "preview.png") as preview:
            first = np.asarray(preview.convert("RGB"))
        images = [
            first,
            maps.normal_map(truth.normals, truth.mask),
            maps.normal_map(estimate.normals, truth.mask),
            maps.scalar_map(error, truth.mask, maps.ERROR_SCALE),
        ]
        gap = np.full((size, 4, 3), 255, np.uint8)
        strip = np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)
        Image.fromarray(strip).save(out / f"{number}.webp", quality=90)
        result = "no normals"
        if given.any():
            result = f"median {np.median(error[given]):.2g}° on {given.sum() / truth.mask.sum():.0%} of the object"
            twin = np.median(angular_error_deg(estimate.normals[given] @ TWIN, truth.normals[given]))
            if twin < np.median(error[given]) / 2:
                result += f" (taken as convex; turned inside out it is right to {twin:.2g}°)"
        settings = "".join(f" \\\n    --set '{s}'" for s in exhibit.settings)
        lines += [
            f"## {exhibit.title}",
            "",
            f"![picture, true normals, recovered normals, error]({out.name}/{number}.webp)",
            "",
            f"{exhibit.says} `{exhibit.method}`: {result}, status {estimate.status}.",
            "",
            "```",
            f"render --config {exhibit.config} --transport {exhibit.transport} --out gallery{number} \\",
            f"    --set camera.resolution=[{size},{size}]{settings}",
            f"evaluate gallery{number} --method {exhibit.method}",
            "```",
            "",
        ]
    return "\n".join(lines)


def _rendered(exhibit: Exhibit, run: Path, size: int) -> str:
    overrides = [*exhibit.settings, f"camera.resolution=[{size}, {size}]", f"render.transport=[{exhibit.transport}]"]
    config: RunConfig = load_config(exhibit.config, overrides=overrides)
    with shown_progress(exhibit.title) as progress:
        ids = render_configs([config], run, engine="auto", overwrite=False, progress=progress, log=print)
    return ids[0]


def notebook_page(notebook: Path, out: Path) -> str:
    """Run a notebook and return it as Markdown, its images written to ``out``. Raises CellExecutionError."""
    import base64

    import nbformat
    from nbclient import NotebookClient
    from traitlets.config import Config

    out.mkdir(parents=True, exist_ok=True)
    book = nbformat.read(notebook, as_version=4)
    NotebookClient(
        book,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(DOCS.parent)}},
        config=Config({"KernelManager": {"transport": "ipc"}}),
    ).execute()
    lines: list[str] = []
    for number, cell in enumerate(book.cells):
        if cell.cell_type == "markdown":
            lines += [cell.source, ""]
            continue
        lines += ["```python", cell.source, "```", ""]
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                (out / f"{notebook.stem}-{number}.png").write_bytes(base64.b64decode(data["image/png"]))
                lines += [f"![output of the cell above]({out.name}/{notebook.stem}-{number}.png)", ""]
            elif "text/plain" in data:
                lines += ["```", data["text/plain"], "```", ""]
            elif output.output_type == "stream" and output.name == "stdout":
                lines += ["```", output.text.rstrip(), "```", ""]
    lines += [f"The notebook: `docs/notebooks/{notebook.name}`."]
    return "\n".join(lines) + "\n"


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS.parent / "build" / "site"
    run = out.parent / "docs-run"
    page = gallery(EXHIBITS, DOCS / "gallery", run)
    (DOCS / "gallery.md").write_text(page, encoding="utf-8")
    page = notebook_page(DOCS / "notebooks" / "first_look.ipynb", DOCS / "notebook")
    (DOCS / "notebook.md").write_text(page, encoding="utf-8")
    subprocess.run([sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(out)], check=True)
    print(f"documentation: {out / 'index.html'}")


if __name__ == "__main__":
    main()
