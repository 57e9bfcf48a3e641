"""Why a pixel has the normal that it has, or none: one table of code, name and text.

Every estimate has one code a pixel: the channel ``reason`` of ``<method>.exr``, the key ``reasons`` of its JSON, the
page's read-out and the columns of the evaluator's tables all take their words from REASONS.
"""

from enum import IntEnum

import numpy as np


class Reason(IntEnum):
    """Codes of the channel ``reason``. Pixels of BACKGROUND, and of OUTLIER and every higher code, have no normal."""

    BACKGROUND = 0
    ALL_LIT = 1
    MISSES_LIGHTS = 2
    IRRADIANCE_MAP = 3
    KNOWN_LIGHTS = 4
    INTERPOLATED = 5
    INTERPOLATED_SATURATED = 6
    INTERPOLATED_DARK = 7
    INTERPOLATED_NOT_FINITE = 8
    OUTLIER = 9
    OUTLIER_BRIGHT = 10
    SATURATED = 11
    DARK = 12
    NOT_FINITE = 13
    NO_SOLUTION = 14


REASONS: dict[Reason, tuple[str, str]] = {  # code: name, what it means
    Reason.BACKGROUND: ("background", "off the object"),
    Reason.ALL_LIT: ("all-lit", "the colour lies on the ellipsoid of the pixels that see every light"),
    Reason.MISSES_LIGHTS: ("misses-lights", "the colour is explained by the lights found, of which it misses some"),
    Reason.IRRADIANCE_MAP: ("irradiance-map", "the normal is that of a smooth map from normals to colours"),
    Reason.KNOWN_LIGHTS: ("known-lights", "depth and light colours were fitted under lights of known position"),
    Reason.INTERPOLATED: ("interpolated", "nothing explains the colour: the surface between its neighbours was taken"),
    Reason.INTERPOLATED_SATURATED: ("interpolated-saturated", "interpolated, since the pixel is clipped"),
    Reason.INTERPOLATED_DARK: ("interpolated-dark", "interpolated, since no light reaches the pixel"),
    Reason.INTERPOLATED_NOT_FINITE: ("interpolated-not-finite", "interpolated, since the sample is NaN or infinite"),
    Reason.OUTLIER: ("outlier", "no normal: the colour lies within the ellipsoid, as mostly where a light is missed"),
    Reason.OUTLIER_BRIGHT: ("outlier-bright", "no normal: the colour lies outside the ellipsoid, as a highlight does"),
    Reason.SATURATED: ("saturated", "no normal: the pixel is clipped"),
    Reason.DARK: ("dark", "no normal: no light reaches the pixel"),
    Reason.NOT_FINITE: ("not-finite", "no normal: the sample is NaN or infinite"),
    Reason.NO_SOLUTION: ("no-solution", "no normal: the method ended before it had one"),
}
_WHEN_INTERPOLATED = {
    Reason.SATURATED: Reason.INTERPOLATED_SATURATED,
    Reason.DARK: Reason.INTERPOLATED_DARK,
    Reason.NOT_FINITE: Reason.INTERPOLATED_NOT_FINITE,
}


def by_colour(reason: np.ndarray) -> np.ndarray:
    """Whether the normal of each pixel follows from its colour, (H, W) bool, by the codes ``reason`` (H, W)."""
    return (reason >= Reason.ALL_LIT) & (reason <= Reason.KNOWN_LIGHTS)  # type: ignore[no-any-return]


def interpolated(lost: np.ndarray) -> np.ndarray:
    """Codes (H, W) of interpolated pixels; ``lost`` (H, W): their codes before, why the colour gave no normal."""
    out = np.full(lost.shape, Reason.INTERPOLATED, np.uint8)
    for why, code in _WHEN_INTERPOLATED.items():
        out[lost == why] = code
    return out


def shares(reason: np.ndarray) -> dict[str, float]:
    """Share of the object's pixels, by the name of their reason (H, W); reasons that no pixel has are left out."""
    count = np.bincount(reason.ravel().astype(int), minlength=len(REASONS))
    total = max(1, int(count[1:].sum()))
    return {name: float(count[code] / total) for code, (name, _) in REASONS.items() if code and count[code]}
