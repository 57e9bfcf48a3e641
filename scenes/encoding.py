"""Linear light and display-encoded samples: the transfer function of sRGB (IEC 61966-2-1) and its inverse.

Samples are decoded once, where a picture enters: a texture (``scenes.albedo.image``), a photograph
(``render.dataset.linear_light``); everything behind works on light.
"""

import numpy as np

ENCODINGS = ("linear", "srgb")


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Display values of linear light (any shape), both with full scale 1. IEC 61966-2-1"""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def decode_srgb(encoded: np.ndarray) -> np.ndarray:
    """Linear light of display values (any shape), both with full scale 1: the inverse of ``encode_srgb``."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4)
