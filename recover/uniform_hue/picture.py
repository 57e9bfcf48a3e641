"""What of a picture the fit of ``recover.uniform_hue.fit`` works on: samples of its pixels, in whitened colours."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.inflated_outline import heights
from huesphere.recover.cues.silhouette import frame_along
from huesphere.recover.cues.silhouette_matrix import bright_enough, whitening
from huesphere.recover.problem import Problem
from huesphere.recover.rotation.weak_form import functions_that_fit
from huesphere.recover.uniform_hue.albedo import neighbouring_colours
from huesphere.recover.uniform_hue.curl import ColourCurl

MOST_COLOURS = 3000  # pixels whose albedo and template take part, and pairs of places: bounds the time
MOST_SAMPLES = 120_000  # pixels under all bumps, a pixel counted once for each: bounds the time
FROM_EDGE_PX = 2  # from pixels that are dark or off the object: mixed colours


@dataclass(frozen=True)
class Picture:
    """Samples of a picture; colours are whitened: multiplied by W, they have second moments of 1."""

    W: np.ndarray  # (3, 3)
    colours: np.ndarray  # (P, 3) of single pixels
    heights: np.ndarray  # (P, 3) (−h_x, −h_y, 2√h) of the template there, in the frame of the object's mean ray
    frame: np.ndarray  # (3, 3) that frame's axes in columns: the identity for parallel rays
    curl: ColourCurl
    pairs: tuple[np.ndarray, np.ndarray]  # (E, 3) each, mean colours of neighbouring places


def picture_of(problem: Problem) -> Picture:
    """The samples of a picture. Raises RecoveryFailure (too-scattered) and LinAlgError (colours in a plane)."""
    usable = problem.usable
    W = whitening(problem.rgb[usable])
    white = problem.rgb @ W
    bright = bright_enough(white, usable)
    every = max(1, int(np.ceil(np.sqrt(bright.sum() / MOST_COLOURS))))
    sampled = np.zeros_like(bright)
    sampled[::every, ::every] = bright[::every, ::every]
    disc = ndimage.iterate_structure(ndimage.generate_binary_structure(2, 1), FROM_EDGE_PX)
    inner = ndimage.binary_erosion(bright, disc)
    functions, covered = functions_that_fit(inner, "continuous").subset(MOST_SAMPLES)
    d = white[inner][covered]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    curl = ColourCurl.of(functions, d, None if problem.ray is None else problem.ray[inner][covered])
    one, other = neighbouring_colours(white, inner)
    step = max(1, len(one) // MOST_COLOURS)
    mean_ray = None if problem.ray is None else problem.ray[usable].mean(axis=0)
    return Picture(
        W=W,
        colours=white[sampled],
        heights=heights(problem.mask)[sampled],
        frame=frame_along(mean_ray),
        curl=curl,
        pairs=(one[::step], other[::step]),
    )
