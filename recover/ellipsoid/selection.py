"""Which of the leading shells sees every light, once each is refitted and has its own pixels told one by one.

Shells that score nearly alike are mostly variants of one, a few degrees apart: one has taken in pixels of its
neighbour, another has lost some of its own. What they score was found from pixels accepted by means of neighbours. So
each of the first few is finished as if it were the only one, and weighed again by what became of it, and by whether the
outline bears it out (``recover.cues.silhouette``): opposite places of a rim fit the right ellipsoid whichever lights
they miss, and the rotation that the outline tells makes the right normals a surface. A logistic choice among them,
fitted to random scenes by `benchmarks/recover_contenders.py`; all in units of the noise, shares and angles.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.linear_integrability import curl_under
from huesphere.recover.cues.silhouette import Outline, Outlined
from huesphere.recover.ellipsoid.candidates import Shell, refine
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted
from huesphere.recover.ellipsoid.hidden_lights import without_faint
from huesphere.recover.ellipsoid.membership import all_lit_pixels
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.status import RecoveryFailure

MOST, WORTH = 8, 50.0  # shells weighed; how many times less than the first one may score to be among them
LEAST_SCORE, LEAST_SCATTER, LEAST_MISFIT, LEAST_CURL = 1e-6, 0.8, 0.05, 1e-2  # below, less is no different
NO_RIM, NO_CURL, NOT_TOLD = 1.0, 0.3, 0.8  # misfit, curl and probability put down for all where there is none to ask
WEIGHTS = {
    "log score": 0.470,
    "log scatter over noise": -5.334,
    "mean probability of its pixels": 3.960,
    "log of how badly the rim fits it": -1.953,
    "log curl by the outline's rotation": -1.358,
}


@dataclass(frozen=True)
class Settled:
    """An ellipsoid refitted to its own pixels, and which these are."""

    fit: Fit
    core: np.ndarray  # (H, W) bool, pixels taken to see every light
    near: np.ndarray  # (H, W) bool, these and those that lie on it to within noise though they miss a light
    noise: float  # standard deviation of the distance to it, picture units
    told: bool  # its pixels are told from strangers one by one; else there are some along its edge
    probability: float  # mean, of the core; 0 where they are not told
    faint: int  # lights that some of its pixels missed by less than noise, and were left out for


@dataclass(frozen=True)
class Finished:
    """One of the leading shells, what became of it, and what WEIGHTS names of both."""

    shell: Shell
    own: Settled
    evidence: np.ndarray  # (5,)


def settled(
    rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, noise: float, known: float, core: np.ndarray | None = None
) -> Settled:
    """The shell C (3, 3) of the picture ``rgb`` (H, W, 3) refitted to its own among the ``usable`` (H, W) pixels.

    ``noise``: standard deviation of a channel, picture units; ``known``: the same if the camera told it, else 0.
    ``core`` (H, W), if known: its pixels, which are kept where refitting loses them. Raises RecoveryFailure:
    no-dominant-shell where it loses its pixels, and those of the fit.
    """
    try:
        C, core = refine(rgb, usable, C, noise=noise)
    except RecoveryFailure:
        if core is None or not core.any():
            raise
    white, shared = residual_scales(signed_distance(rgb[core], C), core)
    near, faint, tells = core, 0, shared < white
    if tells:  # else an error of the model would be taken for lights
        C, core, faint = without_faint(rgb, core, C, noise=float(np.hypot(white, shared)), grain=max(white, known))
        white, shared = residual_scales(signed_distance(rgb[core], C), core)
    try:
        fit = fit_accepted(rgb[usable], core[usable], noise=max(white, known))
    except RecoveryFailure:
        fit = fit_accepted(rgb[usable], core[usable], noise=white)
    scatter, probability = float(np.hypot(white, shared)), 0.0
    if tells:  # C stays that of the core, which was not chosen by it
        core, probability = all_lit_pixels(rgb, usable, fit.C, core, noise=scatter)
        near = near | core
    return Settled(fit, core, near, scatter, tells, probability, faint)


def outlined_by(outline: Outline | None, rgb: np.ndarray, usable: np.ndarray, own: Settled) -> Outlined | None:
    """What the outline tells with the shell's ``own`` ellipsoid, of ``usable`` (H, W) pixels of ``rgb`` (H, W, 3)."""
    if outline is None:
        return None
    G = symmetric_root(own.fit.C)
    return outline.rotation(rgb[usable] @ G, float(own.core.sum() / usable.sum()), own.noise**2 * own.fit.C)


@dataclass(frozen=True)
class Grid:
    """The picture that shells were found in, with what is true of all of them."""

    rgb: np.ndarray  # (h, w, 3)
    usable: np.ndarray  # (h, w) bool
    noise: float  # standard deviation of a channel, picture units
    known: float  # the same if the camera told it, else 0
    outline: Outline | None  # of its usable pixels
    ray: np.ndarray | None = None  # (h, w, 2) in perspective


def likeliest(grid: Grid, shells: list[Shell]) -> tuple[list[Shell], Settled | None]:
    """(``shells``, the likeliest of the leading ones put before the others; what became of it).

    As they are, and None, if one alone leads or nothing became of any.
    """
    several = leading(shells)
    weighed = finished(grid, several) if len(several) > 1 else []
    if not weighed:
        return shells, None
    best = max(weighed, key=lambda one: one.evidence @ list(WEIGHTS.values()))
    return [best.shell, *(shell for shell in shells if shell is not best.shell)], best.own


def leading(shells: list[Shell]) -> list[Shell]:
    """Those of ``shells``, the best first, that are worth finishing."""
    return [shell for shell in shells[:MOST] if shell.score >= shells[0].score / WORTH]


def finished(grid: Grid, shells: list[Shell]) -> list[Finished]:
    """Each of the ``shells`` finished as if it were the only one, those that can be."""

    def one(shell: Shell) -> Finished | None:
        try:
            own = settled(grid.rgb, grid.usable, shell.C, grid.noise, grid.known, shell.core)
            return Finished(shell, own, _evidence(grid, shell, own))
        except (RecoveryFailure, np.linalg.LinAlgError):
            return None

    return [found for found in in_threads(one, shells) if found is not None]


def _evidence(grid: Grid, shell: Shell, own: Settled) -> np.ndarray:
    """What WEIGHTS names (5,), in that order."""
    misfit, curl = NO_RIM, NO_CURL
    outlined = outlined_by(grid.outline, grid.rgb, grid.usable, own)
    if outlined is not None:
        misfit = NO_RIM if outlined.rim is None else outlined.rim.misfit
        curl = curl_under(outlined.rotation, grid.rgb, own.core, own.fit.C, ray=grid.ray)
    return np.array(
        [
            np.log(max(shell.score, LEAST_SCORE)),
            np.log(max(own.noise / grid.noise, LEAST_SCATTER)),
            own.probability if own.told else NOT_TOLD,
            np.log(LEAST_MISFIT + misfit),
            np.log(max(curl, LEAST_CURL)),
        ]
    )
