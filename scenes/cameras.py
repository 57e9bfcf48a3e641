"""Camera spectral sensitivities Q(λ): measured, standard, approximated, or from a file."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.spectra import CsvSpectrum
from huesphere.scenes.colour_tables import colour_science
from huesphere.scenes.spectra import WAVELENGTHS, known_name, on_grid, read_csv

# Peaks and widths (nm) of a three-chip video camera with dichroic prism, of the family of the report's Sony DXC-151,
# whose own curves are not published: an approximation, R G B.
THREE_CHIP = ((586.0, 28.0), (526.0, 28.0), (450.0, 22.0))

MEASURED = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
OBSERVER = "CIE 1931 2 Degree Standard Observer"
NAMES = (*MEASURED, "CIE 1931", "three-chip")


def sensitivity(spec: str | CsvSpectrum, *, where: str = "camera.sensitivity") -> np.ndarray:
    """Spectral sensitivities on WAVELENGTHS, shape (W, 3), R G B (for CIE 1931: X Y Z).

    Measured tables have small negative entries, which are noise: they are set to 0. Raises InputError for an unknown
    name or a bad file.
    """
    if isinstance(spec, CsvSpectrum):
        values = read_csv(Path(spec.csv), columns=3, where=where)
    else:
        values = _named(spec, where)
    values = np.maximum(values, 0.0)
    if (values.max(axis=0) <= 0).any():
        raise InputError(f"{where}: a channel is blind between 380 and 780 nm")
    return values


def _named(name: str, where: str) -> np.ndarray:
    colour = colour_science()

    key = known_name(name, NAMES, "camera", where)
    if key == "three-chip":
        return np.stack([np.exp(-0.5 * ((WAVELENGTHS - c) / s) ** 2) for c, s in THREE_CHIP], axis=-1)
    if key == "CIE 1931":
        return observer()
    return on_grid(colour.MSDS_CAMERA_SENSITIVITIES[key])


def observer() -> np.ndarray:
    """The colour-matching functions of the CIE 1931 2° observer on WAVELENGTHS, (W, 3)."""
    return on_grid(colour_science().MSDS_CMFS[OBSERVER])


def chromaticities(values: np.ndarray) -> tuple[float, ...] | None:
    """CIE x, y of red, green, blue and white of a camera with sensitivities ``values`` (W, 3).

    They are those of the linear map from the camera's colours to CIE 1931 XYZ that fits the observer best by least
    squares, with (1, 1, 1) as white; exact only for a camera that sees as the observer does. None where a primary has
    no chromaticity, its X + Y + Z being 0 or less.
    """
    primaries = np.linalg.lstsq(values, observer(), rcond=None)[0]  # rows: XYZ of red, green, blue
    xyz = np.vstack([primaries, primaries.sum(axis=0)])
    total = xyz.sum(axis=1)
    if not (total > 1e-6 * np.abs(xyz).max()).all():
        return None
    return tuple(round(float(v), 6) for v in (xyz[:, :2] / total[:, None]).ravel())
