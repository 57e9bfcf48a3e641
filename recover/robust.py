"""The shell of method ``robust``: searched for on a small grid, chosen, then polished on the whole picture.

On the small grid (block means, which also average the noise) all shells of the picture are grown (``recover.shells``),
the report's LMS being one more seed. The chosen one is refitted to its own pixels at full size, the noise's bias out.
"""

from dataclasses import dataclass

import numpy as np

from recover.all_lit import LIKELY, OnShell
from recover.ellipsoid import Fit, fit_accepted, least_median_of_squares
from recover.faint import without_faint
from recover.pixels import Pixels, camera_noise
from recover.polish import residual_scales, signed_distance
from recover.rays import block_means, rays
from recover.rivals import without_rivals
from recover.shells import Shell, clear_margin, find_shells, picture_noise, refine, working_grid
from recover.status import RecoveryFailure
from render.dataset import CameraInfo

LEAST_SUPPORT = 0.06  # of the usable pixels: less than this is what grows by chance when the noise is taken too low
LOUDER, LOUDEST = 2.0, 16.0  # steps and end of the search for a noise at which something grows
LOOKS, LEAST_LIKELY = 2, 0.3  # looks at which pixels see every light; how many they must be, of the core
ROUNDING = 2e-4  # of the brightest: least noise, so that single precision and curvature within a block do not count


@dataclass(frozen=True)
class ChosenShell:
    """The ellipsoid taken for that of the all-lit pixels, and how clear the choice was."""

    fit: Fit
    inlier: np.ndarray  # (H, W) bool
    near: np.ndarray  # (H, W) bool, these and those that lie on it to within noise though they miss a light
    noise: float  # standard deviation of the distance to it, picture units
    share: float  # of the usable pixels that lie on it
    margin: float  # score over that of the best shell that is clearly another; inf if there is none
    candidates: int
    told: bool  # its pixels are told from strangers one by one; else there are some along its edge
    faint: int  # lights that some of its pixels missed by less than noise, and were left out for


def choose_shell(pixels: Pixels, camera: CameraInfo) -> ChosenShell:
    """The shell of the pixels that see every light. Raises RecoveryFailure: no-dominant-shell and those of the fit."""
    small, usable, block = working_grid(pixels.rgb, pixels.usable)
    ray = block_means(rays(camera, pixels.usable.shape), block)
    noise = _noise(pixels, camera)
    shells = without_rivals(small, usable, _grown(small, usable, noise / block, ray), noise / block, ray)
    best = shells[0]
    margin = clear_margin(shells)
    C, core = refine(pixels.rgb, pixels.usable, best.C, noise=noise)
    white, shared = residual_scales(signed_distance(pixels.rgb[core], C), core)
    # A camera that tells its noise is believed here too: where the weakest colour drowns, the fit itself hides some.
    known = noise if camera.known else 0.0
    near, faint, told = core, 0, shared < white
    if told:  # else an error of the model would be taken for lights
        scatter, grain = float(np.hypot(white, shared)), max(white, known)
        C, core, faint = without_faint(pixels.rgb, core, C, noise=scatter, grain=grain)
        white, shared = residual_scales(signed_distance(pixels.rgb[core], C), core)
    try:
        fit = fit_accepted(pixels.rgb[pixels.usable], core[pixels.usable], noise=max(white, known))
    except RecoveryFailure:
        fit = fit_accepted(pixels.rgb[pixels.usable], core[pixels.usable], noise=white)
    scatter = float(np.hypot(white, shared))
    if told:
        core = _all_lit(pixels, core, fit.C, scatter)
        near = near | core
    share = float(core.sum() / pixels.usable.sum())
    return ChosenShell(fit, core, near, scatter, share, margin, len(shells), told, faint)


def _all_lit(pixels: Pixels, core: np.ndarray, C: np.ndarray, scatter: float) -> np.ndarray:
    """Pixels (H, W) that see every light, told from the ``core`` (H, W) of the shell C by looks at all that are on it.

    ``scatter`` is the standard deviation of the distance to it. C stays that of the core, which was not chosen by it.
    """
    shell = OnShell(pixels.rgb, pixels.usable, C, noise=scatter)
    for _ in range(LOOKS):
        likely = shell.probability(core) > LIKELY
        if likely.sum() < LEAST_LIKELY * core.sum():
            break
        core = likely
    return core


def _noise(pixels: Pixels, camera: CameraInfo) -> float:
    """Noise of a channel of the whole picture: the camera's where it is known, else the picture's own grain."""
    bright = pixels.rgb[pixels.usable]
    known = camera_noise(camera, float(np.median(bright))) if camera.known else 0.0
    own = picture_noise(pixels.rgb, pixels.usable)
    # Grain holds texture too: a camera that tells its noise is believed, up to rounding.
    return max(known if known > 0 else own, ROUNDING * float(bright.max()))


def _grown(small: np.ndarray, usable: np.ndarray, noise: float, ray: np.ndarray | None) -> list[Shell]:
    """The shells found, at the least noise from ``noise`` up at which one of some size is."""
    try:
        extra = [least_median_of_squares(small[usable])]
    except RecoveryFailure:
        extra = []
    factor = 1.0
    while True:
        shells = find_shells(small, usable, noise=factor * noise, extra=extra, ray=ray)
        if shells and shells[0].support >= LEAST_SUPPORT:
            return shells
        if factor >= LOUDEST:
            break
        factor *= LOUDER
    if not shells:
        raise RecoveryFailure("no-dominant-shell", "no patch of the picture grows into a shell")
    return shells
