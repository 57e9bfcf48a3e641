"""Tuned numbers of the search for lights. Read at the place of use, as ``LIGHTS.outlier_deviations``."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

_ONE_BY_ONE = "docs/research-log.md, Lights from one picture: the scan and the bust under four lightings"
_SHADOWS = "docs/research-log.md, Lights by the borders of their shadows"
_TOGETHER = "docs/research-log.md, Lights found together: some 300 random scenes of noise 3e-3 (seeds from 300000)"
_MAP = "docs/research-log.md, Wide or many lights: sphere, ellipsoid and relief under discs of light"
_HAND = "chosen by hand"


@dataclass(frozen=True)
class LightsParameters:
    """Lengths of colours are relative to the brightest channel of the picture where the unit says "brightest"."""

    # every module
    outlier_deviations: float = tuned(
        3.0,
        unit="standard deviations",
        meaning="A residual up to this is explained by noise; the same width sets the scale of Cauchy's loss.",
        origin="the three-sigma rule",
    )
    rim_px: int = tuned(
        4,
        unit="pixels",
        meaning="Blocks of pixels nearer to the silhouette than this have hardly any weight: one slope for the whole "
        "block cannot follow the surface there.",
        origin=_MAP,
    )
    # model
    relative_light_error: float = tuned(
        0.03,
        unit="share of all light",
        meaning="How far a light found, or the sum of the lights found, may be off. What remains of F once they are "
        "subtracted is no further light if it is smaller.",
        origin=_ONE_BY_ONE + ": the remainder has a second singular value of 0.003 to 0.016 where it is one light",
    )
    # from_shadows
    window_half_widths_px: tuple[int, ...] = tuned(
        (2, 3, 5),
        unit="pixels",
        meaning="Guesses of a light are made from square windows of pixels in shadow, drawn at random; their half "
        "widths alternate between these.",
        origin=_HAND,
    )
    least_support_px: int = tuned(
        40, unit="pixels", meaning="A light that explains fewer pixels is not believed.", origin=_HAND
    )
    credit_of_flat: float = tuned(
        0.3,
        unit="1",
        meaning="Factor of the evidence of a light beside which all others give colours of a plane.",
        origin=_SHADOWS,
    )
    least_score: float = tuned(
        0.6,
        unit="times the least support",
        meaning="A light is accepted if its pixels, weighted by the evidence, are more.",
        origin=_SHADOWS,
    )
    least_credit: float = tuned(
        0.2,
        unit="share of the pixels",
        meaning="A light is not accepted if the evidence leaves less than this share of its pixels, however many.",
        origin=_SHADOWS,
    )
    noisy_tolerance: float = tuned(
        1e-3,
        unit="brightest",
        meaning="A picture whose tolerance of residuals exceeds this is a noisy one.",
        origin=_HAND,
    )
    far_side_cosine: float = tuned(
        0.06,
        unit="cosine",
        meaning="A pixel that sees every light contradicts a light if it faces away from it by more than this: cosine "
        "of normal and light below minus this.",
        origin=_HAND,
    )
    far_side_share: float = tuned(
        0.01,
        unit="share of the pixels that see every light",
        meaning="A light is accepted although up to this share of those pixels contradicts it, and twice as many "
        "where it is a first guess.",
        origin=_HAND,
    )
    # one_light
    window_share: float = tuned(
        0.6,
        unit="share of a window",
        meaning="A guess is fitted to, and judged by, this share of a window's pixels: others may miss other lights.",
        origin=_ONE_BY_ONE + ": of windows with 10 to 30 % outliers 65 to 94 % hit the light, 3 to 8 % without",
    )
    alike_colour: float = tuned(
        0.15,
        unit="share of the colour",
        meaning="Of two guesses of nearly one direction one is kept if their colours differ by at most this.",
        origin="docs/research-log.md, Time: leaves room for other guesses, so that one search finds more lights",
    )
    # lit_surface
    attempts: tuple[tuple[int, tuple[float, ...]], ...] = tuned(
        ((1200, (20.0, 30.0)), (800, (25.0, 40.0))),
        unit="blocks, degrees",
        meaning="Coarse blocks of each attempt; angles within which grid directions are first taken as one light.",
        origin=_TOGETHER + ": a second attempt raises those used from 156 to 174 of 200",
    )
    softening: tuple[tuple[float, float], ...] = tuned(
        ((0.15, 1e-2), (0.06, 5e-3), (0.03, 3e-3)),
        unit="cosine, brightest",
        meaning="Steps of the fit to coarse blocks: width of the terminator, over which a light fades in place of "
        "ending sharply, and standard deviation of residuals.",
        origin=_TOGETHER,
    )
    fine_softening: tuple[tuple[float, float], ...] = tuned(
        ((0.03, 3.0), (0.02, 1.5)),
        unit="cosine, noise",
        meaning="The same for fine blocks, with residuals in units of the noise.",
        origin=_TOGETHER,
    )
    least_block_noise: float = tuned(
        1e-3,
        unit="brightest",
        meaning="Fine blocks are fitted as if their noise were at least this.",
        origin=_HAND,
    )
    grid_residuals: tuple[float, float] = tuned(
        (6e-3, 4e-3),
        unit="brightest",
        meaning="Standard deviation of residuals on the grid of lights: at first, and on the improved surface.",
        origin=_HAND,
    )
    merged_lights_deg: tuple[float, float] = tuned(
        (8.0, 6.0),
        unit="degrees",
        meaning="Lights that are nearer to each other than this are merged into one: in the fit to coarse blocks, and "
        "in that to fine blocks.",
        origin=_HAND,
    )
    faintest_light: tuple[float, float] = tuned(
        (0.01, 0.005),
        unit="share of all light",
        meaning="Fainter lights are dropped: in the fit to coarse blocks, and in that to fine blocks.",
        origin=_HAND,
    )
    stretch_for_turn: float = tuned(
        0.4,
        unit="1/radian",
        meaning="Before the fit, F is known up to a rotation and a change of lengths. The standard deviation of the "
        "latter, relative, is this times the standard error of the rotation.",
        origin=_TOGETHER + ": without it ellipsoids whose silhouette fixes the rotation went 10° off",
    )
    # search
    believed_loss: float = tuned(
        1.5,
        unit="mean loss of a block",
        meaning="Lights and surface that were found together are rejected if they leave a larger mean loss.",
        origin=_TOGETHER + ": of 196 scenes under 1.2 one is 10° off; 1.4 to 2 have a median of 3°",
    )
    expected_loss: float = tuned(
        0.3,
        unit="mean loss of a block",
        meaning="Mean loss of a right solution in which every block is explained to within noise. If the loss is "
        "larger than expected, the rotation is stated to be less certain.",
        origin=_TOGETHER,
    )
    expected_loss_of_detail: float = tuned(
        2.5,
        unit="mean loss of a block",
        meaning="The expected loss grows by this times the share of the blocks that are not explained, because they "
        "contain detail finer than a block.",
        origin=_TOGETHER,
    )
    smooth_share: float = tuned(
        0.9,
        unit="share of the blocks",
        meaning="If a larger share of the blocks is explained, the surface has no such detail, and smooth_loss takes "
        "the place of the expected loss.",
        origin=_TOGETHER,
    )
    smooth_loss: float = tuned(
        0.85,
        unit="mean loss of a block",
        meaning="Largest mean loss that is expected of a right solution on such a smooth surface.",
        origin=_TOGETHER + ": 0.65 to 0.8 when right and 0.87 and more when not",
    )
    error_beyond_noise: float = tuned(
        3.0,
        unit="1",
        meaning="Factor from the standard error of F that noise alone would cause to the one that is stated. Where "
        "the mean loss is over 1, its square multiplies this factor.",
        origin=_TOGETHER,
    )
    # bundle_adjustment
    # irradiance_map
    harmonic_stages: tuple[tuple[tuple[int, ...], float], ...] = tuned(
        (((0, 1, 2), 3e-3), ((0, 1, 2, 4), 1e-3), ((0, 1, 2, 4, 6), 3e-4)),
        unit="degrees of harmonics, brightest",
        meaning="Stages of the fit: degrees of the harmonics, and the residual that they are expected to leave.",
        origin="R. Basri, D. W. Jacobs, IEEE TPAMI 25 (2003), Table 1; residuals by docs/research-log.md",
    )
    largest_coefficient: float = tuned(
        0.3,
        unit="brightest",
        meaning="Standard deviation of the prior of each coefficient of the map, whose mean is 0.",
        origin=_HAND,
    )
    core_deg: float = tuned(
        0.3,
        unit="degrees",
        meaning="Standard deviation of the normals of the core, the pixels whose normals follow from the ellipsoid, "
        "in the fit of the map.",
        origin=_MAP,
    )
    core_residual: float = tuned(
        3e-4,
        unit="brightest",
        meaning="Standard deviation, besides noise, of a core block's colour about F n.",
        origin=_TOGETHER + ": held so, 10 of 16 within 3°, 7 when held by a fixed 0.3°",
    )
    ring_blocks: int = tuned(
        2,
        unit="blocks",
        meaning="The surface grows outward from the core by rings of this width.",
        origin=_MAP + ": fitted everywhere at once a dome folded over, 9.1° for 2.0°",
    )
    map_normal_deg: float = tuned(
        3.0,
        unit="degrees",
        meaning="Standard deviation of a pixel's normal about that of its block, when the map gives each pixel its "
        "normal.",
        origin=_HAND,
    )
    # near_lights
    depth_stiffness: float = tuned(
        1e-3,
        unit="picture units per pixel",
        meaning="Under near lights depth is fitted at the corners of pixels. Twists within a pixel and differences of "
        "slope between neighbours are multiplied by this and minimised together with the residuals, because "
        "no colour determines twists.",
        origin="docs/research-log.md, Near lights whose places are told",
    )
    near_robust_width: float = tuned(
        2.0,
        unit="median residual",
        meaning="Width of the robust loss of the fit under near lights: the larger a pixel's residual is beyond it, "
        "the less influence the pixel has.",
        origin=_HAND,
    )


LIGHTS = LightsParameters()
