"""What the page's inspector needs of one picture, as JSON: pixels packed, colours and lights, and its methods."""

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
from huesphere.recover.reasons import REASONS

VIEW_PIXELS = 512  # no side of a picture is longer on the page; a larger one is thinned, its pixels never mixed
NORMAL_DECIMALS, COLOUR_DECIMALS = 3, 4


def viewer_json(scene: Scene, cases: Sequence[Case], anchors: Sequence[str]) -> str:
    """Return the inspector's data as JSON that is safe inside a page.

    Args:
        scene: the picture and its truth.
        cases: methods on it; those without an estimate are left out.
        anchors: of each case on the page.
    """
    height, width = scene.mask.shape
    step = maps.thinning((height, width), VIEW_PIXELS)
    rgb = scene.observation.rgb
    index = sample_colours(rgb, scene.mask)
    rho = rgb.reshape(-1, 3)[index].astype(np.float64)
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
    """Return how the inspector colours numbers: the same as the maps in figures/."""
    return {
        "low": maps.ERROR_SCALE.low,
        "high": maps.ERROR_SCALE.high,
        "palette": maps.palette(maps.ERROR_SCALE.colours).tolist(),
        "off": maps.OFF_OBJECT.tolist(),
        "declined": maps.DECLINED.tolist(),
        "reasons": {int(code): text for code, (_, text) in REASONS.items()},
        "accepted": "#{:02x}{:02x}{:02x}".format(*maps.ACCEPTED_COLOUR),
        "rejected": "#{:02x}{:02x}{:02x}".format(*maps.REJECTED_COLOUR),
    }


def _case(scene: Scene, case: Case, anchor: str, step: int, index: np.ndarray, rho: np.ndarray) -> dict[str, Any]:
    assert case.estimate is not None
    estimate = case.estimate
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
        "reason": None if estimate.reason is None else pack_codes(estimate.reason[::step, ::step]),
        "on": "".join("01"[flag] for flag in on.astype(int)),
        "ellipsoid": shape,
        "lights": [_rounded(light.direction) for light in (estimate.lights.found if estimate.lights else ())],
    }


def _lights(lights: Any) -> list[dict[str, Any]]:
    """Name and unit direction of every light that has one, of what a truth or an estimate has written of them."""
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
    """Lines that rows of NaN part, (P, 3), each as a list of points."""
    gaps = np.flatnonzero(np.isnan(wire[:, 0]))
    return [_rounded(line[~np.isnan(line[:, 0])]) for line in np.split(wire, gaps) if len(line) > 1]


def _rounded(values: np.ndarray) -> Any:
    """As lists, rounded to a ten-thousandth of the largest magnitude."""
    largest = float(np.abs(values).max(initial=0.0))
    decimals = 4 - int(np.ceil(np.log10(largest))) if largest > 0 else 0
    return np.round(values.astype(np.float64), decimals).tolist()
