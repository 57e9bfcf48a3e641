"""The tuned numbers of ``recover.pixels``, with unit, meaning and origin."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned


@dataclass(frozen=True)
class PixelParameters:
    """Every number of this package that experience chose. Read at the place of use, so that it can be overridden."""

    # all modules, and those of other packages that need enough pixels for a statistic
    fewest_pixels: int = tuned(
        50,
        unit="pixels",
        meaning="A region with fewer pixels is not used for a fit or a statistic.",
        origin="chosen by hand",
    )

    # rank
    rank_window_px: int = tuned(
        7, unit="pixels", meaning="Side (odd) of the square patch whose rank is told.", origin="chosen by hand"
    )
    rank_noise_ratio: float = tuned(
        3.0,
        unit="times the largest variance that noise alone makes",
        meaning="A dimension of a patch's colours counts from this variance on.",
        origin="chosen by hand: tests/test_recover_pixels_rank.py",
    )

    # uncertain_component
    subtracted_light_error: float = tuned(
        0.2,
        unit="share of the subtracted light, standard deviation",
        meaning="How wrong the light subtracted from a pixel may be, along its own colour.",
        origin="research log, 'Interreflection removed': chosen by hand on bust and scan",
    )


PIXELS = PixelParameters()
