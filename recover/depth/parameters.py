"""Tuned numbers of ``recover.depth``. Read at the place of use, as ``DEPTH.robust_width``."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

BY_HAND = "chosen by hand"
PRIOR = "docs/research-log.md, A prior on the surface"


@dataclass(frozen=True)
class DepthParameters:
    """Every number of this package that experience chose."""

    # integration
    steepest_n3: float = tuned(
        0.05,
        unit="1",
        meaning="A normal with less n3 is taken as unknown: it is 87 degrees or more from the view, where an error of "
        "one degree changes the slope by a quarter or more.",
        origin=BY_HAND,
    )
    gap_weight: float = tuned(
        1e-3,
        unit="weight of known slopes",
        meaning="Weight, in gaps, of the smoothness of slopes (Harris) and of the flatness of depth (Poisson).",
        origin="benchmarks/recover_depth.py",
    )
    least_tear_px: float = tuned(
        0.05,
        unit="pixels",
        meaning="The width in the next entry is at least this, however small the robust standard deviation is.",
        origin=BY_HAND,
    )
    tear_width: float = tuned(
        3.0,
        unit="robust standard deviations",
        meaning="Difference of depth between neighbouring pixels, less the one that their slopes predict, at which "
        "its weight has fallen to a quarter: larger ones are occlusions, where the depth may jump.",
        origin=BY_HAND,
    )
    # joint_fit
    robust_width: float = tuned(
        4.25,
        unit="standard deviations",
        meaning="Width of the robust losses of the joint fit: the larger the residual of a pixel's colour is beyond "
        "it, the less influence the pixel has.",
        origin=BY_HAND,
    )
    neighbourhood_cut: float = tuned(
        4.5,
        unit="median of the squared residuals, or the variance of the noise if that is larger",
        meaning="A pixel is an outlier if the mean of the squared residuals over 3 × 3 pixels exceeds this.",
        origin=BY_HAND,
    )
    largest_square: float = tuned(
        50.0,
        unit="variance of the noise",
        meaning="A larger squared residual of a single pixel counts as this in that mean, so that one pixel alone "
        "makes few outliers.",
        origin=BY_HAND,
    )
    score_block_px: int = tuned(
        16,
        unit="pixels",
        meaning="Side of the square blocks for the covariance of F: residuals within a block may be correlated, those "
        "of different blocks are taken as independent.",
        origin=BY_HAND,
    )
    # smoothness_prior
    prior_window_px: float = tuned(
        1.5,
        unit="pixels",
        meaning="The smoothness prior has a scale s for each pair of neighbouring pixels, the expected difference of "
        "their slopes. s² is averaged over a Gaussian neighbourhood with this standard deviation.",
        origin=PRIOR,
    )
    prior_outlier: float = tuned(
        4.0,
        unit="standard deviations",
        meaning="A pixel with a larger residual of its colour is left out of the averages that give the scale s.",
        origin=PRIOR,
    )
    posterior_inflation: float = tuned(
        1.3,
        unit="spread of the samples",
        meaning="The uncertainty of slopes under the prior is the spread of samples of the posterior times this: the "
        "scale s is an estimate too, and pairs of pixels are not independent.",
        origin=PRIOR + ": measured",
    )


DEPTH = DepthParameters()
