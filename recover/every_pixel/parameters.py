"""Tuned numbers of the labels of every pixel. Read at the place of use, as ``EVERY_PIXEL.undetermined_rad``."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

_LOG = "docs/research-log.md, Lights from one picture: the scan and the bust under four lightings"
_MAP = "docs/research-log.md, Which shell auto begins with: scan, bust and 17 random scenes"
_INDIRECT = "docs/research-log.md, Lights in shadows with indirect light: sculptures, bust, scans"
_HAND = "chosen by hand"


@dataclass(frozen=True)
class EveryPixelParameters:
    """Costs are in units of squared standard deviations of a colour's distance to the ellipsoid of a set of lights."""

    # by_light_sets
    several_lights_tolerance: float = tuned(
        2e-4,
        unit="brightest colour",
        meaning="A pixel's residual up to this is accepted however low the noise is: where several lights are missed, "
        "the errors of their colours and directions add up.",
        origin=_HAND,
    )
    undetermined_rad: float = tuned(
        0.2,
        unit="radians",
        meaning="A residual that would turn the normal by more than this, in F's weakest direction, leaves the normal "
        "no better than an interpolated one: a pixel with it is not explained.",
        origin=_LOG + ": gels with interreflection 1.28° to 0.54° in the mean",
    )
    robust_cost: float = tuned(
        6.0,
        unit="squared standard deviations",
        meaning="A squared residual beyond this adds to the cost of a label only as its logarithm.",
        origin=_HAND,
    )
    cost_of_cast_shadow: float = tuned(
        3.0,
        unit="squared standard deviations",
        meaning="Added to the cost of a label for each light that it says is missed though the normal faces it, so "
        "that something else must cast a shadow.",
        origin=_HAND,
    )
    terminator_cosine: float = tuned(
        0.03,
        unit="cosine",
        meaning="A pixel is turned to a light, or away from it, only beyond this cosine.",
        origin=_HAND,
    )
    neighbour_weight: float = tuned(
        4.0,
        unit="1",
        meaning="Labels are chosen by a pixel's own cost plus this times the mean cost over a window about it.",
        origin=_HAND,
    )
    window_px: int = tuned(5, unit="pixels", meaning="Side of that window.", origin=_HAND)
    cost_of_other_sheet: float = tuned(
        30.0,
        unit="squared standard deviations per squared radian",
        meaning="Where the lights that a pixel sees give nearly the same colour to two normals, a normal costs this "
        "times its squared distance to the normal of the surface interpolated between other pixels.",
        origin=_HAND,
    )
    most_turn_of_partly_lit: float = tuned(
        0.5,
        unit="radians",
        meaning="The normal of a pixel in the edge of a cast shadow is at most this far from the interpolated surface.",
        origin=_HAND,
    )
    least_explained_neighbours: float = tuned(
        0.3,
        unit="share of 3×3 pixels",
        meaning="A pixel is explained only if this share of its neighbourhood is: a single fit is chance.",
        origin=_HAND,
    )
    # by_joint_lights
    between_blocks_deg: float = tuned(
        5.0,
        unit="degrees",
        meaning="Standard deviation of a pixel's normal about the surface interpolated between blocks.",
        origin=_HAND,
    )
    # by_irradiance_map
    most_explained_by_map: float = tuned(
        0.75,
        unit="share of the uncertain pixels",
        meaning="A map that explains this share gives the normals of the rest too.",
        origin=_MAP,
    )
    surely_all_lit_rad: float = tuned(
        0.02,
        unit="radians",
        meaning="A pixel surely sees every light if its distance to the ellipsoid would turn its normal by less than "
        "this, in F's weakest direction.",
        origin=_MAP + ": 10.4° to 8.1° in the mean, with the quantile below",
    )
    confirming_quantile: float = tuned(
        0.9,
        unit="quantile",
        meaning="The map confirms a pixel's normal if its residual is below this quantile of those of the core.",
        origin=_MAP,
    )
    map_error_deg: float = tuned(
        2.4,
        unit="degrees",
        meaning="Mean error of the map's normals where all of the object is the core.",
        origin="0.7 to 6 on random scenes; docs/research-log.md, What auto states of its errors",
    )
    # completion
    interpolated_error_deg: float = tuned(
        15.0,
        unit="degrees",
        meaning="Expected error of interpolated normals, and the most that is stated of any other.",
        origin="the scan and the bust under lights 27 to 35 degrees off axis",
    )
    least_unlit_share: float = tuned(
        0.25,
        unit="share of the object",
        meaning="Share of pixels that are not on the ellipsoid, as those that miss lights or show a highlight, from "
        "which the whole picture determines lights and surface together.",
        origin="docs/research-log.md, Lights found together",
    )
    noisy_picture: float = tuned(
        3e-4,
        unit="brightest colour",
        meaning="Noise from which lights are estimated jointly with the surface rather than one by one.",
        origin="docs/research-log.md, Lights found together",
    )
    correlated_is_noise: float = tuned(
        0.5,
        unit="times the white residual",
        meaning="Spatially correlated residual of the pixels that see every light, above which the rest is not taken "
        "for noise that hides lights.",
        origin="docs/research-log.md, Lights by the borders of their shadows: noise to 0.12, interreflection from 0.5",
    )
    removal_doubt_deviations: float = tuned(
        12.0,
        unit="standard deviations",
        meaning="Residual up to which an interpolated pixel may still see every light if removed light is in doubt.",
        origin=_LOG,
    )
    noise_like_least: float = tuned(
        0.7,
        unit="times the noise",
        meaning="Median residual of the joint fit below which the noise was overestimated and the fit is not taken.",
        origin="of a right fit 1.18: one freedom of three is spent",
    )
    noise_like_most: float = tuned(
        1.3,
        unit="times the noise",
        meaning="Median residual of the joint fit above which it has model error and is not taken.",
        origin="of a right fit 1.18: one freedom of three is spent",
    )
    own_colour_deviations: float = tuned(
        12.0,
        unit="standard deviations",
        meaning="Residual of the smoothed surface beyond which a pixel keeps the normal of its own colour.",
        origin=_HAND,
    )
    search_again_share: float = tuned(
        0.03,
        unit="share of the object",
        meaning="Lights are searched for again, with more noise, where the first search leaves more unexplained.",
        origin=_INDIRECT,
    )
    shadow_noise_factor: float = tuned(
        3.0,
        unit="times the noise",
        meaning="Noise of a second search for lights, where there is indirect light and the first did not find all.",
        origin=_INDIRECT,
    )


EVERY_PIXEL = EveryPixelParameters()
