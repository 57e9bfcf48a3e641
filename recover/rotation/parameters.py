"""Tuned numbers of ``recover.rotation``. Read at the place of use, as ``ROTATION.robust_width``."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

BY_HAND = "chosen by hand"
ROTATION_OF_ROBUST = (
    "docs/research-log.md, The rotation of robust: random scenes of benchmarks/recover_random_scenes.py"
)


@dataclass(frozen=True)
class RotationParameters:
    """Every number of this package that experience chose."""

    # more than one module
    distinct_rad: float = tuned(
        0.25,
        unit="radians",
        meaning="Rotations farther apart than this are two solutions; no step of the tangents turns by more.",
        origin=BY_HAND,
    )
    step_tolerance_rad: float = tuned(
        1e-3,
        unit="radians",
        meaning="A last step (tangents) or a last round (weak form) that turned by less has converged.",
        origin=BY_HAND,
    )
    round_tolerance_rad: float = tuned(
        1e-4,
        unit="radians",
        meaning="The alternation, and the reweighting of the weak form, end with a round that turned by less.",
        origin=BY_HAND,
    )
    most_backward_share: float = tuned(
        0.05,
        unit="share of the normals",
        meaning="A rotation is dropped if a larger share of its normals faces away from the camera, unless that is "
        "true of all.",
        origin=BY_HAND,
    )
    pooled_robust_width: float = tuned(
        2.5,
        unit="standard deviations",
        meaning="Width of the Cauchy loss of residuals that are means over many pixels: bumps, or neighbouring cells.",
        origin=ROTATION_OF_ROBUST + "; 4 and 8 leave 30 and 42 scenes over 10° where 2.5 leaves 27",
    )
    # tangents
    promising_loss: float = tuned(
        1.3,
        unit="least loss of all starts",
        meaning="Starts up to so many times the least loss after their first steps are refined further.",
        origin=BY_HAND,
    )
    steepest_slope: float = tuned(
        15.0,
        unit="1",
        meaning="Slopes at which the tangents are taken are clipped to this.",
        origin=BY_HAND,
    )
    slope_blur_px: float = tuned(
        1.0,
        unit="pixels",
        meaning="Least standard deviation of the blur of the slopes at which the tangents are taken; the most"
        " is four times it.",
        origin=BY_HAND,
    )
    blurred_normal_noise_rad: float = tuned(
        0.035,
        unit="radians",
        meaning="The blur is as wide as leaves this noise in the normals.",
        origin=BY_HAND,
    )
    cell_robust_width: float = tuned(
        3.0,
        unit="standard deviations",
        meaning="Width of the Cauchy loss of the residual of one cell.",
        origin=BY_HAND,
    )
    neighbourhood_cells: float = tuned(
        2.5,
        unit="cells",
        meaning="Standard deviation of the Gaussian neighbourhood of a cell whose mean residual is tested too: pixels "
        "that miss a light and yet lie near the ellipsoid show only there.",
        origin=ROTATION_OF_ROBUST,
    )
    typical_misfit: float = tuned(
        10.0,
        unit="variance of the noise",
        meaning="The mean residual of a neighbourhood of cells is held to the noise alone. Only if the squared "
        "residual of a typical cell exceeds this, because cells are not planes, neighbourhoods are allowed "
        "more, in proportion to it.",
        origin=BY_HAND,
    )
    full_weight_quantile: float = tuned(
        0.9,
        unit="quantile",
        meaning="The robust weights of the cells are divided by this quantile of them, so that the best cells keep "
        "about full weight where an error reduces the weights of all.",
        origin=BY_HAND,
    )
    silhouette_weight: float = tuned(
        1.5,
        unit="1",
        meaning="The silhouette's estimate of the rotation counts this much more than its standard error alone would "
        "give, and twice that where starts are compared.",
        origin="benchmarks/recover_outline.py; docs/research-log.md",
    )
    ellipsoid_overconfidence: float = tuned(
        6.0,
        unit="1",
        meaning="Standard error of the ellipsoid over the one that noise alone would give: there are outliers among "
        "its pixels.",
        origin=ROTATION_OF_ROBUST + "; 2, 3 and 10 leave 42, 40 and 34 scenes over 10° where 6 leaves 34",
    )
    # weak_form
    bump_radius_px: float = tuned(
        6.0,
        unit="pixels",
        meaning="Least radius of a test function at first; the most is twice it, and half of it where few fit"
        " the region.",
        origin=BY_HAND,
    )
    bump_radius_share: float = tuned(
        1 / 30,
        unit="square root of the area of the region",
        meaning="Radius of a test function, within these limits.",
        origin=BY_HAND,
    )
    fewest_bumps: int = tuned(
        12,
        unit="test functions",
        meaning="With fewer, smaller ones are tried, and then the pixels are too scattered.",
        origin=BY_HAND,
    )
    independent_radii: float = tuned(
        4.0,
        unit="radii",
        meaning="Side of the squares of test functions whose residuals count as one for the covariance: they overlap.",
        origin=BY_HAND,
    )
    speck_window_px: int = tuned(
        5,
        unit="pixels",
        meaning="Side of the window over which the majority decides whether a pixel belongs to the region.",
        origin=BY_HAND,
    )


ROTATION = RotationParameters()
