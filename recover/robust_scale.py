"""A scale of residuals that outliers do not move: the median absolute deviation from zero.

F. R. Hampel, "The influence curve and its role in robust estimation", JASA 69 (1974); the report's 2.2 uses it as s0.
"""

import numpy as np

MAD_TO_DEVIATION = 1.4826  # 1 / Φ⁻¹(3/4): of a Gaussian, its standard deviation over its median absolute value


def mad_scale(residuals: np.ndarray) -> float:
    """Standard deviation of the Gaussian whose median absolute value is that of the ``residuals`` (any shape)."""
    return MAD_TO_DEVIATION * float(np.median(np.abs(residuals)))
