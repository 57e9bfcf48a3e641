"""A run folder made by hand, with the repo's own writers and no renderer: evaluation from end to end."""

import hashlib
import json
from pathlib import Path

import numpy as np

from recover.estimate import Estimate, write_estimate
from render.dataset import Observation, Truth, write_observation, write_truth

LIGHTS = np.array([[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0]])
COLOURS = np.array([[0.60, 0.10, 0.05], [0.10, 0.50, 0.12], [0.05, 0.15, 0.55]])


def bump(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An ellipsoid with a dent: depth (H, W) in pixels, normals (H, W, 3), mask (H, W); analytic."""
    y, x = (size - 1) / 2 - np.mgrid[:size, :size][0], np.mgrid[:size, :size][1] - (size - 1) / 2
    a, b, c = 0.46 * size, 0.42 * size, 0.30 * size
    inside = 1 - (x / a) ** 2 - (y / b) ** 2
    mask = inside > 0.06
    root = np.sqrt(np.where(mask, inside, 1.0))
    s = 0.09 * size
    dent = 0.05 * size * np.exp(-((x - 0.1 * size) ** 2 + (y + 0.08 * size) ** 2) / (2 * s**2))
    depth = c * root - dent
    p = -c * x / a**2 / root + dent * (x - 0.1 * size) / s**2
    q = -c * y / b**2 / root + dent * (y + 0.08 * size) / s**2
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~mask], depth[~mask] = np.nan, np.nan
    return depth, normals, mask


def rotation(axis: str, degrees: float) -> np.ndarray:
    """Rotation by ``degrees`` about the axis "x", "y" or "z", right-handed."""
    i = "xyz".index(axis)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    R = np.eye(3)
    j, k = (i + 1) % 3, (i + 2) % 3
    R[j, j] = R[k, k] = c
    R[j, k], R[k, j] = -s, s
    return R


def fabricate_item(folder: Path, *, size: int = 64, noise: float = 0.0, methods: tuple[str, ...] = ()) -> None:
    """Write the files of one item under ``folder``: picture, truth, config, preview, no estimates."""
    import imageio.v3

    folder.mkdir(parents=True, exist_ok=True)
    depth, normals, mask = bump(size)
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    cosines = np.nan_to_num(normals) @ towards.T
    rgb = np.maximum(cosines, 0.0) @ COLOURS
    rgb = rgb + noise * np.random.default_rng(0).normal(size=rgb.shape)
    rgb = np.where(mask[..., None], rgb, 0.0).astype(np.float32)
    attached = (cosines <= 0).astype(np.float32)
    F = COLOURS.T @ towards
    truth = Truth(normals, depth, mask, attached, np.zeros_like(attached), facts={"F": F.tolist()})
    write_observation(folder / "observation.exr", Observation(rgb, mask))
    write_truth(folder / "truth.exr", truth)
    (folder / "config.yaml").write_text(f"name: fabricated\nrecover:\n  methods: {json.dumps(list(methods))}\n")
    imageio.v3.imwrite(folder / "preview.png", (255 * np.clip(rgb, 0, 1) ** (1 / 2.2)).astype(np.uint8))


def fabricate_run(run: Path, items: dict[str, dict[str, np.ndarray]], *, size: int = 64, noise: float = 0.0) -> None:
    """Write a run folder. ``items``: id -> {method: 3×3 matrix that turns the true normals into the estimate}."""
    entries = []
    for identity, methods in items.items():
        folder = run / identity
        fabricate_item(folder, size=size, noise=noise, methods=tuple(methods))
        for method, turn in methods.items():
            fabricate_estimate(folder, method, turn)
        entries.append(manifest_entry(run, identity))
    (run / "manifest.json").write_text(json.dumps({"format_version": 1, "versions": {}, "items": entries}))


def manifest_entry(run: Path, identity: str, status: str = "done") -> dict[str, object]:
    names = ("config.yaml", "observation.exr", "truth.exr", "preview.png") if status == "done" else ()
    paths = [run / identity / name for name in names]
    digest = [{"path": f"{identity}/{p.name}", "sha256": hashlib.sha256(p.read_bytes()).hexdigest()} for p in paths]
    return {"id": identity, "status": status, "seed": 0, "seconds": 1.0, "files": digest}


def fabricate_estimate(
    folder: Path, method: str, turn: np.ndarray, *, declined: float = 0.0, status: str = "ok"
) -> None:
    """Write an estimate: the true normals times ``turn``; the left share ``declined`` of the object is given up."""
    _, normals, mask = bump(size=_size(folder))
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    estimate = normals @ turn.T
    valid = mask.copy()
    valid.ravel()[np.flatnonzero(mask)[: round(declined * mask.sum())]] = False
    estimate[~valid] = np.nan
    inlier = valid & (np.nan_to_num(normals) @ towards.T > 0.0).all(axis=-1)
    F = COLOURS.T @ towards
    angles = np.linspace(0.0, 90.0, 91)
    curve = [list(0.2 + np.sin(np.radians(2 * (angles - a))) ** 2) for a in (20.0, 65.0)]
    diagnostics = {
        "C": np.linalg.inv(F @ F.T).tolist(),
        "F": F.tolist(),
        "r2": 0.9998,
        "alpha_curve": {"alpha_deg": angles.tolist(), "value": curve, "chosen": 20.0},
    }
    stated = np.where(valid, 1.0, np.nan).astype(np.float32)
    message = "" if status == "ok" else "the colours say too little: use more lights"
    made = Estimate(method, status, message, estimate, valid, inlier, stated, seconds=0.5, diagnostics=diagnostics)
    write_estimate(folder / "estimates", made, folder / "observation.exr")


def _size(folder: Path) -> int:
    from render.dataset import read_observation

    return read_observation(folder / "observation.exr").mask.shape[0]
