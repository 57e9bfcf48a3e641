"""One picture as every stage after the choice of pixels sees it."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Problem:
    """What a stage of recovery is given: colours in linear light, where they count, and how noisy they are.

    Camera frame, image row 0 at the top. ``rgb`` is what the stage is to explain: indirect light that was ``removed``
    is no longer in it.
    """

    rgb: np.ndarray  # (H, W, 3) float64, linear picture units; 0 where not usable
    usable: np.ndarray  # (H, W) bool: on the object, finite, not clipped, not dark
    mask: np.ndarray  # (H, W) bool, the object
    dark: np.ndarray  # (H, W) bool, pixels of the object that no light reaches: they have no colour
    ray: np.ndarray | None  # (H, W, 2) of a picture in perspective (``recover.geometry.rays``); None: parallel rays
    noise: float  # standard deviation of a channel, picture units
    removed: np.ndarray  # (H, W, 3) indirect light that was subtracted, picture units; 0 where none was

    @property
    def seen(self) -> np.ndarray:
        """(H, W) bool: pixels whose colour is known, dark ones among them."""
        return self.usable | self.dark

    @property
    def brightest(self) -> float:
        """The largest channel of the picture, picture units."""
        return float(self.rgb.max())

    def with_noise(self, noise: float) -> "Problem":
        """The same picture, its noise taken to be ``noise`` (standard deviation of a channel, picture units)."""
        return replace(self, noise=noise)
