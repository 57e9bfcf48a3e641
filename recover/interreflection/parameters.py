"""Tuned numbers of the interreflection package: how its rounds go, and when a removal is believed."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

LOG = "docs/research-log.md, interreflection; benchmarks/recover_unbounce.py"


@dataclass(frozen=True)
class InterreflectionParameters:
    """Numbers of ``recover.interreflection``."""

    # albedo
    first_albedos: tuple[float, ...] = tuned(
        (0.0, 0.3, 0.6, 0.9),
        unit="albedo",
        meaning="Effective albedos that the fit starts from, one after another: its misfit has several valleys.",
        origin=LOG,
    )
    # removal: the gather operator K
    azimuths: int = tuned(
        24, unit="directions", meaning="Azimuths around each pixel in which light is gathered.", origin=LOG
    )
    steepest_n3: float = tuned(
        0.08, unit="", meaning="Least n3 of the normals that gather light; steeper ones stand as if at it.", origin=LOG
    )
    # removal: rounds
    most_rounds: int = tuned(16, unit="rounds", meaning="Rounds of removal and recovery, at most.", origin=LOG)
    rounds_without_gain: int = tuned(
        3, unit="rounds", meaning="Rounds without a better one after which they end.", origin=LOG
    )
    rounds_for_sure: int = tuned(
        6, unit="rounds", meaning="Rounds after which each must lessen the scatter by the factor below.", origin=LOG
    )
    scatter_must_fall_to: float = tuned(
        0.9, unit="times that before", meaning="Scatter of a late round from which another one follows.", origin=LOG
    )
    rough_rounds: int = tuned(
        2, unit="rounds", meaning="Rounds whose gaps are smoothly interpolated; later ones complete them.", origin=LOG
    )
    completion_head_start: float = tuned(
        1.5, unit="times", meaning="Scatter that the first completed round may have beside the best before.", origin=LOG
    )
    settled_deg: float = tuned(
        0.01, unit="degrees", meaning="Median turn of the normals at which the rounds have converged.", origin=LOG
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
    twin_pixels: int = tuned(
        4000, unit="pixels", meaning="Pixels that tell twins apart: larger pictures are halved for it.", origin=LOG
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
