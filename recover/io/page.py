"""One picture's result on one page, and as plain images: normals, depth, the surface under another light.

For pictures from elsewhere, of which there is no truth: what was read and how, what the method says, how much hangs on
the encoding that was assumed. No network, no script; images are inside the page.
"""

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from huesphere.configs.own_folder import replacing, write_text
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.io.images import (
    depth_image,
    legend,
    normal_image,
    on_object,
    picture_image,
    reason_image,
    relit_image,
)
from huesphere.recover.reasons import shares
from huesphere.render.dataset import Observation

LIGHTS = {
    "from the left": (-1.0, 0.0, 1.0),
    "from the camera": (0.0, 0.0, 1.0),
    "from the right": (1.0, 0.0, 1.0),
    "from below": (0.0, -1.0, 1.0),
}
VIEWPORT = '<meta name="viewport" content="width=device-width, initial-scale=1">'
LONGEST = 640  # pixels of an image on the page; the files are whole
LONGEST_SHOWN = 1600  # pixels of a picture from which these are made: larger ones are thinned out
OPTIMISED = 2_000_000  # pixels of a file up to which it is made as small as can be, at four times the time
STYLE = """
:root{color-scheme:light dark;--text:#1b1f24;--soft:#57606a;--line:#d5dae0;--ground:#fff;--note:#f6f8fa;--mark:#0b5394}
@media (prefers-color-scheme: dark){
:root{--text:#e6e9ec;--soft:#a5adb6;--line:#3a424c;--ground:#14181d;--note:#1f252c;--mark:#6cb0f0}}
@media print{
:root{color-scheme:light;--text:#1b1f24;--soft:#57606a;--line:#d5dae0;--ground:#fff;--note:#f6f8fa;--mark:#0b5394}}
*{box-sizing:border-box}
body{margin:0;font:16px/1.5 system-ui,sans-serif;color:var(--text);background:var(--ground)}
main{max-width:1100px;margin:0 auto;padding:1rem 1.2rem 3rem}
h1{font-size:1.5rem;line-height:1.25;overflow-wrap:anywhere}h2{font-size:1.2rem;margin-top:2em}
p{max-width:46rem;overflow-wrap:anywhere}
.grid{display:grid;gap:1rem;grid-template-columns:repeat(auto-fill,minmax(min(100%,240px),1fr))}
figure{margin:0}img{width:100%;height:auto;display:block;border:1px solid var(--line)}
figcaption{font-size:.87rem;color:var(--soft)}
.note{background:var(--note);border-left:4px solid var(--mark);padding:.5rem 1rem}
@media print{figure{break-inside:avoid}}
"""


def write_sheet(
    folder: Path, title: str, how: str, observation: Observation, estimates: Sequence[Estimate], notes: Sequence[str]
) -> Path:
    """Write report.html and <method>-normals.png, -depth.png, -relit.png into ``folder``; returns the page.

    ``how``: a line on how the picture was read; ``notes``: sentences that stand above the figures.
    """
    step = -(-max(observation.mask.shape) // LONGEST_SHOWN)
    mask = observation.mask[::step, ::step]
    parts = [
        _figure("the picture", picture_image(replace(observation, rgb=observation.rgb[::step, ::step], mask=mask)))
    ]
    body = [f"<h1>{html.escape(title)}</h1>", f"<p>{html.escape(how)}</p>"]
    body += [f'<p class="note">{html.escape(note)}</p>' for note in notes]
    body += [f'<div class="grid">{"".join(parts)}</div>']
    for estimate in estimates:
        body += [f"<h2>{html.escape(estimate.method)}</h2>", f"<p>{html.escape(summary(estimate))}</p>"]
        images = {"accepted pixels": accepted_image(estimate.inlier[::step, ::step], mask)}
        if estimate.reason is not None:
            images[f"why: {legend(estimate.reason)}"] = reason_image(estimate.reason[::step, ::step])
        if estimate.valid.any():
            whole = _saved(folder / f"{estimate.method}-normals.png", normal_image(estimate.normals, observation.mask))
            images["normals: red right, green up, blue to the camera"] = whole[::step, ::step]
            normals = estimate.normals[::step, ::step]
            lit = {f"lit {name}": relit_image(normals, mask, np.array(d)) for name, d in LIGHTS.items()}
            images |= lit
            _saved(folder / f"{estimate.method}-relit.png", np.concatenate(list(lit.values()), axis=1))
        if estimate.depth is not None:
            whole = _saved(folder / f"{estimate.method}-depth.png", depth_image(estimate.depth))
            images["depth: bright is near"] = whole[::step, ::step]
        body.append(f'<div class="grid">{"".join(_figure(name, image) for name, image in images.items())}</div>')
    head = f'<meta charset="utf-8">{VIEWPORT}<title>{html.escape(title)}</title><style>{STYLE}</style>'
    page = folder / "report.html"
    write_text(
        page, f'<!doctype html><html lang="en"><head>{head}</head><body><main>{"".join(body)}</main></body></html>\n'
    )
    return page


def summary(estimate: Estimate) -> str:
    """What an estimate says of itself, in sentences."""
    told = f"Verdict: {estimate.verdict}."
    if estimate.status != "ok":
        told += f" Status {estimate.status}: {estimate.message}."
        if not estimate.valid.any():
            return f"{told} There are no normals."
    told += "".join(f" Also: {doubt}." for doubt in estimate.doubts[1:])
    share = estimate.valid.sum() / max(1, estimate.object_pixels)
    sure = float(np.nanmedian(estimate.uncertainty_deg[estimate.valid]))
    text = f"{told} Normals of {share:.0%} of the pixels, with {two_digits(sure)}° of error expected (median)."
    solution = estimate.solution
    if estimate.ellipsoid is not None and solution is not None:
        text += f" Robust R² {estimate.ellipsoid.r2:.4f}, cond(F) {two_digits(solution.condition)}."
    if estimate.reason is not None and estimate.valid.any():
        by_reason = [f"{share:.0%} {name}" for name, share in shares(estimate.reason).items() if share >= 0.005]
        text += f" Pixels by the reason of their normal: {', '.join(by_reason)}."
    if solution is not None and solution.convexity.evidence.startswith("none"):
        text += " Nothing in the picture tells bumps from dents: it is taken as convex."
    return text


def two_digits(value: float) -> str:
    """A positive number as people read it: two digits, and never an exponent for a large one."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def accepted_image(inlier: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Accepted pixels (H, W) blue, the others of the ``mask`` (H, W) orange, bytes."""
    return on_object(np.where(inlier[..., None], [0, 114, 178], [230, 159, 0]), mask)


def angle_between(a: Estimate, b: Estimate) -> float | None:
    """Median angle in degrees between two estimates' normals, where both give one; None where that is nowhere."""
    both = a.valid & b.valid
    if not both.any():
        return None
    m, n = a.normals[both].astype(float), b.normals[both].astype(float)
    angle = np.arctan2(np.linalg.norm(np.cross(m, n), axis=1), np.einsum("ni,ni->n", m, n))
    return float(np.degrees(np.median(angle)))


def _saved(path: Path, image: np.ndarray) -> np.ndarray:
    from PIL import Image

    small = image.shape[0] * image.shape[1] <= OPTIMISED
    with replacing(path) as partial:
        Image.fromarray(image).save(partial, "PNG", optimize=small, compress_level=9 if small else 1)
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
