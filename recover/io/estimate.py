"""What a method says of one picture, and how it lies on disk: <method>.exr (images) and <method>.json (the rest).

Everything that a later stage, the page or the evaluator needs has a field of its own. ``diagnostics`` are for people:
they are written, and no code reads them back.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside, made_folder, write_text
from huesphere.configs.regular_file import ESTIMATE_BYTES, read_text
from huesphere.recover.io.images import normal_png
from huesphere.recover.lights.model import Light, Lights
from huesphere.recover.reasons import REASONS
from huesphere.recover.solution import Convexity, Solution
from huesphere.render.exr import FORMAT_VERSION, read_exr, write_exr
from huesphere.render.manifest import sha256_of


@dataclass(frozen=True)
class EllipsoidFit:
    """How well the ellipsoid fits the colours (report 2.2 and 4.2)."""

    s0: float  # robust dispersion of ρᵀCρ − 1 over the usable pixels, dimensionless
    r2: float  # robust coefficient of determination over them
    accepted: int  # pixels that the fit took


@dataclass(frozen=True)
class AngleCurves:
    """The report's Fig. 1(f): Eq. (18) and the left side of Eq. (19) over the angle α, for both choices of u1."""

    alpha_deg: np.ndarray  # (A,) degrees
    value: np.ndarray  # (2, A) Eq. (18), mean over the pixels
    condition: np.ndarray  # (2, A) the left side of Eq. (19)
    candidate: int  # which choice of u1 was taken
    chosen: float  # α that was taken, degrees

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "alpha_deg": self.alpha_deg.tolist(),
            "value": self.value.tolist(),
            "condition": self.condition.tolist(),
            "candidate": self.candidate,
            "chosen": self.chosen,
        }


@dataclass(frozen=True)
class Estimate:
    """Normals from one picture, with what is needed to judge them. Camera frame; invalid is NaN and not in ``valid``.

    A failed method (``status`` other than "ok") may still carry normals: evaluation scores and marks them.
    """

    method: str
    status: str  # "ok", or a named failure or doubt, such as "rank-deficient-colours"
    message: str  # one line: what failed and what would help; "" when ok
    normals: np.ndarray  # (H, W, 3) float32, unit, NaN where the method gives none
    valid: np.ndarray  # (H, W) bool, the method gives a normal here
    inlier: np.ndarray  # (H, W) bool, the colour lies on the fitted ellipsoid
    uncertainty_deg: np.ndarray  # (H, W) float32, angular error in degrees that is stated, NaN where not valid
    depth: np.ndarray | None = None  # (H, W) float32 pixels, toward the camera, mean 0; None: not asked for
    seconds: float = 0.0
    reason: np.ndarray | None = None  # (H, W) uint8, codes of ``recover.reasons``; None: of a method from elsewhere
    missed: np.ndarray | None = None  # (H, W) int32, bit j: the pixel misses light j of ``lights``; None: not asked
    albedo: np.ndarray | None = None  # (H, W) float32, brightness a of ρ = a F n, median 1; None: taken as uniform
    removed: np.ndarray | None = None  # (H, W, 3) indirect light that was subtracted, linear picture units; None: none
    solution: Solution | None = None  # F and what is known of it; None: the method ended before it had one
    lights: Lights | None = None  # lights that were found; None: none were looked for
    ellipsoid: EllipsoidFit | None = None
    curves: AngleCurves | None = None
    steps: tuple[str, ...] = ()  # of ``auto``: what it did, each with its reason
    doubts: tuple[str, ...] = ()  # what speaks against the normals, one line each, the gravest first
    diagnostics: dict[str, Any] = field(default_factory=dict)  # JSON-able, for people; keys in docs/format.md

    @property
    def verdict(self) -> str:
        """ "trust" where the status is "ok", else "doubtful" if normals are given and "failed" if not."""
        if self.status == "ok":
            return "trust"
        return "doubtful" if self.valid.any() else "failed"

    @property
    def object_pixels(self) -> int:
        """Pixels of the object, as far as the estimate knows it."""
        return int((self.valid if self.reason is None else self.reason > 0).sum())

    @property
    def rotation_stderr_deg(self) -> float:
        """Standard error of the rotation that all normals share, degrees; NaN without a solution."""
        return float("nan") if self.solution is None else self.solution.rotation_stderr_deg

    def __repr__(self) -> str:
        shares = f"{self.valid.sum() / max(1, self.object_pixels):.0%} of {self.object_pixels} pixels"
        sure = float(np.nanmedian(self.uncertainty_deg[self.valid])) if self.valid.any() else float("nan")
        return f"Estimate({self.method}, {self.status}: normals of {shares}, ±{sure:.2g}° expected)"

    def _repr_png_(self) -> bytes:
        """The normals as colours: what a notebook shows."""
        return normal_png(self.normals, self.valid if self.reason is None else self.reason > 0)


def write_estimate(folder: Path, estimate: Estimate, observation_path: Path) -> None:
    """Write ``estimate`` under ``folder``, tied by sha256 to the picture that it was made from."""
    made_folder(folder.parent, folder.name)
    channels = {f"normal.{a}": estimate.normals[..., i] for i, a in enumerate("XYZ")}
    channels |= {"valid": estimate.valid, "inlier": estimate.inlier, "uncertainty_deg": estimate.uncertainty_deg}
    for name, image in (
        ("depth.Z", estimate.depth),
        ("reason", estimate.reason),
        ("missed_lights", estimate.missed),
        ("albedo", estimate.albedo),
    ):
        if image is not None:
            channels[name] = image.astype(np.float32)
    write_exr(folder / f"{estimate.method}.exr", channels, {"format_version": FORMAT_VERSION})
    record = {
        "format_version": FORMAT_VERSION,
        "method": estimate.method,
        "status": estimate.status,
        "message": estimate.message,
        "verdict": estimate.verdict,
        "doubts": list(estimate.doubts),
        "seconds": estimate.seconds,
        "observation_sha256": sha256_of(observation_path),
        "solution": _solution_record(estimate.solution),
        "lights": None if estimate.lights is None else estimate.lights.record(),
        "ellipsoid": None if estimate.ellipsoid is None else vars(estimate.ellipsoid),
        "alpha_curve": None if estimate.curves is None else estimate.curves.record(),
        "steps": list(estimate.steps),
        "reasons": {str(int(code)): {"name": name, "text": text} for code, (name, text) in REASONS.items()},
        "diagnostics": estimate.diagnostics,
    }
    write_text(folder / f"{estimate.method}.json", json.dumps(record, indent=1, sort_keys=True) + "\n")


def read_estimate(folder: Path, method: str) -> tuple[Estimate, str]:
    """Read (estimate, sha256 of the picture that it was made from). Raises InputError if it is missing or damaged."""
    record_path = inside(folder.parent, folder.name, f"{method}.json")
    try:
        record = json.loads(read_text(record_path, most=ESTIMATE_BYTES, follow=False))
        if record["format_version"] != FORMAT_VERSION:
            raise InputError(
                "format_version", got=record["format_version"], expected=str(FORMAT_VERSION), where=record_path
            )
        channels, _ = read_exr(inside(folder, f"{method}.exr"))
        inlier = channels["inlier"] > 0.5
        estimate = Estimate(
            method=record["method"],
            status=record["status"],
            message=record["message"],
            normals=np.stack([channels[f"normal.{a}"] for a in "XYZ"], axis=-1),
            valid=channels["valid"] > 0.5,
            inlier=inlier,
            uncertainty_deg=channels["uncertainty_deg"],
            depth=channels.get("depth.Z"),
            seconds=record["seconds"],
            reason=_whole_numbers(channels.get("reason"), np.uint8),
            missed=_whole_numbers(channels.get("missed_lights"), np.int32),
            albedo=channels.get("albedo"),
            solution=_read_solution(record.get("solution"), inlier),
            lights=_read_lights(record.get("lights")),
            ellipsoid=_read_ellipsoid(record.get("ellipsoid")),
            curves=_read_curves(record.get("alpha_curve")),
            steps=tuple(str(step) for step in record.get("steps", ())),
            doubts=tuple(str(doubt) for doubt in record.get("doubts", ())),
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


# ---- records as JSON -------------------------------------------------------------------------------------------------


def _solution_record(solution: Solution | None) -> dict[str, Any] | None:
    """The solution as JSON. C and the rotation are for people: ``_read_solution`` derives both from F instead."""
    if solution is None:
        return None
    convexity = solution.convexity
    return {
        "F": solution.F.tolist(),
        "C": solution.C.tolist(),
        "rotation": solution.rotation.tolist(),
        "ambient": solution.ambient.tolist(),
        "noise": solution.noise,
        "fit_noise": solution.fit_noise,
        "rotation_covariance": solution.rotation_covariance.tolist(),
        "by_silhouette": solution.by_silhouette,
        "convexity": {
            "flipped": convexity.flipped,
            "margin": convexity.margin,
            "evidence": convexity.evidence,
            "turn": convexity.turn.tolist(),
        },
    }


def _read_solution(record: Any, inlier: np.ndarray) -> Solution | None:
    if record is None:
        return None
    convexity = record["convexity"]
    return Solution(
        F=_matrix(record["F"], (3, 3)),
        inlier=inlier,
        noise=float(record["noise"]),
        rotation_covariance=_matrix(record["rotation_covariance"], (3, 3)),
        fit_noise=float(record["fit_noise"]),
        convexity=Convexity(
            bool(convexity["flipped"]),
            float(convexity["margin"]),
            str(convexity["evidence"]),
            _matrix(convexity["turn"], (3, 3)),
        ),
        by_silhouette=bool(record["by_silhouette"]),
        ambient=_matrix(record["ambient"], (3,)),
    )


def _read_lights(record: Any) -> Lights | None:
    if record is None:
        return None
    found = tuple(
        Light(
            _matrix(light["direction"], (3,)),
            _matrix(light["colour"], (3,)),
            int(light["pixels"]),
            float(light["curl"]),
            float(light["attached_share"]),
        )
        for light in record["found"]
    )
    return Lights(found, float(record["missing"]))


def _read_ellipsoid(record: Any) -> EllipsoidFit | None:
    if record is None:
        return None
    return EllipsoidFit(float(record["s0"]), float(record["r2"]), int(record["accepted"]))


def _read_curves(record: Any) -> AngleCurves | None:
    if record is None:
        return None
    alpha = np.asarray(record["alpha_deg"], float)
    value, condition = (_matrix(record[name], (2, len(alpha))) for name in ("value", "condition"))
    return AngleCurves(alpha, value, condition, int(record["candidate"]), float(record["chosen"]))


def _matrix(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """``values`` as an array of that shape. Raises ValueError."""
    array = np.asarray(values, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"an array of shape {array.shape}, expected finite numbers of shape {shape}")
    return array


def _whole_numbers(channel: np.ndarray | None, kind: type) -> np.ndarray | None:
    return None if channel is None else np.round(np.nan_to_num(channel)).astype(kind)
