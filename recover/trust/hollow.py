"""Convex or concave by interreflection: whether the light is there that each of the two surfaces would send itself.

A hollow lights itself and a hill does not. So for the estimate and for its convex/concave twin, the light that their
parts would send each other is gathered, and the albedos are fitted with which the rest of the picture lies best on an
ellipsoid. The twin is ruled out if it would be the more hollow of the two and its light is not there: the albedo that
it would need is far below that of any real surface. It is ruled out, too, if the estimate is the more hollow one and
its light explains the misfit of the ellipsoid better than the twin does, with or without a constant added to all
colours: the light within a spherical bowl is the same everywhere, so ambient light on a ball looks just like it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.interreflection.albedo import Albedo, fit_albedo
from huesphere.recover.interreflection.removal import gathered_light
from huesphere.recover.status import RecoveryFailure
from huesphere.recover.trust.alternatives import jackknife_stderr, parts_of
from huesphere.render.dataset import Observation

MOST_PIXELS = 5000  # of the object: larger pictures are thinned out, since light between parts is smooth
MOST_FITTED = 1500  # pixels of the core that the albedos are fitted to
FEWEST_CORE = 100  # pixels of the core, after thinning out, to fit albedos to
STARTS = (0.0, 0.5)  # albedos from which the fits start
LEAST_LIGHT = 1e-3  # share of the picture's light: a surface that gathers less sends itself next to none
SURE = 2.0  # standard errors added to an albedo before it counts as too low
SMOOTH_PX = 2.0  # standard deviation of the Gaussian that smooths normals before light is gathered, of thinned pixels


@dataclass(frozen=True)
class Hollowness:
    """What interreflection says of an estimate and its twin."""

    own: float = 0.0  # gathered light at albedo 1 over the picture's light, of the estimate: 0 for a convex surface
    twin: float = 0.0  # the same of the twin
    twin_albedo: float = 1.0  # the largest albedo that the picture leaves the twin, in the channel with the least
    # Misfit of the ellipsoid to the colours, over its misfit with the estimate's indirect light subtracted
    own_gain: float = 1.0
    twin_gain: float = 1.0  # the same with the indirect light of the twin
    # The same with a constant, as ambient light or an unknown black level adds to all colours
    offset_gain: float = 1.0

    @property
    def twin_possible(self) -> float:
        """0 (the twin is ruled out) … 1 (nothing speaks against it)."""
        if max(self.own, self.twin) < LEAST_LIGHT:
            return 1.0
        if self.twin >= self.own:
            return float(min(1.0, self.twin_albedo))
        return float(min(1.0, max(self.twin_gain, self.offset_gain) / max(self.own_gain, 1e-300)))


def hollowness(
    normals: np.ndarray, given: np.ndarray, core: np.ndarray, observation: Observation, rgb: np.ndarray
) -> Hollowness:
    """From ``normals`` (H, W, 3) known where ``given`` (H, W), and the colours ``rgb`` (H, W, 3), picture units.

    ``core`` (H, W): the pixels that see every light. Large pictures are thinned out; this does not change the angles at
    which parts see each other, since heights shrink with the distances.
    """
    step = max(1, int(np.ceil(np.sqrt(observation.mask.sum() / MOST_PIXELS))))
    normals, given, core, rgb, mask = (a[::step, ::step] for a in (normals, given, core, rgb, observation.mask))
    normals = _smoothed(normals, given)
    camera = observation.camera
    if camera.focal_px is not None:
        camera = replace(camera, focal_px=camera.focal_px / step)
    small = replace(observation, rgb=rgb.astype(np.float32), mask=mask, camera=camera)
    light = float(rgb[mask].sum())
    if light <= 0 or core.sum() < FEWEST_CORE:
        return Hollowness()
    thin, shares, fits = max(1, int(core.sum() // MOST_FITTED)), [], []
    colours, pixels = rgb[core][::thin], np.argwhere(core)[::thin]
    try:
        for surface in (normals, normals @ TWIN):
            gathered = gathered_light(surface, given, small, rgb)
            fits.append(fit_albedo(colours, gathered[core][::thin], STARTS))
            shares.append(float(gathered[mask].sum()) / light)
        most = _largest_albedo(fits[1], colours, gathered[core][::thin], pixels)
    except (RecoveryFailure, np.linalg.LinAlgError):
        return Hollowness()
    offset = fit_albedo(colours, np.broadcast_to(rgb[core].mean(axis=0), colours.shape), STARTS[:1])
    gains = [fit.before / max(fit.after, 1e-300) for fit in (*fits, offset)]
    return Hollowness(shares[0], shares[1], most, gains[0], gains[1], gains[2])


def _smoothed(normals: np.ndarray, given: np.ndarray) -> np.ndarray:
    """The ``normals`` (H, W, 3), known where ``given`` (H, W), as means over a Gaussian window, unit; 0 elsewhere.

    A pixel's normal comes from its own colour. Without this step the light that it gathers would carry the noise of
    that colour, and the albedo that cancels most of the noise would be fitted instead of the one that explains the
    light: a bowl in noise of 3e-4 would seem to have an albedo of .01 instead of .48.
    """
    sums = ndimage.gaussian_filter(np.where(given[..., None], normals, 0.0), (SMOOTH_PX, SMOOTH_PX, 0))
    length = np.linalg.norm(sums, axis=-1, keepdims=True)
    return np.where(given[..., None] & (length > 0), sums / np.maximum(length, 1e-300), 0.0)


def _largest_albedo(fit: Albedo, rgb: np.ndarray, gathered: np.ndarray, pixels: np.ndarray) -> float:
    """The largest albedo that the colours ``rgb`` (P, 3) leave a surface, in the channel with the least.

    ``fit``: of all ``pixels`` (P, 2), row and column, to the light ``gathered`` (P, 3). Its error is the larger one of
    what scatter predicts and of what the jackknife over parts of the object shows: errors of the surface move the
    gathered light of neighbouring pixels alike.
    """
    part = parts_of(pixels[:, 0], pixels[:, 1])
    rest = [fit_albedo(rgb[part != k], gathered[part != k], (float(fit.alpha.mean()),)) for k in np.unique(part)]
    spread = jackknife_stderr(np.array([one.alpha for one in rest]))
    stderr = np.where(np.isfinite(fit.stderr), np.maximum(fit.stderr, spread), 1.0)
    return float((fit.alpha + SURE * stderr).min())
