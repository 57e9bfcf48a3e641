"""The estimate of ``auto`` where the picture's header tells of near lights, and why it may not be believed."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.geometry.blocks import block_means, whole_blocks
from huesphere.recover.geometry.tangent_uncertainty import DEG, expected_length, tangent_frames
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.near_lights import MEDIAN_LENGTH, Fitted, fit_near
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.pixels.noise import camera_noise
from huesphere.recover.pixels.usable import Pixels, usable_pixels
from huesphere.recover.reasons import Reason, interpolated
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import KnownLights, Observation

# Residual up to which a colour is explained: 2.5 standard deviations (median residuals).
NEAR_EXPLAINED_MEDIANS = 3.7

COARSE = 4000  # pixels of the object at which the starts are tried


@dataclass(frozen=True)
class NearOutcome:
    """How the fit under near lights ended."""

    explained: float  # share of the object whose colours it explains
    other_ratio: float  # residual of the surface turned inside out over that of the one taken


def has_known_near_lights(observation: Observation) -> bool:
    """Whether the header gives the positions of near lights, in a way that the method can use."""
    lights = observation.lights
    return lights is not None and len(lights.positions) > 0 and observation.camera.projection == "orthographic"


def recover_near(observation: Observation) -> tuple[Estimate, NearOutcome | None]:
    """Normals of every pixel under lights of known position (``recover.lights.near_lights``); None: it failed.

    Both starts are guesses from the outline alone: a dome, and for hollows the dome turned inside out.
    """
    try:
        if not has_known_near_lights(observation):
            raise RecoveryFailure("lights-not-told", "the picture's header gives the position of no near light")
        assert observation.lights is not None
        pixels = usable_pixels(observation)
        fit, other = _fitted(pixels, observation.lights)
    except RecoveryFailure as failure:
        return _empty(observation.mask, failure), None
    except (np.linalg.LinAlgError, RuntimeError) as error:  # of the sparse factors: exactly singular
        return _empty(observation.mask, RecoveryFailure("singular", str(error))), None
    level = float(np.quantile(pixels.rgb[pixels.usable].max(axis=-1), 0.99))
    known = camera_noise(observation.camera, level) if observation.camera.known else 0.0
    sigma = max(fit.median_residual / MEDIAN_LENGTH, known)
    turn = float(np.degrees(np.sqrt(np.trace(fit.rotation))))
    explained = pixels.usable & (
        np.nan_to_num(fit.residual) <= max(NEAR_EXPLAINED_MEDIANS * fit.median_residual, 2.5 * MEDIAN_LENGTH * known)
    )
    doubt = _doubt(fit, max(METHOD.near_most_residual * level, METHOD.near_most_noise * MEDIAN_LENGTH * known), turn)
    outcome = NearOutcome(float(explained.sum() / pixels.mask.sum()), other)
    told = {
        "colours": fit.colours.tolist(),
        "left": fit.median_residual,
        "left_other_way": other,
        "depth": float(fit.depth[pixels.mask].mean()),
        "explained": outcome.explained,
        "steps": fit.steps,
    }
    estimate = Estimate(
        method="",
        status="ok" if doubt is None else doubt.status,
        message="" if doubt is None else doubt.message,
        normals=fit.normals.astype(np.float32),
        valid=pixels.mask.copy(),
        inlier=explained,
        reason=np.where(pixels.mask, np.where(explained, Reason.KNOWN_LIGHTS, interpolated(pixels.lost)), 0).astype(
            np.uint8
        ),
        uncertainty_deg=_uncertainty(fit, pixels.mask, explained, sigma).astype(np.float32),
        diagnostics={
            "pixels": pixels.counts,
            "near": told,
            "noise": {"sigma": sigma, "from_fit": fit.median_residual / MEDIAN_LENGTH, "from_camera": known},
            "rotation_stderr_deg": turn,
        },
    )
    return estimate, outcome


def _doubt(fit: Fitted, most_left: float, turn_deg: float) -> RecoveryFailure | None:
    if fit.median_residual > most_left:
        return RecoveryFailure(
            "lights-unexplained", f"lights there leave {fit.median_residual:.2g} of the colours over"
        )
    if not fit.converged:
        return RecoveryFailure("no-convergence", f"depth still moved after {fit.steps} steps")
    if not turn_deg <= METHOD.near_undetermined_deg:
        return RecoveryFailure("rotation-undetermined", f"the rotation is known to {turn_deg:.2g}°")
    return None


def _fitted(pixels: Pixels, lights: KnownLights) -> tuple[Fitted, float]:
    """The fit from the better start, found on a coarse picture; what the other start left there over its own."""
    block = int(np.ceil(np.sqrt(pixels.mask.sum() / COARSE)))
    pad = [-side % block for side in pixels.mask.shape]
    mask = whole_blocks(pixels.mask, block, pad=True)
    usable = whole_blocks(pixels.usable, block, pad=True) & mask
    rgb = block_means(pixels.rgb, block, pad=True)
    shift = (-pad[1] / 2, pad[0] / 2, 0.0)
    small = KnownLights((lights.positions + shift) / block, lights.directions)
    dome = _dome(mask)
    starts = [fit_near(rgb, usable, mask, sign * dome, small) for sign in (1.0, -1.0)]
    hollow = starts[1].median_residual * METHOD.near_hollow_gain < starts[0].median_residual
    best, other = starts[::-1] if hollow else starts
    ratio = other.median_residual / max(best.median_residual, 1e-300)
    if block == 1:
        return best, ratio
    depth = block * _filled(best.depth, mask)
    at = (np.indices(pixels.mask.shape) + 0.5) / block - 0.5
    fine = ndimage.map_coordinates(depth, at, order=1, mode="nearest")
    return fit_near(pixels.rgb, pixels.usable, pixels.mask, fine, lights), ratio


def _dome(mask: np.ndarray) -> np.ndarray:
    """A dome over the outline (H, W), pixels, of mean 0: a ball over a disc."""
    inside = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    height = np.sqrt(inside * (2 * inside.max() - inside))
    return np.asarray(height - height[mask].mean())


def _filled(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image (H, W) with the value of the nearest pixel of ``mask`` off it."""
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    return np.asarray(image[tuple(nearest)])


def _uncertainty(fit: Fitted, mask: np.ndarray, explained: np.ndarray, sigma: float) -> np.ndarray:
    """Expected error in degrees (H, W), each pixel by its own colour; neighbours, who share the depth, lessen it."""
    frame = np.stack(tangent_frames(fit.normals[mask]), axis=-1)
    A = fit.F[mask] @ frame
    known = np.einsum("pki,pkj->pij", A, A) / max(sigma, 1e-12) ** 2 + (
        DEG / EVERY_PIXEL.interpolated_error_deg
    ) ** 2 * np.eye(2)
    spread = np.linalg.inv(known) + frame.transpose(0, 2, 1) @ fit.rotation @ frame
    own = expected_length(spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]) * DEG
    whole = np.full(mask.shape, np.nan)
    whole[mask] = np.where(explained[mask], own, np.maximum(own, EVERY_PIXEL.interpolated_error_deg))
    return whole


def _empty(mask: np.ndarray, failure: RecoveryFailure) -> Estimate:
    """The estimate of a failure: no normal anywhere."""
    nothing = np.full(mask.shape, np.nan, np.float32)
    return Estimate(
        method="",
        status=failure.status,
        message=failure.message,
        normals=np.full((*mask.shape, 3), np.nan, np.float32),
        valid=np.zeros(mask.shape, bool),
        inlier=np.zeros(mask.shape, bool),
        uncertainty_deg=nothing,
        reason=np.where(mask, Reason.NO_SOLUTION, Reason.BACKGROUND).astype(np.uint8),
    )
