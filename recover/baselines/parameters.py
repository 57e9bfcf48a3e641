"""Tuned numbers of the baselines. The publications give none of them; the values are this project's."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned

_HAND = "chosen by hand; the publication gives no value"


@dataclass(frozen=True)
class BaselineParameters:
    """Read at the place of use, as ``BASELINES.walk_steps``."""

    # kontsevich1994: the rotation
    step_deviations_rad: tuple[float, float] = tuned(
        (0.8, 1e-3),
        unit="radians",
        meaning="Standard deviation of a step at the start of the walk and at its end, geometric between.",
        origin=_HAND,
    )
    # kontsevich1994: the region
    seed_side_px: int = tuned(9, unit="pixels", meaning="Side of the squares that regions grow from.", origin=_HAND)
    region_tolerance: float = tuned(
        3.0,
        unit="standard deviations of the seed",
        meaning="A neighbour whose colour is this near to the ellipsoid joins the region.",
        origin=_HAND,
    )
    # nikolaev1975


BASELINES = BaselineParameters()
