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
        6, unit="rounds", meaning="Rounds after which each must lessen the scatter by the factor below.", origin=LOG
    )
    rough_rounds: int = tuned(
        2, unit="rounds", meaning="Rounds whose gaps are smoothly interpolated; later ones complete them.", origin=LOG
    )
    once_more_below: float = tuned(
        0.98,
        unit="times the misfit",
        meaning="Misfit of the completed surface from which one more round is made.",
        origin=LOG,
    )
    # removal: convex or concave, and belief
    twin_gain: float = tuned(
        1.3,
        unit="times less misfit",
        meaning="Gain from which the twin is taken by its first surface (a shallow dent and its bump: 4.8 and 80).",
        origin=LOG,
    )
    twin_worth_rounds: float = tuned(
        0.95, unit="times the misfit", meaning="Misfit of the twin from which it gets rounds of its own.", origin=LOG
    )
    twin_gain_after_rounds: float = tuned(
        1.15, unit="times less scatter", meaning="Gain from which the twin is taken after its rounds.", origin=LOG
    )
    rescue_gain: float = tuned(
        1.05, unit="times less misfit", meaning="Gain that a failed estimate's surface must bring.", origin=LOG
    )
    rescue_rotation_deg: float = tuned(
        10.0, unit="degrees", meaning="Standard error of the rotation below which a failure is mended.", origin=LOG
    )
    correlated_is_noise: float = tuned(
        0.2,
        unit="times the white residual",
        meaning="Spatially correlated residual below which there is only noise (hills at noise 3e-3: 0 to .12, "
        "interreflection: .7 on).",
        origin=LOG,
    )


INTERREFLECTION = InterreflectionParameters()
