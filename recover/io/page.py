"""One picture's result on one page, and as plain images: normals, depth, the surface under another light.

For pictures from elsewhere, of which there is no truth: what was read and how, what the method says, how much hangs on
the encoding that was assumed. No network, no script; images are inside the page.
"""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from huesphere.recover.io.estimate import Estimate
from huesphere.render.dataset import Observation
from huesphere.render.encoding import encode_srgb

LIGHTS = {
    "from the left": (-1.0, 0.0, 1.0),
    "from the camera": (0.0, 0.0, 1.0),
    "from the right": (1.0, 0.0, 1.0),
    "from below": (0.0, -1.0, 1.0),
}
WHITE, DECLINED = 255, (176, 190, 208)  # off the object; where the method gives no normal
VIEWPORT = '<meta name="viewport" content="width=device-width, initial-scale=1">'
LONGEST = 640  # pixels of an image on the page; the files are whole
STYLE = """
*{box-sizing:border-box}
body{margin:0;font:16px/1.5 system-ui,sans-serif;color:#1b1f24}
main{max-width:1100px;margin:0 auto;padding:1rem 1.2rem 3rem}
h1{font-size:1.5rem;line-height:1.25;overflow-wrap:anywhere}h2{font-size:1.2rem;margin-top:2em}
p{max-width:46rem;overflow-wrap:anywhere}
.grid{display:grid;gap:1rem;grid-template-columns:repeat(auto-fill,minmax(min(100%,240px),1fr))}
figure{margin:0}img{width:100%;height:auto;display:block;border:1px solid #d5dae0}
figcaption{font-size:.87rem;color:#57606a}
.note{background:#f6f8fa;border-left:4px solid #0b5394;padding:.5rem 1rem}
@media print{figure{break-inside:avoid}}
"""


def write_sheet(
    folder: Path, title: str, how: str, observation: Observation, estimates: Sequence[Estimate], notes: Sequence[str]
) -> Path:
    """Write report.html and <method>-normals.png, -depth.png, -relit.png into ``folder``; returns the page.

    ``how``: a line on how the picture was read; ``notes``: sentences that stand above the figures.
    """
    parts = [_figure("the picture", picture_image(observation))]
    body = [f"<h1>{html.escape(title)}</h1>", f"<p>{html.escape(how)}</p>"]
    body += [f'<p class="note">{html.escape(note)}</p>' for note in notes]
    body += [f'<div class="grid">{"".join(parts)}</div>']
    for estimate in estimates:
        body += [f"<h2>{html.escape(estimate.method)}</h2>", f"<p>{html.escape(summary(estimate))}</p>"]
        images = {"accepted pixels": accepted_image(estimate, observation.mask)}
        if estimate.valid.any():
            images["normals: red right, green up, blue to the camera"] = _saved(
                folder / f"{estimate.method}-normals.png", normal_image(estimate.normals, observation.mask)
            )
            for name, direction in LIGHTS.items():
                images[f"lit {name}"] = relit_image(estimate.normals, observation.mask, np.array(direction))
            strip = [relit_image(estimate.normals, observation.mask, np.array(d)) for d in LIGHTS.values()]
            _saved(folder / f"{estimate.method}-relit.png", np.concatenate(strip, axis=1))
        if estimate.depth is not None:
            images["depth: bright is near"] = _saved(
                folder / f"{estimate.method}-depth.png", depth_image(estimate.depth)
            )
        body.append(f'<div class="grid">{"".join(_figure(name, image) for name, image in images.items())}</div>')
    head = f'<meta charset="utf-8">{VIEWPORT}<title>{html.escape(title)}</title><style>{STYLE}</style>'
    page = folder / "report.html"
    page.write_text(
        f'<!doctype html><html lang="en"><head>{head}</head><body><main>{"".join(body)}</main></body></html>\n',
        encoding="utf-8",
    )
    return page


def summary(estimate: Estimate) -> str:
    """What an estimate says of itself, in sentences."""
    if estimate.status != "ok":
        told = f"Status {estimate.status}: {estimate.message}."
        if not estimate.valid.any():
            return f"{told} There are no normals."
    else:
        told = "Status ok."
    share = estimate.valid.sum() / max(1, estimate.diagnostics["pixels"]["object"])
    sure = float(np.nanmedian(estimate.uncertainty_deg[estimate.valid]))
    text = f"{told} Normals of {share:.0%} of the pixels, with {two_digits(sure)}° of error expected (median)."
    diagnostics = estimate.diagnostics
    if diagnostics.get("r2") is not None and diagnostics.get("cond_F") is not None:
        text += f" Robust R² {diagnostics['r2']:.4f}, cond(F) {two_digits(diagnostics['cond_F'])}."
    evidence = diagnostics.get("twin", {}).get("evidence", "")
    if evidence.startswith("none"):
        text += " Nothing in the picture tells bumps from dents: it is taken as convex."
    return text


def two_digits(value: float) -> str:
    """A positive number as people read it: two digits, and never an exponent for a large one."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def picture_image(observation: Observation) -> np.ndarray:
    """The picture as it is to be looked at, bytes; off the object white."""
    rgb = np.clip(np.nan_to_num(observation.rgb), 0, None)
    if observation.camera.stored_as == "linear":
        top = np.percentile(rgb[observation.mask], 99.5) if observation.mask.any() else 1.0
        rgb = rgb / max(float(top), 1e-12)
    rgb = encode_srgb(np.clip(rgb, 0, 1))
    return _on_object(np.round(255 * np.clip(rgb, 0, 1)), observation.mask)


def normal_image(normals: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Normals as colours (n + 1) / 2, bytes."""
    return _on_object(_declined(np.round(127.5 * normals + 127.5), normals), mask)


def relit_image(normals: np.ndarray, mask: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The surface in matte white under one distant light, bytes."""
    light = direction / np.linalg.norm(direction)
    shade = np.maximum(normals.astype(float) @ light, 0)[..., None]
    return _on_object(
        _declined(np.repeat(np.round(255 * encode_srgb(np.clip(np.nan_to_num(shade), 0, 1))), 3, axis=-1), normals),
        mask,
    )


def depth_image(depth: np.ndarray) -> np.ndarray:
    """Depth as grey, black at the 0.5th percentile and white at the 99.5th, bytes."""
    low, high = np.nanpercentile(depth, [0.5, 99.5])
    grey = np.clip((depth - low) / max(high - low, 1e-12), 0, 1)[..., None]
    return _on_object(np.repeat(np.round(255 * grey), 3, axis=-1), np.isfinite(depth))


def accepted_image(estimate: Estimate, mask: np.ndarray) -> np.ndarray:
    """Accepted pixels blue, rejected ones orange, bytes."""
    return _on_object(np.where(estimate.inlier[..., None], [0, 114, 178], [230, 159, 0]), mask)


def angle_between(a: Estimate, b: Estimate) -> float | None:
    """Median angle in degrees between two estimates' normals, where both give one; None where that is nowhere."""
    both = a.valid & b.valid
    if not both.any():
        return None
    m, n = a.normals[both].astype(float), b.normals[both].astype(float)
    angle = np.arctan2(np.linalg.norm(np.cross(m, n), axis=1), np.einsum("ni,ni->n", m, n))
    return float(np.degrees(np.median(angle)))


def _declined(image: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(normals).all(axis=-1)[..., None], np.nan_to_num(image), DECLINED)


def _on_object(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask[..., None], np.nan_to_num(image), WHITE).astype(np.uint8)


def _saved(path: Path, image: np.ndarray) -> np.ndarray:
    from PIL import Image

    Image.fromarray(image).save(path, optimize=True)
    return image


def _figure(caption: str, image: np.ndarray) -> str:
    from PIL import Image

    shown = Image.fromarray(image)
    if max(shown.size) < 160:  # a small region, enlarged by whole pixels
        factor = 320 // max(shown.size)
        shown = shown.resize((shown.width * factor, shown.height * factor), Image.Resampling.NEAREST)
    shown.thumbnail((LONGEST, LONGEST))
    buffer = io.BytesIO()
    shown.save(buffer, "PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    said = html.escape(caption)
    return f'<figure><img alt="{said}" src="data:image/png;base64,{data}"><figcaption>{said}</figcaption></figure>'


def normal_png(estimate: Estimate) -> bytes:
    """The normals as colours (n + 1) / 2, PNG bytes: what a notebook shows of an estimate."""
    from PIL import Image

    mask = estimate.valid if estimate.reason is None else estimate.reason > 0
    buffer = io.BytesIO()
    Image.fromarray(normal_image(estimate.normals, mask)).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
