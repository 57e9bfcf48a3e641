"""The shell of method ``robust``: searched for on a small grid, chosen, then polished on the whole picture.

On the small grid (block means, which also average the noise) all shells of the picture are grown
(``recover.ellipsoid.candidates``), the report's LMS being one more seed. The leading ones are told apart there
(``recover.ellipsoid.selection``), and the chosen one is refitted to its own pixels at full size, the noise's bias out.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.silhouette import Outlined, outline_of
from huesphere.recover.ellipsoid.candidates import Shell, clear_margin, find_shells, working_grid
from huesphere.recover.ellipsoid.fit import least_median_of_squares
from huesphere.recover.ellipsoid.selection import Grid, Settled, likeliest, outlined_by, settled
from huesphere.recover.geometry.rays import block_means, rays
from huesphere.recover.pixels.noise import camera_noise, picture_noise
from huesphere.recover.pixels.usable import Pixels
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import CameraInfo

LEAST_SUPPORT = 0.06  # of the usable pixels: less than this is what grows by chance when the noise is taken too low
LOUDER, LOUDEST = 2.0, 16.0  # steps and end of the search for a noise at which something grows
ROUNDING = 2e-4  # of the brightest: least noise, so that single precision and curvature within a block do not count


@dataclass(frozen=True)
class ChosenShell:
    """The shell taken for that of the all-lit pixels, and how clear the choice was."""

    own: Settled
    share: float  # of the usable pixels that see every light
    margin: float  # score over that of the best clearly other shell; inf: there is none; under 1: its pixels decided
    candidates: int
    outlined: Outlined | None  # how the object is turned, as its outline tells with this ellipsoid


@dataclass(frozen=True)
class Candidates:
    """The shells of a picture, and the small grid that they were found on."""

    shells: list[Shell]  # the best first
    grid: Grid  # blocks of pixels, and those wholly usable
    block: int  # pixels, side of a block
    noise: float  # standard deviation of a channel of a pixel, picture units
    known: float  # the same if the camera told it, else 0


def find_candidates(pixels: Pixels, camera: CameraInfo) -> Candidates:
    """All shells that grow in the picture. Raises RecoveryFailure: no-dominant-shell where none does."""
    small, usable, block = working_grid(pixels.rgb, pixels.usable)
    ray = block_means(rays(camera, pixels.usable.shape), block)
    noise = _noise(pixels, camera)
    # A camera that tells its noise is believed later too: where the weakest colour drowns, the fit itself hides some.
    known = noise if camera.known else 0.0
    shells = _grown(small, usable, noise / block, ray)
    grid = Grid(small, usable, noise / block, known / block, outline_of(usable, usable, ray), ray)
    return Candidates(shells, grid, block, noise, known)


def choose_shell(pixels: Pixels, camera: CameraInfo) -> ChosenShell:
    """The shell of the pixels that see every light. Raises RecoveryFailure: no-dominant-shell and those of the fit."""
    found = find_candidates(pixels, camera)
    shells, own = likeliest(found.grid, found.shells)
    if own is None or found.block > 1:
        core = shells[0].core if found.block == 1 else None
        own = settled(pixels.rgb, pixels.usable, shells[0].C, found.noise, found.known, core)
    share = float(own.core.sum() / pixels.usable.sum())
    outline = outline_of(pixels.usable, pixels.mask, rays(camera, pixels.usable.shape))
    outlined = outlined_by(outline, pixels.rgb, pixels.usable, own)
    return ChosenShell(own, share, clear_margin(shells), len(shells), outlined)


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
