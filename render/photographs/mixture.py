"""Which photographs are added up, and with which weights for red, green and blue.

The lights are spread in azimuth and taken from 15 to 50 degrees off the camera's axis, where their directions are
known. The choice depends on the seed and the number of lights alone, so that the same lamps may be given other colours.
"""

import colorsys
from dataclasses import dataclass

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.photographed import LampSpectra, PhotographedLights, RgbWeights
from huesphere.scenes.spectra import emission

OFF_AXIS_DEG = (15.0, 50.0)  # of the lights that are chosen, if there are such
SECTOR_DEG = 30.0  # largest angle between a chosen light's azimuth and the azimuth that an even spread would give it
LEAK = 0.1  # share of a lamp's light that all three channels see alike: no filter is perfect
HUE_SATURATION, HUE_POWER = 0.9, 1.5  # of gels: HSV colours of full value, made deeper by the power
BAND_CENTRES = np.array([610e-9, 545e-9, 465e-9])  # m, of red, green and blue, where a black body is evaluated
SECOND_RADIATION = 1.438776877e-2  # m K, h c / k
TEMPERATURES = (2500.0, 12000.0)  # K, of natural lights: spaced evenly in the logarithm, in an order that is drawn
CAMERA_SPREAD = 0.08  # relative, of a natural light's channels about those of a black body
INTENSITIES = (0.7, 1.3)  # of drawn lights

COUNTS = {"lamps": 3, "natural": 5}  # photographs that are mixed if the config gives no count, by the kind of colours


@dataclass(frozen=True)
class Mixture:
    """Photographs and their weights; L lights."""

    numbers: np.ndarray  # (L,) int, of photographs
    weights: np.ndarray  # (L, 3) of red, green, blue


def mixture(spec: PhotographedLights, directions: np.ndarray, sensitivity: np.ndarray) -> Mixture:
    """The mixture that ``spec`` asks for, of photographs under lights of ``directions`` (N, 3).

    ``sensitivity`` (W, 3) of the camera, for lamps that are given by their spectra. Raises InputError.
    """
    numbers = chosen(spec, directions)
    return Mixture(numbers, weights_of(spec, len(numbers), sensitivity))


def chosen(spec: PhotographedLights, directions: np.ndarray) -> np.ndarray:
    """Numbers (L,) of the photographs, from 0. Raises InputError if there are not so many."""
    there = len(directions)
    if spec.numbers is not None:
        if max(spec.numbers) >= there:
            got = str(max(spec.numbers))
            raise InputError("lights.0.numbers", got=got, expected=f"0 to {there - 1}: there are {there} photographs")
        return np.array(spec.numbers)
    count = spec.number_of_colours or _count(spec, there)
    if count > there:
        raise InputError("lights.0.count", got=str(count), expected=f"at most {there}: there are {there} photographs")
    if count == there:
        return np.arange(there)
    rng = np.random.default_rng([spec.seed, 1])
    if not np.isfinite(directions).all():
        return np.sort(rng.choice(there, count, replace=False))
    return _spread(directions, count, rng)


def _count(spec: PhotographedLights, there: int) -> int:
    """How many of the ``there`` photographs are mixed, where neither their numbers nor a colour for each are given.

    As many as ``spec.count`` says. Without it: all for white; for gels five or six by the seed, but at most ``there``;
    else COUNTS. ``there`` is no limit for the other numbers: ``chosen`` raises InputError where they exceed it.
    """
    if spec.count == "all" or (spec.count is None and spec.colours == "white"):
        return there
    if spec.count is not None:
        return int(spec.count)
    if spec.colours == "gels":
        return min(there, int(np.random.default_rng([spec.seed, 0]).integers(5, 7)))
    return COUNTS[str(spec.colours)]


def _spread(directions: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers (``count``,) of different lights of ``directions`` (N, 3), near azimuths that are evenly spread.

    They are in the order of these azimuths, of which the first is drawn by ``rng``.
    """
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    off_axis = np.degrees(np.arccos(np.clip(directions[:, 2], -1, 1)))
    usual = (off_axis > OFF_AXIS_DEG[0]) & (off_axis < OFF_AXIS_DEG[1])
    start = rng.uniform(0, 360)
    found: list[int] = []
    for k in range(count):
        away = np.abs((azimuth - start - 360 * k / count + 180) % 360 - 180)
        away[found] = np.inf
        near = np.nonzero((away < SECTOR_DEG) & usual)[0]
        found.append(int(rng.choice(near)) if near.size else int(np.argmin(away)))
    return np.array(found)


def weights_of(spec: PhotographedLights, count: int, sensitivity: np.ndarray) -> np.ndarray:
    """Weights (L, 3) of red, green, blue for ``count`` lights: given, drawn by the seed, or of spectra.

    A spectrum E counts ∫ E Q dλ / ∫ Q dλ in a channel of sensitivity Q: what the channel would see of it on a grey
    surface. What a coloured surface does to it within the channel is not in the photographs, and left out.
    """
    if isinstance(spec.colours, RgbWeights):
        return np.array(spec.colours.weights)
    if isinstance(spec.colours, LampSpectra):
        spectra = [emission(one, where=f"lights.0.colours.spectra.{i}") for i, one in enumerate(spec.colours.spectra)]
        return np.stack(spectra) @ sensitivity / sensitivity.sum(axis=0)
    if spec.colours == "white":
        return np.ones((count, 3))
    rng = np.random.default_rng([spec.seed, 2])
    if spec.colours == "lamps":
        weights = np.eye(3)[np.arange(count) % 3] * (1 - LEAK) + LEAK / 3
    elif spec.colours == "gels":
        hues = np.arange(count) / count + rng.uniform()
        weights = np.array([colorsys.hsv_to_rgb(hue % 1, HUE_SATURATION, 1) for hue in hues]) ** HUE_POWER
    else:
        weights = _black_bodies(rng.permutation(np.geomspace(*TEMPERATURES, count)))
        weights = weights * (1 + rng.uniform(-CAMERA_SPREAD, CAMERA_SPREAD, weights.shape))
    return weights * rng.uniform(*INTENSITIES, (count, 1))


def _black_bodies(temperatures: np.ndarray) -> np.ndarray:
    """(L, 3) Planck's law at the centres of red, green and blue, each at mean 1."""
    radiance = BAND_CENTRES**-5 / np.expm1(SECOND_RADIATION / (BAND_CENTRES * temperatures[:, None]))
    return np.asarray(radiance / radiance.mean(axis=1, keepdims=True))
