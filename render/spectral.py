"""From transport and spectra to colour: the whole of the wavelength, as one small matrix."""

import numpy as np

from scenes.build import Scene
from scenes.spectra import STEP


def colours_by_order(scene: Scene, orders: int) -> np.ndarray:
    """Colour that each light gives after k+1 reflections, b_ik = ∫ E_i S^(k+1) Q dλ, shape (L, orders, 3).

    k = 0 is the report's Eq. (3). Camera units before exposure. The object's reflectance is material 0.
    """
    surface = scene.reflectances[0]
    powers = surface[None] ** np.arange(1, orders + 1)[:, None]  # (orders, W)
    spectra = np.stack([light.spectrum for light in scene.lights])  # (L, W)
    return np.einsum("lw,kw,wc->lkc", spectra, powers, scene.sensitivity) * STEP


def linear_model(scene: Scene) -> np.ndarray:
    """F = B A of Eqs. (3)–(6), (3, 3): colour of a pixel that sees every light, before exposure, ρ = F n."""
    B = colours_by_order(scene, 1)[:, 0].T  # Eq. (3), (5): one column a light
    A = np.stack([light.direction for light in scene.lights])  # Eq. (5): one row a light
    return B @ A  # Eq. (6)
