"""The tuned numbers of ``recover.ellipsoid``: thresholds, windows and schedules, with unit, meaning and origin.

"Standard deviations" are those of the noise of the distance to an ellipsoid (``recover.ellipsoid.distance``). The
research log is docs/research-log.md; its "random scenes" are those of benchmarks/recover_shells.py.
"""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

WHICH_SHELL = "research log, 'Which shell': random scenes with 10 to 20 % all-lit pixels, noise 0.3 %"
BY_HAND = "chosen by hand on random scenes (benchmarks/recover_shells.py)"
CREDIT = "research log, 'Which shell': chosen by hand, then checked on 340 random scenes"
SHELLS_GROWN = "chosen by hand when candidates were first grown from patches; checked with benchmarks/recover_shells.py"
PER_PIXEL = "research log, 'The rotation of robust': random scenes, benchmarks/recover_all_lit.py"
WIDE_LIGHTS = (
    "research log, 'Wide or many lights': sphere, ellipsoid and relief under lights of 20 to 40 degrees' radius"
)


@dataclass(frozen=True)
class EllipsoidParameters:
    """Every number of this package that experience chose. Read at the place of use, so that it can be overridden."""

    # fit, free_centre, specular
    acceptance_cut: float = tuned(
        2.5,
        unit="robust standard deviations s0 of r",
        meaning="A colour is accepted where |r| is at most this; beyond it outside the ellipsoid it is specular.",
        origin="report 2.2, from Rousseeuw & Leroy (1987)",
    )
    elemental_trials: int = tuned(
        1000,
        unit="random sets of six colours",
        meaning="Number of random sets of six colours to which an ellipsoid is fitted exactly, to start the search "
        "for the least median of squares. If half of the pixels see every light, about 16 sets contain only "
        "such pixels.",
        origin="chosen by hand: benchmarks/recover_shell_fit.py",
    )
    concentration_stages: tuple[tuple[int, int, int], ...] = tuned(
        ((600, 12, 2), (3000, 4, 3), (20_000, 2, 12)),
        unit="(pixels, candidates kept, C-steps) of each stage",
        meaning="Stages of that search: on so many pixels, so many of the best candidates are kept, and each is "
        "refitted so many times to the half of the pixels with the least squared residual (a C-step). The "
        "last number of C-steps also limits the refits to all pixels at the end.",
        origin="chosen by hand after Rousseeuw & Van Driessen (2006): benchmarks/recover_shell_fit.py",
    )

    # distance, refit
    averaging_window_px: int = tuned(
        5,
        unit="pixels",
        meaning="Side (odd) of the square over which distances to the ellipsoid are averaged, for every local mean.",
        origin="chosen by hand; research log, 'Which shell': 9 and 15 pixels tell purity no better",
    )
    window_mean_cut: float = tuned(
        3.0,
        unit="standard deviations of a window's mean",
        meaning="A pixel whose window's mean distance is larger does not lie on the ellipsoid.",
        origin="chosen by hand",
    )
    single_distance_cut: float = tuned(
        4.5,
        unit="standard deviations of a single distance",
        meaning="A pixel whose own distance is larger does not lie on the ellipsoid; wide, so that C is not biased.",
        origin="research log, 'The rotation of robust': 3.5 biases C 2.4 times as much (scan, natural lights, 3e-4)",
    )
    scale_quantile: float = tuned(
        0.25,
        unit="share",
        meaning="Quantile of |distance| that gives the robust scale: low, because outliers fill the upper ones.",
        origin="chosen by hand",
    )
    refit_clip: float = tuned(
        6.0,
        unit="robust standard deviations",
        meaning="Distances are clipped here before they are averaged over a window.",
        origin="chosen by hand",
    )

    # candidates: proposals from patches
    working_area_px: int = tuned(
        16_000,
        unit="pixels",
        meaning="Object area above which candidates are searched for on block means.",
        origin="chosen by hand: time against share of right choices, research log, 'Time'",
    )
    patch_half_widths_px: tuple[int, ...] = tuned(
        (4, 6, 9, 13, 18),
        unit="pixels on an object of 11 000 pixels (REFERENCE_AREA_PX)",
        meaning="Half the sides of the square patches of the picture, to each of which an ellipsoid is fitted as a "
        "proposal. They scale with the square root of the object's area.",
        origin=SHELLS_GROWN,
    )
    patch_spacing_px: float = tuned(
        5.0,
        unit="pixels on an object of 11 000 pixels (REFERENCE_AREA_PX)",
        meaning="Distance between the centres of neighbouring patches in the limit of small ones; larger patches are "
        "farther apart.",
        origin=SHELLS_GROWN,
    )
    patch_residual_cut: float = tuned(
        1.35,
        unit="times the residual that noise explains",
        meaning="A patch whose root-mean-square residual is larger than this multiple proposes no ellipsoid: it "
        "contains pixels of two ellipsoids.",
        origin=SHELLS_GROWN,
    )
    proposal_distance_cut: float = tuned(
        4.2,
        unit="standard deviations of a single distance",
        meaning="Proposals are ranked by their mean squared distance to a sample of the picture's colours; a distance "
        "beyond this one counts as this one.",
        origin=SHELLS_GROWN,
    )

    # candidates, region_growing: growth
    growth_reaches_px: tuple[int, ...] = tuned(
        (4, 4, 4, 4, 5, 6, 8, 10, 14, 20, 1000, 1000),
        unit="pixels",
        meaning="How far a region may grow in each round.",
        origin=SHELLS_GROWN,
    )
    final_mean_cuts: tuple[float, ...] = tuned(
        (4.5, 4.0, 3.5, 3.0, 3.0),
        unit="standard deviations of a window's mean",
        meaning="Cuts of the rounds after growth, in which the pixels of a candidate need not be connected.",
        origin=SHELLS_GROWN,
    )
    growing_distance_cut: float = tuned(
        4.0,
        unit="standard deviations of a single distance",
        meaning="A pixel farther from a growing ellipsoid is not near it; distances of its inliers count no more.",
        origin=SHELLS_GROWN,
    )
    near_share: float = tuned(
        0.85,
        unit="share of the usable pixels of a window",
        meaning="A pixel joins a region only where more of its window is near the ellipsoid.",
        origin=SHELLS_GROWN,
    )
    fewest_region_pixels: int = tuned(
        40, unit="pixels", meaning="A region with fewer pixels is given up.", origin=SHELLS_GROWN
    )

    # candidates: credit, a product of factors 1 / (1 + (value / halving)^2)
    curl_halving_credit: float = tuned(
        0.2,
        unit="root mean square curl over its terms",
        meaning="Candidate ellipsoids are ranked by support times credit. Credit is a product of factors 1 / (1 + "
        "(value / halving)²), each between 0 and 1; this and the next entries are the values at which one "
        "factor is one half. Here: the curl of the candidate's normals.",
        origin=CREDIT,
    )
    normalised_curl_halving_credit: float = tuned(
        1.2,
        unit="median |curl| over what noise and the model's error make of it",
        meaning="Normalised curl of the candidate's normals at which its factor of the credit is one half.",
        origin=CREDIT,
    )
    off_axis_halving_credit_deg: float = tuned(
        12.0,
        unit="degrees",
        meaning="Angle between the optical axis and the candidate's normal nearest to it at which this factor of the "
        "credit is one half.",
        origin=WHICH_SHELL,
    )
    scatter_halving_credit: float = tuned(
        0.15,
        unit="standard deviations",
        meaning="The root-mean-square distance of the candidate's inliers is 1 where noise is their only error; the "
        "excess over 1 at which this factor of the credit is one half.",
        origin=CREDIT,
    )
    unexplained_halving_credit: float = tuned(
        0.1,
        unit="1 - R^2 over all usable pixels",
        meaning="How far R² of the candidate over all usable pixels is below 1 where this factor of the credit is "
        "one half.",
        origin=WHICH_SHELL + "; .05 and .2 are as good",
    )
    outside_quantile: float = tuned(
        0.98,
        unit="share of the usable pixels",
        meaning="This quantile of the residual r over the usable pixels says how far outside the candidate the "
        "outermost pixels lie.",
        origin=WHICH_SHELL,
    )
    outside_halving_credit: float = tuned(
        1.0,
        unit="r, dimensionless",
        meaning="Value of that quantile at which this factor of the credit is one half. Below 0 the factor is 1.",
        origin=WHICH_SHELL,
    )
    not_frontal_credit: float = tuned(
        0.3,
        unit="factor",
        meaning="Factor of the credit of a candidate that no rotation turns so that its normals face the camera, and "
        "some squarely. For others it is 1.",
        origin=CREDIT,
    )

    # hidden_lights
    hidden_least_share: float = tuned(
        0.02,
        unit="share of the inliers",
        meaning="A light whose effect is below the noise of single pixels is looked for only among directions that at "
        "least this share of the inliers faces away from.",
        origin=PER_PIXEL,
    )
    hidden_most_share: float = tuned(
        0.6,
        unit="share of the inliers",
        meaning="And only among directions that at most this share of the inliers faces away from.",
        origin=PER_PIXEL,
    )
    hidden_chi_square: float = tuned(
        30.0,
        unit="chi-square of 3 degrees of freedom, the largest over all directions",
        meaning="Evidence above which a hidden light is believed and the pixels that miss it are left out.",
        origin=PER_PIXEL,
    )
    hidden_smoothing_px: float = tuned(
        1.0,
        unit="pixels",
        meaning="Standard deviation of the Gaussian mean of neighbours from which directions of normals are taken.",
        origin=PER_PIXEL,
    )
    hidden_distance_clip: float = tuned(
        5.0,
        unit="standard deviations of a single distance",
        meaning="Distances are clipped here before hidden lights are regressed on them.",
        origin=PER_PIXEL,
    )

    # membership
    membership_passes: int = tuned(
        2,
        unit="passes",
        meaning="The probability of each pixel to see every light depends on which pixels are taken for inliers, so "
        "it is computed this many times, each time with the likely pixels of the time before as inliers.",
        origin="research log, 'The rotation of robust': of 225 scenes over 10 degrees one 35, two 28, three 25",
    )
    membership_windows_px: tuple[int, int, int] = tuned(
        (3, 5, 9),
        unit="pixels",
        meaning="Sides of the windows of neighbours from which evidence is taken; the weights were fitted with these.",
        origin=PER_PIXEL,
    )
    alike_deg: float = tuned(
        4.0,
        unit="degrees",
        meaning="Width of the kernel under which normals of other pixels count as alike.",
        origin=PER_PIXEL,
    )
    direction_noise_rad: float = tuned(
        0.035,
        unit="radians",
        meaning="Directions of normals are averaged over as many neighbours as reduce their noise to this.",
        origin="research log, 'The rotation of robust': single pixels known to 10 degrees leave C ten times as far off",
    )

    # selection

    # from_patches
    least_support: float = tuned(
        0.06,
        unit="share of the usable pixels",
        meaning="Least share of the pixels that must lie on a candidate for it to be used. Smaller shares come about "
        "by chance if the noise is assumed too low.",
        origin=BY_HAND,
    )
    noise_factors: tuple[float, ...] = tuned(
        (1.0, 2.0, 4.0, 8.0, 16.0),
        unit="times the noise measured",
        meaning="The search for candidates is repeated with these multiples of the noise, in order, until one has "
        "least_support.",
        origin=BY_HAND,
    )

    # lack_of_fit
    least_explained_share: float = tuned(
        0.55,
        unit="share of the variance beyond noise",
        meaning="Share of the residual that the normal must explain for the lack of fit to be significant.",
        origin=WIDE_LIGHTS + "; their share is 0.6 to 0.9, that of interreflection 0.2",
    )
    least_explained_amount: float = tuned(
        5e-4,
        unit="of the brightest channel value",
        meaning="The standard deviation of the part of the residual that the normal explains must exceed this for the "
        "lack of fit to be significant.",
        origin=WIDE_LIGHTS + "; their amount is 1e-3 and more, that of the scan under natural lights 4e-4",
    )
    explained_over_noise: float = tuned(
        0.5,
        unit="standard deviations of a single distance",
        meaning="The same standard deviation must also exceed this multiple of the noise. The choice of inliers and "
        "the bias by noise alone make 0.2 to 0.45 of it.",
        origin=WIDE_LIGHTS,
    )


ELLIPSOID = EllipsoidParameters()
