"""The tuned numbers of ``recover.cues``, with unit, meaning and origin.

The research log is docs/research-log.md; its "random scenes" are those of benchmarks/recover_shells.py.
"""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

FIRST_JUDGE = "chosen by hand when candidate ellipsoids were first judged; checked with benchmarks/recover_shells.py"
SILHOUETTE = "research log, 'What the outline tells': 613 random scenes, benchmarks/recover_outline.py"


@dataclass(frozen=True)
class CueParameters:
    """Every number of this package that experience chose. Read at the place of use, so that it can be overridden."""

    # shared
    robust_width: float = tuned(
        2.0,
        unit="standard errors",
        meaning="Width of the robust losses of this package: the larger a residual is beyond it, the less influence "
        "it has.",
        origin="research log, 'What the outline tells' (3 or 4: 7 to 8 wrong for 9, but a worse stated error)",
    )

    # linear_integrability
    derivative_sigma_px: float = tuned(
        1.5,
        unit="pixels",
        meaning="Standard deviation of the Gaussian whose derivatives are taken.",
        origin=FIRST_JUDGE,
    )
    camera_facing_share: float = tuned(
        0.97,
        unit="share of the normals",
        meaning="Normals that must face the camera under a rotation.",
        origin=FIRST_JUDGE,
    )
    frontal_deg: float = tuned(
        8.0,
        unit="degrees",
        meaning="A normal nearer to the direction of the camera faces it squarely.",
        origin=FIRST_JUDGE,
    )
    frontal_share: float = tuned(
        0.004,
        unit="share of the normals",
        meaning="At least this share of the normals must face the camera squarely, within frontal_deg. The off-axis "
        "angle of a set of normals is also the one that this share of them does not exceed.",
        origin=FIRST_JUDGE,
    )
    derivative_error: float = tuned(
        0.07,
        unit="of the size of all terms",
        meaning="Derivatives are taken over several pixels, so they are wrong by a share of their size. This share is "
        "added, in squares, to the noise where pixels get robust weights.",
        origin=FIRST_JUDGE,
    )
    normalised_curl_error: float = tuned(
        0.1,
        unit="of the size of the terms of the error",
        meaning="Another such share, used where the curl of the normals is divided by what noise and this error "
        "together make it, the normalised curl.",
        origin=FIRST_JUDGE,
    )
    start_separation_deg: float = tuned(
        12.0,
        unit="degrees",
        meaning="Least angle between the third rows of two likely rotations of one chirality.",
        origin=FIRST_JUDGE,
    )

    # silhouette
    lean_blur: float = tuned(
        0.05,
        unit="of the square root of the object's area",
        meaning="The mask is blurred by a Gaussian of this standard deviation; the slope of the result points outward "
        "everywhere on the object. How far all normals lean in that direction gives a first rotation.",
        origin=SILHOUETTE + "; chirality right in 1.000, with 0.15 in .93",
    )
    steepest: float = tuned(
        0.15, unit="n3", meaning="Slopes are divided by no smaller component toward the camera.", origin=SILHOUETTE
    )
    longest: float = tuned(
        1.15, unit="length of N", meaning="Longer N are shortened to this: only noise makes them so.", origin=SILHOUETTE
    )
    ring_edges_px: tuple[float, float, float] = tuned(
        (0.0, 2.5, 5.5),
        unit="pixels from the silhouette",
        meaning="Edges of the two rings of pixels from which normals at the silhouette are extrapolated.",
        origin=SILHOUETTE + " (0, 1.5, 4.5: as good)",
    )
    sectors: int = tuned(
        36, unit="sectors of the circle", meaning="Outward directions that are told apart.", origin=SILHOUETTE
    )
    outward_blur_px: float = tuned(
        2.5,
        unit="pixels",
        meaning="Standard deviation of the blur of the mask whose slope is the silhouette's outward direction.",
        origin=SILHOUETTE,
    )
    disagreement: float = tuned(
        9.0,
        unit="squared standard errors",
        meaning="The rotation from the means of all normals and the one from the silhouette are combined. If their "
        "squared difference is larger than this, the precision of the result is divided by the ratio.",
        origin=SILHOUETTE,
    )

    # convexity
    vote_blur: float = tuned(
        0.15,
        unit="of the square root of the object's area",
        meaning="Standard deviation of the blur of the mask for the choice between convex and concave: each normal "
        "votes with its component along the outward slope of the blurred mask.",
        origin="chosen by hand: broad, because all-lit pixels need not touch the border",
    )
    perspective_ratio: float = tuned(
        1.3,
        unit="ratio",
        meaning="In perspective only one of the convex/concave twins is integrable. If its curl, or residual, is "
        "smaller than that of the other by this factor, it is taken without asking the silhouette.",
        origin="research log, 'Perspective'",
    )


CUES = CueParameters()
