"""The data of one picture for the inspector of the HTML page, as JSON: pixels, colours, lights, and estimates."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps

from huesphere.eval import maps
from huesphere.eval.cloud import ellipsoid_matrix, fitted_ellipsoid, sample_colours
from huesphere.eval.figures import picture
from huesphere.eval.maps import data_uri
from huesphere.eval.readout import pack_codes, pack_degrees, pack_fixed
from huesphere.eval.score import Case, Scene
from huesphere.eval.verdict import DOUBTFUL_DEG, doubtful_pixels
from huesphere.recover.reasons import REASONS

VIEW_PIXELS = 512  # longest side of a picture on the page; of a larger picture every k-th pixel is shown
NORMAL_DECIMALS, COLOUR_DECIMALS = 3, 4


def viewer_json(scene: Scene, cases: Sequence[Case], anchors: Sequence[str]) -> str:
    """Return the inspector's data as JSON that can stand in a ``<script>``: what has a meaning in HTML is escaped.

    Args:
        scene: the picture and its truth.
        cases: the methods on it; those without an estimate are left out.
        anchors: id of each case's section on the page.
    """
    height, width = scene.mask.shape
    step = maps.thinning((height, width), VIEW_PIXELS)
    rgb = scene.observation.rgb
    index = sample_colours(rgb, scene.mask)  # (N,) flat numbers of the pixels whose colours the cloud shows
    rho = rgb.reshape(-1, 3)[index].astype(np.float64)  # (N, 3) these colours
    truth = np.where(scene.mask[..., None], scene.truth.normals, np.nan)
    record: dict[str, Any] = {
        "id": scene.item.id,
        "size": [-(-height // step), -(-width // step)],
        "step": step,
        "preview": data_uri(picture(scene)[::step, ::step], 85),
        "picture": asdict(pack_fixed(rgb[::step, ::step], COLOUR_DECIMALS)),
        "truth": asdict(pack_fixed(truth[::step, ::step], NORMAL_DECIMALS)),
        "lights": _lights(scene.truth.facts.get("lights")),
        "colours": _rounded(rho),
        "cases": [
            _case(scene, case, anchor, step, index, rho)
            for case, anchor in zip(cases, anchors, strict=True)
            if case.estimate is not None
        ],
    }
    return str(htmlsafe_json_dumps(record, separators=(",", ":")))


def constants() -> dict[str, Any]:
    """Return the colours and texts of the inspector: the same as in the maps of figures/."""
    return {
        "low": maps.ERROR_SCALE.low,
        "high": maps.ERROR_SCALE.high,
        "palette": maps.palette(maps.ERROR_SCALE.colours).tolist(),
        "off": maps.OFF_OBJECT.tolist(),
        "declined": maps.DECLINED.tolist(),
        "doubtful_deg": DOUBTFUL_DEG,
        "stripe_every": maps.STRIPE_EVERY,
        "reasons": {int(code): text for code, (_, text) in REASONS.items()},
        "accepted": "#{:02x}{:02x}{:02x}".format(*maps.ACCEPTED_COLOUR),
        "rejected": "#{:02x}{:02x}{:02x}".format(*maps.REJECTED_COLOUR),
    }


def _case(scene: Scene, case: Case, anchor: str, step: int, index: np.ndarray, rho: np.ndarray) -> dict[str, Any]:
    """The inspector's data of one method; ``index`` (N,) are the sampled pixels, ``rho`` (N, 3) their colours."""
    assert case.estimate is not None
    estimate = case.estimate
    verdict = case.score.verdict
    normals = np.where((estimate.valid & scene.mask)[..., None], estimate.normals, np.nan)
    on = (estimate.inlier & scene.mask).ravel()[index]
    C = ellipsoid_matrix(estimate.solution)
    shape = None
    if C is not None and len(rho):
        fitted = fitted_ellipsoid(rho, on, C)
        shape = {"to_sphere": _rounded(fitted.to_sphere), "wire": _lines(fitted.wire)}
    return {
        "anchor": anchor,
        "method": case.score.row.method,
        "status": case.score.row.status,
        "median": case.score.row.median_deg if case.score.row.scored > 0 else None,
        "normals": asdict(pack_fixed(normals[::step, ::step], NORMAL_DECIMALS)),
        "error": pack_degrees(case.error_deg[::step, ::step]),
        "stated": pack_degrees(estimate.uncertainty_deg[::step, ::step].astype(np.float64)),
        "doubtful": pack_codes(doubtful_pixels(estimate, scene.mask)[::step, ::step]),
        "verdict": asdict(verdict) | {"sign": verdict.sign, "meaning": verdict.meaning},
        "reason": None if estimate.reason is None else pack_codes(estimate.reason[::step, ::step]),
        "on": "".join("01"[flag] for flag in on.astype(int)),
        "ellipsoid": shape,
        "lights": [_rounded(light.direction) for light in (estimate.lights.found if estimate.lights else ())],
    }


def _lights(lights: Any) -> list[dict[str, Any]]:
    """Name and unit direction of every light that has a direction, from the "lights" of a truth's facts."""
    found = []
    for number, light in enumerate(lights if isinstance(lights, list) else ()):
        direction = light.get("direction") if isinstance(light, dict) else None
        try:
            direction = np.asarray(direction, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        length = np.linalg.norm(direction) if direction.shape == (3,) else 0.0
        if 0 < length < np.inf:
            found.append({"name": str(light.get("name", number)), "direction": _rounded(direction / length)})
    return found


def _lines(wire: np.ndarray) -> list[Any]:
    """The lines in ``wire`` (P, 3), which rows of NaN separate, each as a list of points."""
    gaps = np.flatnonzero(np.isnan(wire[:, 0]))
    return [_rounded(line[~np.isnan(line[:, 0])]) for line in np.split(wire, gaps) if len(line) > 1]


def _rounded(values: np.ndarray) -> Any:
    """``values`` as lists, rounded to a ten-thousandth of the largest magnitude."""
    largest = float(np.abs(values).max(initial=0.0))
    decimals = 4 - int(np.ceil(np.log10(largest))) if largest > 0 else 0
    return np.round(values.astype(np.float64), decimals).tolist()
