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

from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.interreflection.albedo import fit_albedo
from huesphere.recover.interreflection.removal import gathered_light
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

MOST_PIXELS = 5000  # of the object: larger pictures are thinned out, since light between parts is smooth
MOST_FITTED = 1500  # pixels of the core that the albedos are fitted to
FEWEST_CORE = 100  # pixels of the core, after thinning out, to fit albedos to
STARTS = (0.0, 0.5)  # albedos from which the fits start
LEAST_LIGHT = 1e-3  # share of the picture's light: a surface that gathers less sends itself next to none
SURE = 2.0  # standard errors added to an albedo before it counts as too low


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
    camera = observation.camera
    if camera.focal_px is not None:
        camera = replace(camera, focal_px=camera.focal_px / step)
    small = replace(observation, rgb=rgb.astype(np.float32), mask=mask, camera=camera)
    light = float(rgb[mask].sum())
    if light <= 0 or core.sum() < FEWEST_CORE:
        return Hollowness()
    thin, shares, fits = max(1, int(core.sum() // MOST_FITTED)), [], []
    for surface in (normals, normals @ TWIN):
        try:
            gathered = gathered_light(surface, given, small, rgb)
            fits.append(fit_albedo(rgb[core][::thin], gathered[core][::thin], STARTS))
        except (RecoveryFailure, np.linalg.LinAlgError):
            return Hollowness()
        shares.append(float(gathered[mask].sum()) / light)
    offset = fit_albedo(rgb[core][::thin], np.broadcast_to(rgb[core].mean(axis=0), rgb[core][::thin].shape), STARTS[:1])
    twin = fits[1]
    most = twin.alpha + SURE * np.where(np.isfinite(twin.stderr), twin.stderr, 1.0)
    gains = [fit.before / max(fit.after, 1e-300) for fit in (*fits, offset)]
    return Hollowness(shares[0], shares[1], float(most.min()), gains[0], gains[1], gains[2])
