"""Tuned numbers of the interreflection package: how its rounds go, and when a removal is believed."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

LOG = "docs/research-log.md, interreflection; benchmarks/recover_unbounce.py"


@dataclass(frozen=True)
class InterreflectionParameters:
    """Numbers of ``recover.interreflection``."""

    # albedo
    # removal: the gather operator K
    azimuths: int = tuned(
        24, unit="directions", meaning="Azimuths around each pixel in which light is gathered.", origin=LOG
    )
    # removal: rounds
    most_rounds: int = tuned(16, unit="rounds", meaning="Rounds of removal and recovery, at most.", origin=LOG)
    rounds_for_sure: int = tuned(
        6,
        unit="rounds",
        meaning="After so many rounds another one follows only if the last one lowered the scatter of the inliers to "
        "0.9 of what it was before.",
        origin=LOG,
    )
    rough_rounds: int = tuned(
        2,
        unit="rounds",
        meaning="In so many first rounds gaps of the surface are interpolated smoothly; in later ones the method that "
        "labels every pixel fills them.",
        origin=LOG,
    )
    once_more_below: float = tuned(
        0.98,
        unit="times the misfit",
        meaning="After the last round the indirect light is predicted again from the completed surface. One more "
        "round is made only if that lowers the misfit of the inliers to at most this multiple.",
        origin=LOG,
    )
    # removal: convex or concave, and belief
    twin_gain: float = tuned(
        1.3,
        unit="times less misfit",
        meaning="If the light predicted by one of the convex/concave twins leaves a misfit smaller by this factor "
        "than that by the other, this decides between them at once (a shallow dent and its bump: 4.8 and 80).",
        origin=LOG,
    )
    twin_worth_rounds: float = tuned(
        0.95,
        unit="times the misfit",
        meaning="If that factor does not decide, both twins are followed through their rounds, provided that the "
        "second twin's misfit is below this multiple of the misfit without any removal.",
        origin=LOG,
    )
    twin_gain_after_rounds: float = tuned(
        1.15,
        unit="times less scatter",
        meaning="After its rounds a twin is taken if its scatter is smaller by this factor than that of the other.",
        origin=LOG,
    )
    rescue_gain: float = tuned(
        1.05,
        unit="times less misfit",
        meaning="If recovery from the picture as it is failed, interreflection is removed only where that lowers the "
        "misfit by at least this factor.",
        origin=LOG,
    )
    rescue_rotation_deg: float = tuned(
        10.0,
        unit="degrees",
        meaning="An estimate after removal replaces a failed one only if the standard error of its rotation is below "
        "this.",
        origin=LOG,
    )
    correlated_is_noise: float = tuned(
        0.2,
        unit="times the white residual",
        meaning="Spatially correlated residual below which there is only noise (hills at noise 3e-3: 0 to .12, "
        "interreflection: .7 on).",
        origin=LOG,
    )


INTERREFLECTION = InterreflectionParameters()
