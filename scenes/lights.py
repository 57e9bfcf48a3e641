"""Light sources: where they stand and how strong each wavelength is."""

from dataclasses import dataclass

import numpy as np

from configs.schema import DistantLight as DistantSpec
from scenes.spectra import emission


@dataclass(frozen=True)
class DistantLight:
    """Parallel light. A surface that faces it squarely, of reflectance S, has radiance spectrum · S (times 1/π · π)."""

    name: str
    direction: np.ndarray  # (3,) unit, toward the light, camera frame
    spectrum: np.ndarray  # (W,) on WAVELENGTHS: mean 1 over 400–700 nm, times the intensity


def build_light(spec: DistantSpec, number: int) -> DistantLight:
    where = f"lights[{number}].spectrum"
    direction = np.asarray(spec.direction, dtype=float)
    return DistantLight(
        name=spec.spectrum if isinstance(spec.spectrum, str) else f"light {number}",
        direction=direction / np.linalg.norm(direction),
        spectrum=spec.intensity * emission(spec.spectrum, where=where),
    )
