"""Which of the leading shells sees every light, once each is refitted and has its own pixels told one by one.

Shells that score nearly alike are mostly variants of one, a few degrees apart: one has taken in pixels of its
neighbour, another has lost some of its own. What they score was found from pixels accepted by means of neighbours. So
each of the first few is finished as if it were the only one, and weighed again by what became of it: a logistic choice
among them, fitted to random scenes by `benchmarks/recover_contenders.py`; all in units of the noise, shares and angles.
"""

from dataclasses import dataclass

import numpy as np

from recover.all_lit import all_lit_pixels
from recover.ellipsoid import Fit, fit_accepted
from recover.facing import facing
from recover.faint import without_faint
from recover.passes import residuals
from recover.polish import residual_scales, signed_distance
from recover.shells import Shell, outermost, refine
from recover.status import RecoveryFailure
from recover.threads import in_threads

MOST, WORTH = 4, 10.0  # shells weighed; how many times less than the first one may score to be among them
NEAR_ASIDE_DEG = 8.0  # of facing the camera squarely
LEAST_SCORE, LEAST_CURL, LEAST_SCATTER, LEAST_SHARED = 1e-6, 1e-2, 0.8, 1e-3  # below, less is no different
WEIGHTS = {
    "log score": 0.444,
    "log (1 + square) of how far its normals keep from the camera": -0.706,
    "log curl": -0.312,
    "log scatter over noise": -5.111,
    "mean probability of its pixels": 3.223,
    "log what neighbours share over noise": -0.121,
    "log (1 + squared radius of the outermost pixels)": -0.326,
}


@dataclass(frozen=True)
class Settled:
    """An ellipsoid refitted to its own pixels, and which these are."""

    fit: Fit
    core: np.ndarray  # (H, W) bool, pixels taken to see every light
    near: np.ndarray  # (H, W) bool, these and those that lie on it to within noise though they miss a light
    noise: float  # standard deviation of the distance to it, picture units
    shared: float  # the part of it that neighbours share
    told: bool  # its pixels are told from strangers one by one; else there are some along its edge
    probability: float  # mean, of the core; 0 where they are not told
    faint: int  # lights that some of its pixels missed by less than noise, and were left out for


@dataclass(frozen=True)
class Finished:
    """One of the leading shells, what became of it, and what WEIGHTS names of both."""

    shell: Shell
    own: Settled
    evidence: np.ndarray  # (7,)


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
    return Settled(fit, core, near, scatter, shared, tells, probability, faint)


def likeliest(
    rgb: np.ndarray, usable: np.ndarray, shells: list[Shell], noise: float, known: float, ray: np.ndarray | None = None
) -> tuple[list[Shell], Settled | None]:
    """(``shells``, the likeliest of the leading ones put before the others; what became of it), as for ``finished``.

    As they are, and None, if one alone leads or nothing became of any.
    """
    several = leading(shells)
    weighed = finished(rgb, usable, several, noise, known, ray) if len(several) > 1 else []
    if not weighed:
        return shells, None
    best = max(weighed, key=lambda one: one.evidence @ list(WEIGHTS.values()))
    return [best.shell, *(shell for shell in shells if shell is not best.shell)], best.own


def leading(shells: list[Shell]) -> list[Shell]:
    """Those of ``shells``, the best first, that are worth finishing."""
    return [shell for shell in shells[:MOST] if shell.score >= shells[0].score / WORTH]


def finished(
    rgb: np.ndarray, usable: np.ndarray, shells: list[Shell], noise: float, known: float, ray: np.ndarray | None = None
) -> list[Finished]:
    """Each of the ``shells`` finished as if it were the only one, those that can be.

    ``rgb`` (h, w, 3) is the picture that they were found in among its ``usable`` pixels (h, w), ``noise`` and ``known``
    as for ``settled``, ``ray`` (h, w, 2) its rays in perspective.
    """

    def one(shell: Shell) -> Finished | None:
        try:
            own = settled(rgb, usable, shell.C, noise, known, shell.core)
        except (RecoveryFailure, np.linalg.LinAlgError):
            return None
        return Finished(shell, own, _evidence(rgb, usable, shell, own, noise, ray))

    return [found for found in in_threads(one, shells) if found is not None]


def _evidence(
    rgb: np.ndarray, usable: np.ndarray, shell: Shell, own: Settled, noise: float, ray: np.ndarray | None
) -> np.ndarray:
    """What WEIGHTS names (7,), in that order."""
    judgement = facing(rgb, own.core, own.fit.C, noise=noise, ray=ray)
    return np.array(
        [
            np.log(max(shell.score, LEAST_SCORE)),
            np.log1p((judgement.aside_deg / NEAR_ASIDE_DEG) ** 2),
            np.log(max(judgement.curl, LEAST_CURL)),
            np.log(max(own.noise / noise, LEAST_SCATTER)),
            own.probability,
            np.log(max(own.shared / noise, LEAST_SHARED)),
            np.log1p(outermost(residuals(rgb[usable], own.fit.C))),
        ]
    )
