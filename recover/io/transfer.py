"""Transfer functions that picture files name: powers, sRGB, and the code points of ITU-T H.273.

Each becomes a ``Transfer``: a function from stored samples to linear light, with a name and the words of its source.
"""

from collections.abc import Callable

import numpy as np

from huesphere.recover.io.stored import Transfer
from huesphere.scenes.colour_tables import colour_science
from huesphere.scenes.encoding import decode_srgb

SRGB_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
PQ_PEAK = 10_000.0  # cd/m² at full scale of the perceptual quantiser, SMPTE ST 2084


def linear(source: str) -> Transfer:
    """Samples that are linear as they stand."""
    return Transfer("linear", source, lambda values: values)


def srgb(source: str) -> Transfer:
    """Samples encoded as IEC 61966-2-1 says."""
    return Transfer("sRGB", source, decode_srgb)


def power(exponent: float, source: str) -> Transfer | None:
    """Light as a power of the samples; None for an exponent that no picture has."""
    if not 0.2 < exponent < 10:
        return None
    if abs(exponent - 1) < 1e-3:
        return linear(source)
    return Transfer(f"gamma {exponent:.3g}", source, lambda values: np.maximum(values, 0.0) ** exponent)


def png_gamma(gamma: float, chromaticities: tuple[float, ...] | None, source: str) -> Transfer | None:
    """The transfer function of a PNG's gAMA: samples are light to the power ``gamma``.

    0.45455 beside the primaries of sRGB is what programs write for samples of sRGB (PNG, 3rd edition, 11.3.2.5).
    """
    if not gamma > 0:
        return None
    is_srgb = chromaticities is not None and np.allclose(chromaticities, SRGB_CHROMATICITIES, atol=2e-3)
    if is_srgb and abs(gamma - 0.45455) < 2e-4:
        return srgb(f"{source} and cHRM")
    return power(1 / gamma, source)


def h273(code: int, source: str) -> Transfer | None:
    """The transfer function of a code point of ITU-T H.273, table 3; None for one that says nothing."""
    if code == 8:
        return linear(source)
    if code == 13:
        return srgb(source)
    if code in (4, 5):
        return power({4: 2.2, 5: 2.8}[code], source)
    named: dict[int, tuple[str, str, float]] = {  # function of colour-science, its light at full scale
        **dict.fromkeys((1, 6, 14, 15), ("BT.709", "oetf_inverse_BT709", 1.0)),
        7: ("SMPTE 240M", "eotf_SMPTE240M", 1.0),
        9: ("logarithmic, 100:1", "oetf_inverse_H273_Log", 1.0),
        10: ("logarithmic, 316:1", "oetf_inverse_H273_LogSqrt", 1.0),
        11: ("xvYCC", "oetf_inverse_H273_IEC61966_2", 1.0),
        16: ("PQ", "eotf_ST2084", PQ_PEAK),
        17: ("SMPTE ST 428-1", "eotf_H273_ST428_1", 52.37),
        18: ("HLG", "oetf_inverse_BT2100_HLG", 1.0),
    }
    if code not in named:
        return None
    name, function, peak = named[code]

    def decode(values: np.ndarray) -> np.ndarray:
        convert: Callable[[np.ndarray], np.ndarray] = getattr(colour_science().models, function)
        return np.asarray(convert(np.clip(values, 0.0, 1.0)), float) / peak

    return Transfer(name, source, decode)


def table(entries: np.ndarray, source: str) -> Transfer:
    """Light at evenly spaced samples, (N,) for all channels or (N, 3), 0 to 1; linear in between."""
    columns = np.broadcast_to(entries[:, None] if entries.ndim == 1 else entries, (len(entries), 3))
    at = np.linspace(0.0, 1.0, len(entries))
    name = "linear" if np.abs(columns - at[:, None]).max() < 1e-4 else "a table"

    def decode(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(values[..., c], at, columns[:, c]) for c in range(3)], axis=-1)

    return linear(source) if name == "linear" else Transfer(name, source, decode)
