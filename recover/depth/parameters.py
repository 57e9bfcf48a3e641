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
        meaning="A normal with less n3 than this, some 87 degrees from the view, has a slope that means nothing.",
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
        meaning="No smaller jump of depth is looked for.",
        origin=BY_HAND,
    )
    tear_width: float = tuned(
        3.0,
        unit="robust standard deviations",
        meaning="A difference of depth with a greater residual is taken for an occlusion.",
        origin=BY_HAND,
    )
    # joint_fit
    robust_width: float = tuned(
        4.25,
        unit="standard deviations",
        meaning="Width of the robust losses of a pixel.",
        origin=BY_HAND,
    )
    neighbourhood_cut: float = tuned(
        4.5,
        unit="median square of the residuals",
        meaning="A neighbourhood with a greater mean square is not explained.",
        origin=BY_HAND,
    )
    largest_square: float = tuned(
        50.0,
        unit="variance of the noise",
        meaning="Squared residual that one pixel adds to this mean, at most.",
        origin=BY_HAND,
    )
    score_block_px: int = tuned(
        16,
        unit="pixels",
        meaning="Side of the blocks of pixels whose residuals may be correlated, for the covariance of F.",
        origin=BY_HAND,
    )
    # smoothness_prior
    prior_window_px: float = tuned(
        1.5,
        unit="pixels",
        meaning="Standard deviation of the neighbourhood over which the scale of the prior is averaged.",
        origin=PRIOR,
    )
    prior_outlier: float = tuned(
        4.0,
        unit="standard deviations",
        meaning="A pixel with a greater residual tells nothing of the scale.",
        origin=PRIOR,
    )
    posterior_inflation: float = tuned(
        1.3,
        unit="spread of the samples",
        meaning="Posterior standard deviation: the scale is an estimate too, and pairs of pixels are not independent.",
        origin=PRIOR + ": measured",
    )


DEPTH = DepthParameters()
