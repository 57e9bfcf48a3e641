"""Tuned numbers of ``recover.depth``. Read at the place of use, as ``DEPTH.robust_width``."""

from dataclasses import dataclass

from huesphere.recover.geometry.least_squares import Schedule
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
    tear_shrink: float = tuned(
        0.85,
        unit="1",
        meaning="Factor of the scale of residuals from one round of the robust model to the next.",
        origin=BY_HAND,
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
    start_steepest_n3: float = tuned(
        0.08,
        unit="1",
        meaning="Normals of the start with less n3 than this are taken to have it.",
        origin=BY_HAND,
    )
    start_weight: float = tuned(
        1e-2,
        unit="weight of all-lit pixels",
        meaning="Weight, in the depth of the start, of normals of other pixels.",
        origin=BY_HAND,
    )
    robust_width: float = tuned(
        4.25,
        unit="standard deviations",
        meaning="Width of the robust losses of a pixel.",
        origin=BY_HAND,
    )
    held_descent: Schedule = tuned(  # noqa: RUF009 (a Schedule is frozen)
        Schedule(
            first_damping=1e-7,
            most_steps=6,
            trials=4,
            relative_gain=1e-3,
            least_damping=1e-7,
            least_raised=3e-5,
            raise_by=30.0,
            lower_by=5.0,
        ),
        unit="damping times the diagonal",
        meaning="Descent of the depths with F held, under the Cauchy loss.",
        origin=BY_HAND,
    )
    free_descent: Schedule = tuned(  # noqa: RUF009 (a Schedule is frozen)
        Schedule(
            first_damping=1e-7,
            most_steps=12,
            trials=4,
            relative_gain=3e-4,
            least_damping=1e-7,
            least_raised=3e-5,
            raise_by=30.0,
            lower_by=5.0,
        ),
        unit="damping times the diagonal",
        meaning="Descent of the depths and F, under the loss of Geman and McClure.",
        origin=BY_HAND,
    )
    outlier_rounds: tuple[int, ...] = tuned(
        (2, 2, 2),
        unit="steps",
        meaning="Steps after each time that neighbourhoods which are not explained are looked for.",
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
    prior_steps: int = tuned(
        4,
        unit="steps",
        meaning="Steps of the surface and of the scale of its prior, together.",
        origin=PRIOR,
    )
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
