"""Tuned numbers of the methods: when a fit is believed, and when ``auto`` takes which step."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

RANDOM_SCENES = "benchmarks/recover_random_scenes.py, development scenes"


@dataclass(frozen=True)
class MethodParameters:
    """Thresholds of ``recover.methods``. Angles in degrees, noise in picture units unless said otherwise."""

    # pipeline
    least_signal: float = tuned(
        1.5,
        unit="times the noise",
        meaning="The colours' variation, their weakest direction and C must exceed it; pure noise has 1.",
        origin="chosen by hand between noise (1) and the weakest pictures that could be recovered",
    )
    least_r2: float = tuned(
        0.9,
        unit="",
        meaning="Robust R² below which no ellipsoid is said to hold most pixels.",
        origin="the report's 4.2, where its pictures have .99",
    )
    least_r2_with_silhouette: float = tuned(
        0.7,
        unit="",
        meaning="The same where the silhouette agrees with the ellipsoid.",
        origin=f"{RANDOM_SCENES}: of 22 right ellipsoids under .9 all but one are above",
    )
    most_negative_n3: float = tuned(
        0.05,
        unit="share of normals",
        meaning="More normals than this that face away from the camera end in the status n3-signs.",
        origin="report 3.3: more than just a few negative values",
    )
    # rotation
    fine_detail_misfit: float = tuned(
        1.3,
        unit="times the noise",
        meaning="Residual of the tangents above which the weak form is asked as well.",
        origin=RANDOM_SCENES,
    )
    noise_free_misfit: float = tuned(
        5.0,
        unit="times the noise",
        meaning="Residual of the tangents above which their covariance says nothing.",
        origin=RANDOM_SCENES,
    )
    fewest_bumps: int = tuned(
        60,
        unit="test functions",
        meaning="With fewer, the scatter of the weak form's residuals says nothing of its error.",
        origin=RANDOM_SCENES,
    )
    shadow_inflation: float = tuned(
        2.5,
        unit="times",
        meaning="How much farther than by noise unrecognised shadowed pixels turn the rotation.",
        origin=RANDOM_SCENES,
    )
    calm_loss: float = tuned(
        0.3, unit="", meaning="Normalised robust loss that pure noise leaves.", origin=RANDOM_SCENES
    )
    medium_loss: float = tuned(
        0.64, unit="", meaning="Normalised robust loss at which the inflation above holds.", origin=RANDOM_SCENES
    )
    high_loss: float = tuned(
        4.0,
        unit="",
        meaning="Normalised robust loss from which rotations all over the sphere are tried.",
        origin=RANDOM_SCENES,
    )
    silhouette_conflict: float = tuned(
        12.0,
        unit="squared standard errors",
        meaning="Disagreement with the silhouette from which rotations all over the sphere are tried.",
        origin=RANDOM_SCENES,
    )
    clear_runner_up: float = tuned(
        100.0,
        unit="increase of the relative loss times the degrees of freedom",
        meaning="The second-best rotation of the tangents is ruled out if its loss is larger than that of the best by "
        "this. The nearer it is, the larger is the stated error of the rotation.",
        origin=RANDOM_SCENES,
    )
    # robust
    undetermined_rotation_deg: float = tuned(
        10.5,
        unit="degrees",
        meaning="Standard error of the rotation beyond which it is called undetermined.",
        origin="benchmarks/recover_shells.py, held-out scenes and three sets more",
    )
    joint_lights_from_deg: float = tuned(
        5.0,
        unit="degrees",
        meaning="Standard error of the rotation from which lights and surface are estimated jointly.",
        origin="benchmarks/recover_shells.py",
    )
    most_off_axis_deg: float = tuned(
        10.0,
        unit="degrees",
        meaning="Off-axis angle of the normal nearest to the camera beyond which the rotation is undetermined.",
        origin="benchmarks/recover_shells.py",
    )
    # initial
    most_lit_share: float = tuned(
        0.45,
        unit="share of the object",
        meaning="Inliers of the first ellipsoid below which it may be a wrong one.",
        origin="research log, Which shell `auto` begins with",
    )
    calm_ratio: float = tuned(
        1.0,
        unit="times the white residual",
        meaning="Spatially correlated residual that removal of interreflection must leave less of.",
        origin="research log, Which shell `auto` begins with",
    )
    calmer_ratio: float = tuned(
        0.8,
        unit="times that before",
        meaning="And less than this share of what there was before the removal.",
        origin="research log, Which shell `auto` begins with",
    )
    sure_removal_gain: float = tuned(
        5.0,
        unit="times less misfit",
        meaning="Gain from which removal of interreflection is believed whatever is left.",
        origin="research log, Which shell `auto` begins with",
    )
    far_less_correlated: float = tuned(
        0.25,
        unit="times that of the first",
        meaning="Spatially correlated residual of an ellipsoid from patches that replaces the first one.",
        origin="research log, Which shell `auto` begins with",
    )
    least_patch_share: float = tuned(
        0.1,
        unit="share of the object",
        meaning="Inliers of an ellipsoid from patches that may replace one with interreflection removed.",
        origin="research log, Which shell `auto` begins with",
    )
    most_correlated_deg: float = tuned(
        1.0,
        unit="degrees",
        meaning="Spatially correlated residual, as an angle, beyond which an unexplained ellipsoid is not believed.",
        origin="research log, Which shell `auto` begins with",
    )
    # auto
    least_core_share: float = tuned(
        0.08,
        unit="share of the object",
        meaning="An ellipsoid is bent if its residual depends smoothly on the normal, as under wide lights; the bend "
        "is the standard deviation of that part of the residual. Its core, the pixels that see every light in "
        "full, must be at least this share.",
        origin="benchmarks/recover_every_pixel.py, wide lights",
    )
    straighter: float = tuned(
        10.0,
        unit="times",
        meaning="The bend of the core's ellipsoid must be smaller by this factor than that of the first ellipsoid of "
        "all pixels, or its residual must be white.",
        origin="benchmarks/recover_every_pixel.py, wide lights",
    )
    most_core_off_axis_deg: float = tuned(
        5.0,
        unit="degrees",
        meaning="Off-axis angle of the core's normal nearest to the camera, beyond its standard error.",
        origin="domes .9, half a sky 10",
    )
    least_straightened: float = tuned(
        0.2,
        unit="share of the bend",
        meaning="Removal of interreflection is withdrawn if more than this share of the bend remains after it: then "
        "the bend was not due to interreflection.",
        origin="a bowl .09; discs of light .26 and .45",
    )
    least_explained: float = tuned(
        0.75,
        unit="share of the object",
        meaning="What lights or the irradiance map must explain for the status to be ok.",
        origin="benchmarks/recover_every_pixel.py, wide lights",
    )
    # near lights
    near_hollow_gain: float = tuned(
        1.3,
        unit="times less residual",
        meaning="Gain from which a hollow is taken before a dome under near lights.",
        origin="tests/test_recover_lights_near_lights.py",
    )
    near_most_residual: float = tuned(
        0.004,
        unit="of the brightest colour",
        meaning="Median residual beyond which near lights do not explain the picture.",
        origin="tests/test_recover_lights_near_lights.py",
    )
    near_most_noise: float = tuned(
        3.0,
        unit="times the camera's noise",
        meaning="The same where the camera's noise is known and larger.",
        origin="tests/test_recover_lights_near_lights.py",
    )
    near_undetermined_deg: float = tuned(
        9.0,
        unit="degrees",
        meaning="Standard error of the rotation beyond which it is called undetermined under near lights.",
        origin="tests/test_recover_lights_near_lights.py",
    )


METHOD = MethodParameters()
