"""Which of the leading candidates is the ellipsoid of the pixels that see every light.

Candidates with nearly equal scores are mostly variants of one ellipsoid, a few degrees apart: one has accepted pixels
of its neighbour, another has lost some of its own. Their scores rest on pixels accepted by means of neighbours. So each
of the first few is refitted as if it were the only one, and the choice is made anew by the outcome and by the
silhouette (``recover.cues.silhouette``): the normals at opposite places of the silhouette fit the right ellipsoid
whichever lights they miss, and under the rotation from the silhouette the right normals are integrable. The
choice is a conditional logistic model; its weights are in ``selection_weights.json``, with the script that fitted them
to random scenes. All evidence is in units of the noise, of shares and of angles.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.linear_integrability import curl_under_rotation
from huesphere.recover.cues.silhouette import Silhouette, SilhouetteRotation
from huesphere.recover.ellipsoid.candidates import Candidate, refine
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted
from huesphere.recover.ellipsoid.hidden_lights import without_hidden_lights
from huesphere.recover.ellipsoid.membership import all_lit_pixels
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.parameters import learned
from huesphere.recover.problem import Problem
from huesphere.recover.status import RecoveryFailure

CONTENDER_SCORE_RATIO = 50.0  # How many times less than the first a candidate may score to be refitted (factor).

CONTENDERS = 8  # Leading candidates that are refitted and compared.


@dataclass(frozen=True)
class RefittedEllipsoid:
    """An ellipsoid refitted to its own pixels, and which these are."""

    fit: Fit
    inlier: np.ndarray  # (H, W) bool, pixels taken to see every light
    near: np.ndarray  # (H, W) bool, these and those that lie on the ellipsoid to within noise though they miss a light
    noise: float  # standard deviation of the distance to the ellipsoid, picture units
    classified: bool  # outliers are recognised pixel by pixel (``membership``); if not, some are left along the edge
    probability: float  # mean over the inliers that they see every light; 0 where not classified
    hidden_lights: int  # lights that some inliers missed by less than noise: these pixels are left out


@dataclass(frozen=True)
class Contender:
    """One of the leading candidates, its refitted ellipsoid, and the evidence of both."""

    candidate: Candidate
    refitted: RefittedEllipsoid
    evidence: np.ndarray  # (5,), in the order of ``learned_evidence``


@dataclass(frozen=True)
class Grid:
    """The picture in which candidates were found, with what is common to all of them."""

    problem: Problem  # block means, or the picture itself
    known_noise: float  # standard deviation of a channel of it if the camera reports one, else 0; picture units
    silhouette: Silhouette | None  # of its usable pixels


def refit_candidate(
    problem: Problem, C: np.ndarray, known_noise: float, inlier: np.ndarray | None = None
) -> RefittedEllipsoid:
    """The ellipsoid C (3, 3), picture units, refitted to its own among the usable pixels.

    ``known_noise``: standard deviation of a channel if the camera reports one, else 0. ``inlier`` (H, W), where given:
    pixels of C, which are kept where refitting loses all of them. Raises RecoveryFailure: no-dominant-shell where no
    pixels are left, and those of ``fit_accepted``.
    """
    rgb, usable = problem.rgb, problem.usable
    try:
        C, inlier = refine(problem, C)
    except RecoveryFailure:
        if inlier is None or not inlier.any():
            raise
    independent, correlated = residual_scales(signed_distance(rgb[inlier], C), inlier)
    near, hidden, classified = inlier, 0, correlated < independent
    if classified:  # otherwise an error of the model would be taken for missing lights
        scatter = float(np.hypot(independent, correlated))
        channel_noise = max(independent, known_noise)
        C, inlier, hidden = without_hidden_lights(rgb, inlier, C, noise=scatter, channel_noise=channel_noise)
        independent, correlated = residual_scales(signed_distance(rgb[inlier], C), inlier)
    try:
        fit = fit_accepted(rgb[usable], inlier[usable], noise=max(independent, known_noise))
    except RecoveryFailure:
        fit = fit_accepted(rgb[usable], inlier[usable], noise=independent)
    scatter, probability = float(np.hypot(independent, correlated)), 0.0
    if classified:  # C is not fitted again: pixels that were chosen by their distance to C would bias it
        inlier, probability = all_lit_pixels(rgb, usable, fit.C, inlier, noise=scatter)
        near = near | inlier
    return RefittedEllipsoid(fit, inlier, near, scatter, classified, probability, hidden)


def silhouette_rotation(
    silhouette: Silhouette | None, problem: Problem, refitted: RefittedEllipsoid
) -> SilhouetteRotation | None:
    """The rotation from the silhouette of the problem's usable pixels and an ellipsoid; None where it has none."""
    if silhouette is None:
        return None
    G = symmetric_root(refitted.fit.C)
    share = float(refitted.inlier.sum() / problem.usable.sum())
    return silhouette.rotation(problem.rgb[problem.usable] @ G, share, refitted.noise**2 * refitted.fit.C)


def most_likely_first(grid: Grid, candidates: list[Candidate]) -> tuple[list[Candidate], RefittedEllipsoid | None]:
    """(``candidates`` with the most likely of the leading ones first, its refitted ellipsoid).

    The order is unchanged, and the ellipsoid None, if only one leads or none of those that lead can be refitted.
    """
    several = leading(candidates)
    contenders = refit_contenders(grid, several) if len(several) > 1 else []
    if not contenders:
        return candidates, None
    weights = [entry["weight"] for entry in learned_evidence().values()]
    best = max(contenders, key=lambda one: one.evidence @ weights)
    return [best.candidate, *(one for one in candidates if one is not best.candidate)], best.refitted


def leading(candidates: list[Candidate]) -> list[Candidate]:
    """Those of ``candidates``, sorted by score, that score enough to be refitted and compared."""
    least = candidates[0].score / CONTENDER_SCORE_RATIO
    return [candidate for candidate in candidates[:CONTENDERS] if candidate.score >= least]


def refit_contenders(grid: Grid, candidates: list[Candidate]) -> list[Contender]:
    """Each of the ``candidates`` refitted as if it were the only one; without those that cannot be refitted."""

    def one(candidate: Candidate) -> Contender | None:
        try:
            refitted = refit_candidate(grid.problem, candidate.C, grid.known_noise, candidate.inlier)
            return Contender(candidate, refitted, _evidence(grid, candidate, refitted))
        except (RecoveryFailure, np.linalg.LinAlgError):
            return None

    return [found for found in in_threads(one, candidates) if found is not None]


def learned_evidence() -> dict[str, dict[str, float]]:
    """Weight, floor and value for the unknown of each piece of evidence."""
    return learned("ellipsoid/selection_weights.json")["evidence"]  # type: ignore[no-any-return]


def _evidence(grid: Grid, candidate: Candidate, refitted: RefittedEllipsoid) -> np.ndarray:
    """The evidence that ``learned_evidence`` names, (5,), in its order."""
    score, scatter, probability, misfit, curl = learned_evidence().values()
    misfit_now, curl_now = misfit["if unknown"], curl["if unknown"]
    found = silhouette_rotation(grid.silhouette, grid.problem, refitted)
    if found is not None:
        misfit_now = misfit["if unknown"] if found.rim is None else found.rim.misfit
        curl_now = curl_under_rotation(
            found.rotation, grid.problem.rgb, refitted.inlier, refitted.fit.C, ray=grid.problem.ray
        )
    return np.array(
        [
            np.log(max(candidate.score, score["least"])),
            np.log(max(refitted.noise / grid.problem.noise, scatter["least"])),
            refitted.probability if refitted.classified else probability["if unknown"],
            np.log(misfit["least"] + misfit_now),
            np.log(max(curl_now, curl["least"])),
        ]
    )
