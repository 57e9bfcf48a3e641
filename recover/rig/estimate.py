"""The Estimate of a picture by a calibrated rig, with a verdict: does the picture fit the rig at all?

Nothing is searched, so nothing of the picture's ellipsoid can be judged. What can: the length of F⁻¹ρ, which the
direction of the normal does not use, must vary as little as in the calibration; and the normals must be those of a
surface, as the depth integrated from them shows.
"""

import time
from dataclasses import replace

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.pixels.noise import channel_noise
from huesphere.recover.reasons import Reason
from huesphere.recover.rig.calibrate import FEWEST_BALLS
from huesphere.recover.rig.fit import angles_deg
from huesphere.recover.rig.live import Rig, depth_of_normals
from huesphere.recover.rig.normals import stated_error_deg
from huesphere.recover.solution import Convexity, Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.recover.trust.verdict import MOST_MEDIAN_DEG
from huesphere.render.dataset import Observation
from huesphere.scenes.surfaces import depth_normals

METHOD = "rig"  # name of the estimate
LEAST_SPREAD = 0.03  # of log brightness: below, two pictures of one surface differ for reasons of no interest
DOUBTFUL, FAILED = 2.0, 5.0  # times the calibration's spread of brightness, from which a picture does not fit the rig
MOST_FACING_AWAY = 0.01  # share of normals with n3 ≤ 0
CURL_TIMES, CURL_DEG = 3.0, 2.0  # median angle to the integrated surface: so many stated errors, and at least so much
FEW_BALLS_TIMES = 4.0  # stated error, where position and normal cannot be told apart: 4.1 on a bust near its lamps
INTERPOLATED_TIMES = 2.0  # stated error of an interpolated normal over that of one by colour


def estimate_of(rig: Rig, observation: Observation) -> Estimate:
    """Normals, depth and verdict of an ``observation`` (linear light) of the rig's size. Raises InputError."""
    started = time.perf_counter()
    mask, camera = observation.mask, observation.camera
    found, known, rho = rig.found(observation.rgb)
    finite = np.isfinite(observation.rgb).all(axis=-1)
    clipped = np.zeros(mask.shape, bool)
    if camera.saturation is not None:
        clipped = finite & (observation.rgb >= camera.saturation).any(axis=-1)
    by_colour = mask & known & finite & ~clipped
    noise = channel_noise(rho.astype(np.float64), by_colour)
    error = stated_error_deg(rig.model, found, rig.inverse, noise)
    if rig.model.balls < FEWEST_BALLS[1]:
        error = np.minimum(FEW_BALLS_TIMES * error, 90)
    error = np.where(by_colour, error, np.minimum(INTERPOLATED_TIMES * error, 90)).astype(np.float32)
    valid = mask & finite & ~clipped & (found.normals[..., 2] > 0)
    reason = np.where(by_colour, Reason.ALL_LIT, Reason.INTERPOLATED).astype(np.uint8)
    reason[~(found.normals[..., 2] > 0)] = Reason.OUTLIER
    reason[clipped], reason[~finite], reason[~mask] = Reason.SATURATED, Reason.NOT_FINITE, Reason.BACKGROUND
    normals = np.where(valid[..., None], found.normals, np.nan).astype(np.float32)
    depth = _depth(normals, valid, mask)
    facts = _facts(rig, found.length, found.normals, by_colour)
    facts["integrable_deg"] = _integrable_deg(normals, depth, by_colour & valid)
    estimate = Estimate(
        method=METHOD,
        status="ok",
        message="",
        normals=normals,
        valid=valid,
        inlier=by_colour & valid,
        uncertainty_deg=np.where(valid, error, np.nan).astype(np.float32),
        depth=depth,
        reason=reason,
        solution=_solution(rig, by_colour & valid, noise),
        diagnostics={"rig": facts},
    )
    return replace(_judged(estimate, facts, rig), seconds=time.perf_counter() - started)


def _depth(normals: np.ndarray, valid: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
    """Depth of the object: at once where every pixel of the picture has a normal."""
    if not valid.any():
        return None
    if valid.all():
        return depth_of_normals(normals)
    return depth_from_normals(normals, valid, mask).astype(np.float32)  # type: ignore[no-any-return]


def _facts(rig: Rig, length: np.ndarray, normals: np.ndarray, used: np.ndarray) -> dict[str, float]:
    """What is measured of the fit of the picture to the rig."""
    if not used.any():
        return {"brightness": float("nan"), "brightness_spread": float("inf"), "facing_away": 1.0}
    log = np.log(np.maximum(length[used], 1e-6))
    middle = float(np.median(log))
    return {
        "brightness": float(np.exp(middle)),
        "brightness_spread": float(np.quantile(np.abs(log - middle), 0.95)),
        "facing_away": float((normals[used][:, 2] <= 0).mean()),
        "leave_one_out_deg": rig.model.leave_one_out_deg,
    }


def _integrable_deg(normals: np.ndarray, depth: np.ndarray | None, used: np.ndarray) -> float:
    """Median angle in degrees between the normals and those of the surface integrated from them."""
    if depth is None:
        return float("nan")
    mask = np.isfinite(depth)
    surface = depth_normals(np.where(mask, depth, 0.0).astype(np.float64), mask)
    used = used & ndimage.binary_erosion(mask, border_value=1)  # at the object's edge a slope is of one side only
    return float(np.median(angles_deg(normals[used].astype(float), surface[used]))) if used.any() else float("nan")


def _solution(rig: Rig, inlier: np.ndarray, noise: float) -> Solution:
    """F in the middle of the picture, with the model's error as that of the rotation."""
    covariance = np.radians(rig.model.error_deg[0]) ** 2 / 3 * np.eye(3)
    return Solution(
        rig.model.coefficients[0],
        inlier,
        noise,
        covariance,
        fit_noise=rig.model.noise,
        convexity=Convexity(margin=1.0, evidence="calibration"),
    )


def _judged(estimate: Estimate, facts: dict[str, float], rig: Rig) -> Estimate:
    """The estimate with its status and doubts; without normals where the picture is not one of this rig."""
    times = facts["brightness_spread"] / max(rig.model.spread, LEAST_SPREAD)
    doubts = []
    if not times <= DOUBTFUL:
        doubts.append(
            RecoveryFailure("rig-misfit", f"brightness varies {times:.1f} times as much as in the calibration")
        )
    if facts["facing_away"] > MOST_FACING_AWAY:
        found = f"{facts['facing_away']:.0%} of the normals face away from the camera"
        doubts.append(RecoveryFailure("facing-away", found))
    median = float(np.nanmedian(estimate.uncertainty_deg)) if estimate.valid.any() else float("nan")
    if facts["integrable_deg"] > max(CURL_TIMES * median, CURL_DEG):
        found = f"the normals are {facts['integrable_deg']:.1f}° (median) off those of any surface"
        doubts.append(RecoveryFailure("not-integrable", found))
    if rig.model.balls < FEWEST_BALLS[1]:
        found = f"{rig.model.balls} ball(s) do not show how F depends on position, give {FEWEST_BALLS[1]} or more"
        doubts.append(RecoveryFailure("uncertain", found))
    if median > MOST_MEDIAN_DEG:
        doubts.append(RecoveryFailure("uncertain", f"an error of {median:.1f}° is expected (median)"))
    if not estimate.valid.any() and not doubts:
        doubts.append(RecoveryFailure("saturated", "no pixel has a colour that can be used"))
    if not doubts:
        return estimate
    estimate = replace(
        estimate, status=doubts[0].status, message=doubts[0].message, doubts=tuple(doubt.message for doubt in doubts)
    )
    if times <= FAILED:
        return estimate
    nowhere = np.zeros_like(estimate.valid)
    assert estimate.reason is not None
    return replace(
        estimate,
        normals=np.full_like(estimate.normals, np.nan),
        uncertainty_deg=np.full_like(estimate.uncertainty_deg, np.nan),
        valid=nowhere,
        inlier=nowhere,
        depth=None,
        solution=None,
        reason=np.where(estimate.reason > 0, Reason.NO_SOLUTION, Reason.BACKGROUND).astype(np.uint8),
    )
