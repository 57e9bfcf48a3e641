"""Irradiance as a smooth map of the normal: spherical harmonics, each by what clamped cosine leaves of it.

Under any distant light L(ω) a convex surface gets E(n) = ∫ L(ω) max(0, n·ω) dω, and of L's harmonics of degree l it
keeps A_l: π, 2π/3, π/4, 0, −π/24, 0, π/64 …, so that nine numbers a channel hold all but a percent. Scaled by |A_l| the
coefficients are those of the light, which has no scale of its own: white light is a unit of each.

Sources: R. Ramamoorthi and P. Hanrahan, J. Opt. Soc. Am. A 18 (2001) 2448–2459, Eq. (19); R. Basri and D. W. Jacobs,
IEEE TPAMI 25(2) (2003) 218–233.
"""

from math import factorial, pi, sqrt

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import Legendre


def clamped_cosine(degree: int) -> float:
    """A_l, the harmonic of ``degree`` of max(0, cos θ): 0 for odd ones but the first."""
    if degree == 1:
        return 2 * pi / 3
    if degree % 2:
        return 0.0
    half = degree // 2
    return (
        2
        * pi
        * (-1) ** (half - 1)
        / ((degree + 2) * (degree - 1))
        * factorial(degree)
        / (2**degree * factorial(half) ** 2)
    )


class Harmonics:
    """Real orthonormal harmonics of some degrees, times |A_l|, as polynomials of n; the gradient is theirs."""

    def __init__(self, degrees: tuple[int, ...]) -> None:
        self._terms: list[tuple[int, bool, Polynomial, Polynomial]] = []  # order, sine, factor of z and its derivative
        for degree in degrees:
            legendre = Legendre.basis(degree).convert(kind=Polynomial)
            for order in range(degree + 1):
                norm = (2 * degree + 1) / (4 * pi) * factorial(degree - order) / factorial(degree + order)
                scale = sqrt(norm * (2 if order else 1)) * abs(clamped_cosine(degree))
                of_z = scale * (legendre.deriv(order) if order else legendre)
                self._terms += [(order, sine, of_z, of_z.deriv()) for sine in ((False, True) if order else (False,))]

    def __len__(self) -> int:
        return len(self._terms)

    def at(self, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(values (P, K), gradients (P, K, 3)) at normals (P, 3)."""
        around = n[:, 0] + 1j * n[:, 1]
        powers = [np.ones(len(n), complex)]
        for _ in range(max(order for order, *_ in self._terms)):
            powers.append(powers[-1] * around)
        values, gradients = np.empty((len(n), len(self))), np.empty((len(n), len(self), 3))
        for k, (order, sine, of_z, by_z) in enumerate(self._terms):
            factor, turn = of_z(n[:, 2]), order * powers[max(order - 1, 0)]
            part, by_x, by_y = (np.imag(c) if sine else np.real(c) for c in (powers[order], turn, 1j * turn))
            values[:, k] = part * factor
            gradients[:, k] = np.stack([by_x * factor, by_y * factor, part * by_z(n[:, 2])], axis=-1)
        return values, gradients
