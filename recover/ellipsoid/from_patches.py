"""The ellipsoid of method ``robust``: searched for on a small grid, chosen there, refitted on the whole picture.

All candidates of the picture are grown on the small grid (``recover.ellipsoid.candidates``), which holds means over
blocks of pixels and so less noise; the report's least-median-of-squares ellipsoid is one more seed. The leading
candidates are compared there (``recover.ellipsoid.selection``), and the chosen one is refitted to its own pixels at
full size, without the bias of the noise.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.silhouette import SilhouetteRotation, silhouette_of
from huesphere.recover.ellipsoid.candidates import Candidate, clear_margin, grow_candidates, working_grid
from huesphere.recover.ellipsoid.fit import least_median_of_squares
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.ellipsoid.selection import (
    Grid,
    RefittedEllipsoid,
    most_likely_first,
    refit_candidate,
    silhouette_rotation,
)
from huesphere.recover.pixels.noise import camera_noise, picture_noise
from huesphere.recover.problem import Problem
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import CameraInfo

# Least noise assumed: rounding to single precision and curvature within a block count as noise (of the brightest
# channel value).
LEAST_NOISE = 2e-4


@dataclass(frozen=True)
class ChosenEllipsoid:
    """The ellipsoid taken for that of the pixels that see every light, and how clear the choice was."""

    refitted: RefittedEllipsoid
    share: float  # of the usable pixels that see every light
    margin: float  # score over that of the best clearly different candidate; inf: none; below 1: the refit decided
    candidates: int  # how many there were
    silhouette: SilhouetteRotation | None  # the rotation from the silhouette and this ellipsoid


@dataclass(frozen=True)
class Candidates:
    """The candidates of a picture, and the small grid on which they were found."""

    found: list[Candidate]  # the highest score first
    grid: Grid  # blocks of pixels, and those wholly usable
    block: int  # pixels, side of a block
    noise: float  # standard deviation of a channel of a pixel, picture units
    known_noise: float  # the same if the camera reports it, else 0


def find_candidates(problem: Problem, camera: CameraInfo) -> Candidates:
    """All candidates that grow in the picture, whose noise the ``camera`` may report; ``problem.noise`` is not used.

    Raises RecoveryFailure: no-dominant-shell where none grows.
    """
    noise = _noise(problem, camera)
    # A noise that the camera reports is used in later fits too: where noise exceeds the weakest colour, the distances
    # to the ellipsoid show only part of it.
    known_noise = noise if camera.known else 0.0
    small, block = working_grid(problem.with_noise(noise))
    found = _grown(small)
    grid = Grid(small, known_noise / block, silhouette_of(small.usable, small.usable, small.ray))
    return Candidates(found, grid, block, noise, known_noise)


def choose_ellipsoid(problem: Problem, camera: CameraInfo) -> ChosenEllipsoid:
    """The ellipsoid of the pixels that see every light; arguments as for ``find_candidates``.

    Raises RecoveryFailure: no-dominant-shell where none is found, and those of the fit.
    """
    search = find_candidates(problem, camera)
    candidates, refitted = most_likely_first(search.grid, search.found)
    if refitted is None or search.block > 1:
        inlier = candidates[0].inlier if search.block == 1 else None
        refitted = refit_candidate(problem.with_noise(search.noise), candidates[0].C, search.known_noise, inlier)
    return _chosen(problem, refitted, clear_margin(candidates), len(candidates))


def ellipsoid_near(problem: Problem, camera: CameraInfo, C: np.ndarray) -> ChosenEllipsoid:
    """The ellipsoid C (3, 3), picture units, refitted to its own pixels; no other is searched for.

    Arguments and errors as for ``choose_ellipsoid``.
    """
    noise = _noise(problem, camera)
    refitted = refit_candidate(problem.with_noise(noise), C, noise if camera.known else 0.0)
    return _chosen(problem, refitted, float("inf"), 1)


def _chosen(problem: Problem, refitted: RefittedEllipsoid, margin: float, candidates: int) -> ChosenEllipsoid:
    """The refitted ellipsoid with its share of the pixels and the rotation from the silhouette."""
    share = float(refitted.inlier.sum() / problem.usable.sum())
    silhouette = silhouette_of(problem.usable, problem.mask, problem.ray)
    return ChosenEllipsoid(refitted, share, margin, candidates, silhouette_rotation(silhouette, problem, refitted))


def _noise(problem: Problem, camera: CameraInfo) -> float:
    """Standard deviation of a channel, picture units: the camera's where it reports one, else the picture's."""
    bright = problem.rgb[problem.usable]
    known = camera_noise(camera, float(np.median(bright))) if camera.known else 0.0
    measured = picture_noise(problem.rgb, problem.usable)
    # Fine texture adds to the measured noise. So the camera's report is used, but for rounding.
    return max(known if known > 0 else measured, LEAST_NOISE * float(bright.max()))


def _grown(small: Problem) -> list[Candidate]:
    """The candidates at the least of the noises tried at which one has enough support, else those at the largest."""
    try:
        extra = [least_median_of_squares(small.rgb[small.usable])]
    except RecoveryFailure:
        extra = []
    candidates: list[Candidate] = []
    for factor in ELLIPSOID.noise_factors:
        candidates = grow_candidates(small.with_noise(factor * small.noise), extra=extra)
        if candidates and candidates[0].support >= ELLIPSOID.least_support:
            break
    if not candidates:
        raise RecoveryFailure("no-dominant-shell", "no patch of the picture grows into an ellipsoid")
    return candidates
