"""The estimate of ``auto`` where the picture's header tells of near lights, and why it may not be believed."""

import numpy as np
from scipy import ndimage

from huesphere.recover.every_pixel.completion import BETWEEN_DEG
from huesphere.recover.geometry.tangent_uncertainty import DEG, expected_length, tangent_frames
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.near_lights import TYPICAL, Fitted, fit_near
from huesphere.recover.pixels.noise import camera_noise
from huesphere.recover.pixels.usable import Pixels, usable_pixels
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation, ToldLights

COARSE = 4000  # pixels of the object at which the starts are tried
TOLD = 1.3  # times less left over: the hollow is taken before the dome
EXPLAINED = 3.7  # median residuals up to which the fit explains a colour: 2.5 standard deviations
MOST_LEFT, MOST_NOISE = 0.004, 3.0  # of the brightest colour, or times the camera's noise: more is no noise
LARGEST_TURN_DEG = 9.0  # standard error of the rotation


def tells_near(observation: Observation) -> bool:
    """Whether the header tells of near lights, in a way that the method can use."""
    lights = observation.lights
    return lights is not None and len(lights.positions) > 0 and observation.camera.projection == "orthographic"


def recover_near(observation: Observation) -> Estimate:
    """Normals of every pixel under lights of which the places are told (``recover.lights.near_lights``).

    Every start is a guess from the outline alone: a dome, and for hollows the dome turned inside out.
    """
    shape = observation.mask.shape
    try:
        if not tells_near(observation):
            raise RecoveryFailure("lights-not-told", "the picture's header tells of no near light")
        assert observation.lights is not None
        pixels = usable_pixels(observation)
        fit, other = _fitted(pixels, observation.lights)
    except RecoveryFailure as failure:
        return _empty(shape, failure)
    except (np.linalg.LinAlgError, RuntimeError) as error:  # of the sparse factors: exactly singular
        return _empty(shape, RecoveryFailure("singular", str(error)))
    level = float(np.quantile(pixels.rgb[pixels.usable].max(axis=-1), 0.99))
    known = camera_noise(observation.camera, level) if observation.camera.known else 0.0
    sigma = max(fit.left / TYPICAL, known)
    turn = float(np.degrees(np.sqrt(np.trace(fit.rotation))))
    explained = pixels.usable & (np.nan_to_num(fit.residual) <= max(EXPLAINED * fit.left, 2.5 * TYPICAL * known))
    doubt = _doubt(fit, max(MOST_LEFT * level, MOST_NOISE * TYPICAL * known), turn)
    told = {
        "colours": fit.colours.tolist(),
        "left": fit.left,
        "left_other_way": other,
        "depth": float(fit.depth[pixels.mask].mean()),
        "explained": float(explained.sum() / pixels.mask.sum()),
        "steps": fit.steps,
    }
    return Estimate(
        method="near",
        status="ok" if doubt is None else doubt.status,
        message="" if doubt is None else doubt.message,
        normals=fit.normals.astype(np.float32),
        valid=pixels.mask.copy(),
        inlier=explained,
        uncertainty_deg=_uncertainty(fit, pixels.mask, explained, sigma).astype(np.float32),
        diagnostics={
            "pixels": pixels.counts,
            "near": told,
            "noise": {"sigma": sigma, "from_fit": fit.left / TYPICAL, "from_camera": known},
            "rotation_stderr_deg": turn,
        },
    )


def _doubt(fit: Fitted, most_left: float, turn_deg: float) -> RecoveryFailure | None:
    if fit.left > most_left:
        return RecoveryFailure("lights-unexplained", f"lights there leave {fit.left:.2g} of the colours over")
    if not fit.settled:
        return RecoveryFailure("no-convergence", f"depth still moved after {fit.steps} steps")
    if not turn_deg <= LARGEST_TURN_DEG:
        return RecoveryFailure("rotation-undetermined", f"the rotation is known to {turn_deg:.2g}°")
    return None


def _fitted(pixels: Pixels, lights: ToldLights) -> tuple[Fitted, float]:
    """The fit from the better start, found on a coarse picture; what the other start left there over its own."""
    block = int(np.ceil(np.sqrt(pixels.mask.sum() / COARSE)))
    pad = _padding(pixels.mask.shape, block)
    mask = np.asarray(_blocks(pixels.mask, block).all(axis=(1, 3)))
    usable = _blocks(pixels.usable, block).all(axis=(1, 3)) & mask
    rgb = _blocks(pixels.rgb, block).mean(axis=(1, 3))
    shift = (-pad[1] / 2, pad[0] / 2, 0.0)
    small = ToldLights((lights.positions + shift) / block, lights.directions)
    dome = _dome(mask)
    starts = [fit_near(rgb, usable, mask, sign * dome, small) for sign in (1.0, -1.0)]
    hollow = starts[1].left * TOLD < starts[0].left
    best, other = starts[::-1] if hollow else starts
    ratio = other.left / max(best.left, 1e-300)
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


def _padding(shape: tuple[int, ...], block: int) -> tuple[int, int]:
    return -shape[0] % block, -shape[1] % block


def _blocks(image: np.ndarray, block: int) -> np.ndarray:
    """(h, block, w, block, …) of an image (H, W, …), continued by zeros to the right and below."""
    down, right = _padding(image.shape, block)
    image = np.pad(image, ((0, down), (0, right), *((0, 0),) * (image.ndim - 2)))
    return image.reshape(image.shape[0] // block, block, image.shape[1] // block, block, *image.shape[2:])


def _uncertainty(fit: Fitted, mask: np.ndarray, explained: np.ndarray, sigma: float) -> np.ndarray:
    """Expected error in degrees (H, W), each pixel by its own colour; neighbours, who share the depth, lessen it."""
    frame = np.stack(tangent_frames(fit.normals[mask]), axis=-1)
    A = fit.F[mask] @ frame
    known = np.einsum("pki,pkj->pij", A, A) / max(sigma, 1e-12) ** 2 + (DEG / BETWEEN_DEG) ** 2 * np.eye(2)
    spread = np.linalg.inv(known) + frame.transpose(0, 2, 1) @ fit.rotation @ frame
    own = expected_length(spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]) * DEG
    whole = np.full(mask.shape, np.nan)
    whole[mask] = np.where(explained[mask], own, np.maximum(own, BETWEEN_DEG))
    return whole


def _empty(shape: tuple[int, ...], failure: RecoveryFailure) -> Estimate:
    nothing = np.full(shape, np.nan, np.float32)
    return Estimate(
        method="near",
        status=failure.status,
        message=failure.message,
        normals=np.full((*shape, 3), np.nan, np.float32),
        valid=np.zeros(shape, bool),
        inlier=np.zeros(shape, bool),
        uncertainty_deg=nothing,
    )
