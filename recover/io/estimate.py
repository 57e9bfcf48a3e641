"""What a method says of one picture, and how it lies on disk: <method>.exr (images) and <method>.json (the rest)."""

import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.exr import FORMAT_VERSION, read_exr, write_exr


@dataclass(frozen=True)
class Estimate:
    """Normals from one picture, with what is needed to judge them. Camera frame; invalid is NaN and not in ``valid``.

    A failed method (``status`` other than "ok") may still carry normals: evaluation scores and marks them.
    """

    method: str
    status: str  # "ok" or a named failure, such as "rank-deficient-colours"
    message: str  # one line: what failed and what would help; "" when ok
    normals: np.ndarray  # (H, W, 3) float32, unit, NaN where the method gives none
    valid: np.ndarray  # (H, W) bool, the method gives a normal here
    inlier: np.ndarray  # (H, W) bool, the colour lies on the fitted ellipsoid
    uncertainty_deg: np.ndarray  # (H, W) float32, expected angular error in degrees, NaN where not valid
    depth: np.ndarray | None = None  # (H, W) float32 pixels, toward the camera, mean 0; None: not asked for
    seconds: float = 0.0
    diagnostics: dict[str, Any] = field(default_factory=dict)  # JSON-able; keys in docs/format.md


def write_estimate(folder: Path, estimate: Estimate, observation_path: Path) -> None:
    """Write ``estimate`` under ``folder``, tied by sha256 to the picture that it was made from."""
    folder.mkdir(parents=True, exist_ok=True)
    channels = {f"normal.{a}": estimate.normals[..., i] for i, a in enumerate("XYZ")}
    channels |= {"valid": estimate.valid, "inlier": estimate.inlier, "uncertainty_deg": estimate.uncertainty_deg}
    if estimate.depth is not None:
        channels["depth.Z"] = estimate.depth
    write_exr(folder / f"{estimate.method}.exr", channels, {"format_version": FORMAT_VERSION})
    record = {
        "format_version": FORMAT_VERSION,
        "method": estimate.method,
        "status": estimate.status,
        "message": estimate.message,
        "seconds": estimate.seconds,
        "observation_sha256": hashlib.sha256(observation_path.read_bytes()).hexdigest(),
        "diagnostics": estimate.diagnostics,
    }
    partial = folder / f".{estimate.method}.json.partial"
    partial.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n")
    os.replace(partial, folder / f"{estimate.method}.json")


def read_estimate(folder: Path, method: str) -> tuple[Estimate, str]:
    """Read (estimate, sha256 of the picture that it was made from). Raises InputError if it is missing or damaged."""
    record_path = folder / f"{method}.json"
    try:
        record = json.loads(record_path.read_text(encoding="utf-8"))
        if record["format_version"] != FORMAT_VERSION:
            raise InputError(
                "format_version", got=record["format_version"], expected=str(FORMAT_VERSION), where=record_path
            )
        channels, _ = read_exr(folder / f"{method}.exr")
        estimate = Estimate(
            method=record["method"],
            status=record["status"],
            message=record["message"],
            normals=np.stack([channels[f"normal.{a}"] for a in "XYZ"], axis=-1),
            valid=channels["valid"] > 0.5,
            inlier=channels["inlier"] > 0.5,
            uncertainty_deg=channels["uncertainty_deg"],
            depth=channels.get("depth.Z"),
            seconds=record["seconds"],
            diagnostics=record["diagnostics"],
        )
        _check_types(estimate, method)
        return estimate, record["observation_sha256"]
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError("not a readable estimate", got=f"{type(error).__name__}: {error}", where=record_path) from None


def _check_types(estimate: Estimate, method: str) -> None:
    """Raise TypeError where a record holds something else than `write_estimate` writes."""
    wanted = {"method": str, "status": str, "message": str, "seconds": int | float, "diagnostics": dict}
    for name, kind in wanted.items():
        if not isinstance(getattr(estimate, name), kind):
            raise TypeError(f"{name} is {type(getattr(estimate, name)).__name__}")
    if estimate.method != method:
        raise TypeError(f"method is {estimate.method!r}, the file's name says {method!r}")
